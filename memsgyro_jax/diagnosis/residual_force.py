"""Which force is missing, as data: what the fitted model would need to move as the device was seen to move."""

from typing import Any, TypeVar

import numpy as np

from memsgyro_jax.measurement.drive_levels import ALIKE, clear_drives
from memsgyro_jax.measurement.experiments.missing_force import MissingForce, RateResidual, SweepForce, TimeForce
from memsgyro_jax.measurement.one_place import NEAR

from .drives import without_rows
from .fit import CaseFit, beside_case
from .optimum import Optimum, optimise


Sort = TypeVar("Sort", bound=MissingForce)


def beside_lowest_drive(fit: CaseFit) -> CaseFit:
    """The base model of a fit, fitted to the sweeps of the lowest drive of each axis alone, beside all records.

    There a device is the most linear, and what stronger drives make of it stands out as it is, a threshold as a kink: a
    model fitted to all of them shares it out. The fit itself where its sweeps have but one drive.
    """
    lowest, joint = lowest_drive(fit), fit.joint
    if lowest is None:
        return fit
    return beside_case(fit.case, joint, optimise(joint, lowest.vector, joint.base(), joint.fitted, max_evaluations=0))


def lowest_drive(fit: CaseFit, free: np.ndarray | None = None) -> Optimum | None:
    """The base model of a fit, or what is `free` of it, fitted to the sweeps of the lowest drive of each axis alone, in
    the surroundings nearest to those declared; `None` where its sweeps have but one drive in one place.
    """
    left_out: dict[int, tuple[int, ...]] = {}
    sweeps: list[tuple[int, Any]] = [(k, r) for k, r in enumerate(fit.case.records) if hasattr(r, "setting")]
    for axis in range(fit.model.axes):
        mine = [(k, r) for k, r in sweeps if r.axis == axis and r.role != "validation"]
        if clear := clear_drives(fit.case, axis):
            away = {k: r.away(fit.case.environment) for k, r in mine}
            nearest = min(float(np.min(far)) for far in away.values())
            elsewhere = {k: (r.setting > (1 + ALIKE) * clear[0]) | (away[k] > nearest + NEAR) for k, r in mine}
            left_out |= {k: tuple(np.flatnonzero(rows).tolist()) for k, rows in elsewhere.items()}
    if not any(left_out.values()):
        return None
    joint = fit.joint
    calm = [r for r in without_rows(joint.fitted, left_out) if r.experiment.shows_modes]
    return optimise(joint, joint.start, joint.base() if free is None else free, calm)


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
