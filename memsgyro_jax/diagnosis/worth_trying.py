"""The effects of the catalogue that a case may ask for."""

import numpy as np

from memsgyro_jax.effects import (
    Effect,
    ElectrostaticCubicStiffness,
    ThermalDampingCurvature,
    ThermalDrive,
    ThermalGain,
    ThermalStiffnessCurvature,
    catalogue,
)
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.one_place import NEAR


COURSE = 4  # temperatures from which a parabola is more than a line drawn through all of them
SAME = 1e-6  # V, within which a bias voltage is the same


def worth_trying(case: Case) -> tuple[Effect, ...]:
    """Those that the device can have: from four temperatures on with gains that go with them, and before that without
    courses that any three would bear out; at one bias voltage without the spring that goes with it and the amplitude,
    which is a plain cubic one there.
    """
    every = catalogue(case.channels)
    if count_biases(case) < 2:
        every = tuple(e for e in every if not isinstance(e, ElectrostaticCubicStiffness))
    if count_temperatures(case) >= COURSE:
        return *every, ThermalGain(), ThermalDrive()
    return tuple(e for e in every if not isinstance(e, ThermalStiffnessCurvature | ThermalDampingCurvature))


def count_temperatures(case: Case) -> int:
    """How many there are, of all records, farther apart than one reading is from the next."""
    return _count(case, "temperature", NEAR)


def count_biases(case: Case) -> int:
    """How many bias voltages there are, of all records."""
    return _count(case, "bias_voltage", SAME)


def _count(case: Case, name: str, same: float) -> int:
    told = (getattr(record, name, None) for record in case.records)
    read = [np.ravel(one) for one in told if one is not None]
    values = np.sort(np.concatenate(read)) if read else np.zeros(0)
    return int(values.size > 0) + int(np.sum(np.diff(values) > same))
