"""The numbers that a fit found, and how they are told."""

from dataclasses import replace
from typing import Any

import numpy as np

from memsgyro_jax.base.text import said_in
from memsgyro_jax.effects import ForceEffect, InstrumentTerm
from memsgyro_jax.measurement.calibration import calibration_share, unit_of_records
from memsgyro_jax.measurement.case import Case

from .fitted import ParameterEstimate, at_bounds
from .joint_residual import Joint
from .optimum import Optimum
from .outside_design import outside_design


UNENDED = "without ±: the fit has not ended, and its numbers may still move"
WITHOUT = "without ±: the model leaves more than the noise, and its numbers take what it lacks"
SCALED = "standard deviations times {:.3g}, as the model leaves more than the noise"


def estimates_of(case: Case, joint: Joint, optimum: Optimum) -> tuple[ParameterEstimate, ...]:
    """The parameters that were free, without those of terms that no record shows."""
    free, unseen = optimum.free.tolist(), unseen_terms(joint, optimum)
    stopped = at_bounds(optimum.vector, joint.bounds, free)
    return tuple(
        ParameterEstimate(
            joint.parameters[i].name,
            float(optimum.vector[i]),
            float(std),
            unit_of_records(case, joint.parameters[i].unit),
            calibration_share(case, joint.parameters[i].unit),
            end,
        )
        for i, std, end in zip(free, optimum.std, stopped, strict=True)
        if joint.parameters[i].effect not in unseen
    )


def unseen_terms(joint: Joint, optimum: Optimum) -> frozenset[int]:
    """Places of terms of the instrument of which fitted records show no number: what was known beforehand stands, as
    of a temperature on which nothing depends.
    """
    told = np.concatenate([~r.weightless for r in joint.fitted])
    shown = optimum.free[np.any(optimum.jacobian[told] != 0, axis=0)]
    terms = [i for i, e in enumerate(joint.model.effects) if isinstance(e, InstrumentTerm) and e.known_to is not None]
    free = {joint.parameters[i].effect for i in optimum.free}
    return frozenset(i for i in terms if i in free and not np.isin(joint.of_effect(i), shown).any())


def told_of(fit: Any) -> tuple[str, ...]:
    """A line for each mode and parameter of a fit, and one on their ±; without ± where the fit has not ended, or leaves
    more than noise.
    """
    every, whose = (*fit.modes, *fit.estimates), whose_forces(fit)
    beside = (f"  ({whose})",) if whose else ()
    if not fit.optimum.converged:
        bare = (replace(e, std=e.std if np.isinf(e.std) else np.nan, above=None) for e in every)
        return (*(f"  {e}" for e in bare), *beside, f"  ({UNENDED})")
    if not fit.leaves_noise:
        return (*(f"  {e.roughly}" for e in every), *beside, f"  ({WITHOUT})")
    said = tuple(f"  {replace(e, std=fit.scale * e.std)}" for e in every)
    outside = outside_design(fit.case, fit.optimum, fit.scale)
    said += (*beside, *(f"  outside its design: {one}" for one in outside))
    return said if fit.scale == 1.0 else (*said, f"  ({SCALED.format(fit.scale)})")


def whose_forces(fit: Any) -> str:
    """Of which device the strengths of forces are, where nothing drives it and nobody says its mass, in a sentence;
    empty where records or the design hold that, or the fit has no force.
    """
    case, model = fit.case, fit.model
    held = not fit.joint.undriven or (not case.holds_gain if model.axes == 1 else not case.design["mass"].unknown)
    if held or not any(isinstance(effect, ForceEffect) for effect in model.present.effects):
        return ""
    if model.axes == 1:
        what, size, unit = "stiffness", float(model.device.stiffness[0] / model.device.mobility), "N/m"
    else:
        what, size, unit = "mass", 1.0 / float(model.device.mobility), "kg"
    told = said_in(f"{size:.4g}", unit_of_records(case, unit))
    return f"nothing drives the device, so that no record tells its mass: strengths are those of a {what} of {told}"


def with_std_if_held(fit: Any) -> tuple[ParameterEstimate, ...]:
    """The parameters of a fit, with NaN in place of standard deviations that are not told, for machines."""
    if fit.optimum.converged and fit.leaves_noise:
        return tuple(fit.estimates)
    return tuple(replace(e, std=np.nan) for e in fit.estimates)
