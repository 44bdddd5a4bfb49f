"""The effects of the catalogue that a case may ask for."""

import numpy as np

from memsgyro_jax.effects import (
    Effect,
    ThermalDampingCurvature,
    ThermalDrive,
    ThermalGain,
    ThermalStiffnessCurvature,
    catalogue,
)
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.one_place import NEAR


COURSE = 4  # temperatures from which a parabola is more than a line drawn through all of them


def worth_trying(case: Case) -> tuple[Effect, ...]:
    """Those that the device can have: from four temperatures on with gains that go with them, and before that without
    courses that any three would bear out.
    """
    every = catalogue(case.channels)
    if count_temperatures(case) >= COURSE:
        return *every, ThermalGain(), ThermalDrive()
    return tuple(e for e in every if not isinstance(e, ThermalStiffnessCurvature | ThermalDampingCurvature))


def count_temperatures(case: Case) -> int:
    """How many there are, of all records, farther apart than one reading is from the next."""
    told = (getattr(record, "temperature", None) for record in case.records)
    read = [np.ravel(one) for one in told if one is not None]
    values = np.sort(np.concatenate(read)) if read else np.zeros(0)
    return int(values.size > 0) + int(np.sum(np.diff(values) > NEAR))
