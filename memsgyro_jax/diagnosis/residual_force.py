"""Which force is missing, as data: what the fitted model would need to move as the device was seen to move."""

from functools import lru_cache
from typing import TypeVar

import numpy as np

from memsgyro_jax.measurement.experiments.missing_force import MissingForce, RateResidual, SweepForce, TimeForce

from .fit import CaseFit


Sort = TypeVar("Sort", bound=MissingForce)


@lru_cache(maxsize=2)
def missing_forces(fit: CaseFit) -> tuple[MissingForce, ...]:
    """The view that each compared record of a case offers, in their order."""
    compared = [k for k, white in enumerate(fit.whitened) if np.isfinite(white).any()]
    found = [fit.case.records[k].missing_force(fit.deviation(k)) for k in compared]
    return tuple(one for one in found if one is not None)


def sweep_forces(fit: CaseFit) -> tuple[SweepForce, ...]:
    """Those of responses over frequency: a force phasor per row, fitted or not."""
    return _of_sort(fit, SweepForce)


def time_forces(fit: CaseFit) -> tuple[TimeForce, ...]:
    """Those of waveforms: the force over time."""
    return _of_sort(fit, TimeForce)


def rate_residuals(fit: CaseFit) -> tuple[RateResidual, ...]:
    """Those of phasors over time: what is left against rate and time."""
    return _of_sort(fit, RateResidual)


def _of_sort(fit: CaseFit, sort: type[Sort]) -> tuple[Sort, ...]:
    return tuple(one for one in missing_forces(fit) if isinstance(one, sort))
