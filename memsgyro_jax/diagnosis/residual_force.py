"""Which force is missing, as data: what the fitted model would need to move as the device was seen to move."""

from typing import TypeVar

from memsgyro_jax.measurement.experiments.missing_force import MissingForce, RateResidual, SweepForce, TimeForce

from .fit import CaseFit


Sort = TypeVar("Sort", bound=MissingForce)


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
    return tuple(one for one in fit.missing_forces if isinstance(one, sort))
