"""What records can identify before anything is fitted: the information that each, and all together, hold about the base
parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.least_squares import Information
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.readings import model_of, readings_of

from .joint_residual import Joint


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
    held = Information.of(jacobian * scale)
    nulls = tuple(str(null).removeprefix("+1.00·") for null in held.null_directions(names))
    return Identifiable(name, tuple(names), tuple(held.std.tolist()), nulls)


def _percent(relative: float) -> str:
    return f"{100 * relative:.2g} %"
