"""What records can identify before anything is fitted: the information that each, and all together, hold about the base
parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.readings import model_of, readings_of

from .joint_residual import NULL, Joint


PARTS = 4  # largest parts of a null direction that are named
LOOSE = 1.0  # relative standard deviation from which a parameter counts as not identified


@dataclass(frozen=True)
class Identifiable:
    """What one record, or all of them, can tell about the base parameters.

    Args:
        name: of the record; "all records" for the whole.
        names: of the parameters.
        relative: standard deviation of each over its value at the start; infinite where the record does not hold it.
        nulls: combinations of parameters, as text, that the record does not hold at all.
    """

    name: str
    names: tuple[str, ...]
    relative: tuple[float, ...]
    nulls: tuple[str, ...]

    def __str__(self) -> str:
        held = [f"{n} to {_percent(r)}" for n, r in zip(self.names, self.relative, strict=True) if r < LOOSE] or [
            "nothing on its own"
        ]
        return f"{self.name}: {', '.join(held)}" + (f"; not held: {', '.join(self.nulls)}" if self.nulls else "")


def identifiable(case: Case) -> tuple[Identifiable, ...]:
    """Per fitted record, and for all of them together, how well the base parameters would be known.

    The sensitivities are those at the start that the data themselves give; nothing is fitted. `InputError` in float32.
    """
    joint = Joint(model_of(case, starting_device(case)), readings_of(case))
    names = tuple(p.name for p in joint.parameters)
    units, blocks = np.eye(joint.start.size), {}
    for readings in joint.fitted:
        _, slopes = joint.linearise(joint.start, units, [readings])
        rows = slopes.reshape(readings.record.size, -1, len(names))
        for record in np.unique(readings.record[readings.record >= 0]):
            blocks[int(record)] = rows[readings.record == record].reshape(-1, len(names))
    out = [_judged(case.records[k].name, names, blocks[k], joint.start) for k in sorted(blocks)]
    return (*out, _judged("all records", names, np.concatenate(list(blocks.values())), joint.start))


def _judged(name: str, names: Sequence[str], jacobian: np.ndarray, values: np.ndarray) -> Identifiable:
    """Standard deviations and null directions of a Jacobian (r, p) in relative coordinates."""
    scale = np.where(values != 0, np.abs(values), 1.0)
    relative = jacobian * scale
    norm = np.linalg.norm(relative, axis=0)
    size = np.where(norm > 0, norm, 1.0)
    _, s, vt = np.linalg.svd(relative / size, full_matrices=False)
    held = s > NULL * s[0]
    spread = (vt[held].T / s[held]) / size[:, None]
    std = np.sqrt(np.sum(spread**2, axis=1))
    loose = np.any(np.abs(vt[~held]) > 1e-3, axis=0) if np.any(~held) else np.zeros(len(names), bool)
    nulls = tuple(_spoken(direction, names) for direction in vt[~held])
    return Identifiable(name, tuple(names), tuple(np.where(loose | (norm == 0), np.inf, std).tolist()), nulls)


def _spoken(direction: np.ndarray, names: Sequence[str]) -> str:
    order = [i for i in np.argsort(-np.abs(direction))[:PARTS] if abs(direction[i]) > 0.1]
    if len(order) == 1:
        return names[order[0]]
    return " ".join(f"{direction[i]:+.2f}·{names[i]}" for i in order)


def _percent(relative: float) -> str:
    return f"{100 * relative:.2g} %"
