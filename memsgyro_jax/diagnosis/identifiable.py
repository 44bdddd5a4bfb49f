"""What records can identify before anything is fitted: the information that each, and all together, hold about the base
parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.least_squares import Information
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.one_place import in_one_place
from memsgyro_jax.measurement.readings import Readings, model_of, readings_of

from .joint_residual import Joint
from .optimum import optimise


MUCH = 0.01  # of the power of what is read: a start that leaves so much tells no sensitivity
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
    """Per fitted record, and for all of them together, how well the base parameters would be known; without the
    constant voltages of channels where a record reads none, as none of a lock-in does.

    The sensitivities are those at the start that the data themselves give, or where that leaves much of them, as of a
    short run it may, at the end of a fit from there. `InputError` in float32.
    """
    joint = Joint(model_of(case, starting_device(case)), readings_of(case))
    names = np.array([p.name for p in joint.parameters])
    units, blocks, moved, near = np.eye(joint.start.size), {}, _elsewhere(case), _near(case, joint)
    constant = np.array([p.is_offset for p in joint.parameters])
    shown: dict[int, np.ndarray] = {}
    for readings in joint.fitted:
        here = joint.linearise(near, units, [readings])[1]
        for number in np.unique(readings.record[readings.record >= 0]).tolist():
            start = moved.get(number, near)
            slopes = joint.linearise(start, units, [readings])[1] if number in moved else here
            rows = slopes.reshape(readings.record.size, -1, len(names))[readings.record == number]
            blocks[number] = rows.reshape(-1, len(names)) * np.where(start != 0, np.abs(start), 1.0)
            shown[number] = ~constant | readings.experiment.reads_constants
    out = [_judged(case.records[k].name, names[shown[k]].tolist(), blocks[k][:, shown[k]]) for k in sorted(blocks)]
    either = np.any(list(shown.values()), axis=0)
    return (*out, _judged("all records", names[either].tolist(), np.concatenate(list(blocks.values()))[:, either]))


def _near(case: Case, joint: Joint) -> np.ndarray:
    """Base parameters near what is read."""
    left = np.concatenate(joint.residual(joint.start, joint.fitted))
    if left @ left < MUCH * sum(_power(case, readings) for readings in joint.fitted):
        return joint.start
    return optimise(joint, joint.start, joint.base(), joint.fitted).vector


def _power(case: Case, readings: Readings) -> float:
    """Sum of what is read over its noise, squared; infinite where nobody tells a noise."""
    noise = getattr(readings.experiment.noise, "std", None)
    if noise is None:
        return np.inf
    std, total = np.broadcast_to(noise, (readings.record.size, readings.axes)), 0.0
    for number in np.unique(readings.record[readings.record >= 0]):
        mine = readings.record == number
        total += float(np.nansum(np.abs(case.records[number].readings[readings.row[mine]] / std[mine]) ** 2))
    return total


def _elsewhere(case: Case) -> dict[int, np.ndarray]:
    """Parameters that records taken farther from the surroundings declared than others tell by themselves, by number:
    there the device may be another one.
    """
    alike = {*map(id, in_one_place(case.environment, case.records))}
    out = {}
    for number, record in enumerate(case.records):
        if id(record) not in alike and record.role != "validation":
            alone = replace(case, records=(record,))
            out[number] = np.asarray(Joint(model_of(alone, starting_device(alone)), readings_of(alone)).start)
    return out


def _judged(name: str, names: Sequence[str], jacobian: np.ndarray) -> Identifiable:
    """Standard deviations and null directions of a Jacobian (r, p) in relative coordinates."""
    held = Information.of(jacobian)
    nulls = tuple(str(null).removeprefix("+1.00·") for null in held.null_directions(names))
    return Identifiable(name, tuple(names), tuple(held.std.tolist()), nulls)


def _percent(relative: float) -> str:
    return f"{100 * relative:.2g} %"
