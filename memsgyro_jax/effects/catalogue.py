"""The catalogue: every effect that a bench may show, in the order in which a gyro meets them."""

from collections.abc import Sequence

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import suggestion

from .adc_saturation import AdcSaturation
from .ageing import AgeingOffset, AgeingStiffness
from .angular_acceleration import AngularAcceleration
from .axes import variants
from .base import Effect
from .bias_transduction import DriveTransduction, PickoffTransduction
from .centrifugal import Centrifugal
from .cross_damping_asymmetry import CrossDampingAsymmetry
from .cross_stiffness import CrossStiffness
from .cubic_stiffness import CubicStiffness
from .damping_step import DampingStep
from .drive_nonlinearity import DriveNonlinearity
from .dry_friction import DryFriction
from .electrical_feedthrough import ElectricalFeedthrough
from .electrostatic_cubic_stiffness import ElectrostaticCubicStiffness
from .electrostatic_softening import ElectrostaticSoftening
from .finite_sweep_rate import FiniteSweepRate
from .force_misalignment import ForceMisalignment
from .parasitic_mode import ParasiticMode
from .pickoff_crosstalk import PickoffCrosstalk
from .pickoff_cubic_nonlinearity import PickoffCubicNonlinearity
from .pickoff_nonlinearity import PickoffNonlinearity
from .pickoff_scale_error import PickoffScaleError
from .quadratic_damping import QuadraticDamping
from .quadratic_stiffness import QuadraticStiffness
from .rate_bias_drift import RateBiasDrift
from .rate_offset import RateOffset
from .rate_scale_error import RateScaleError
from .readout_delay import ReadoutDelay
from .self_heating import SelfHeating
from .squeeze_film_damping import SqueezeFilmDamping
from .thermal_drift import ThermalDamping, ThermalDampingCurvature, ThermalStiffness, ThermalStiffnessCurvature
from .thermal_electronics import ThermalBias, ThermalDelay, ThermalDrive, ThermalGain


CATALOGUE: tuple[type[Effect], ...] = (
    *(CubicStiffness, QuadraticStiffness, CrossStiffness, ElectrostaticSoftening, ElectrostaticCubicStiffness),
    *(CrossDampingAsymmetry, QuadraticDamping, SqueezeFilmDamping, DryFriction, DampingStep),
    *(ThermalStiffness, ThermalDamping, ThermalStiffnessCurvature, ThermalDampingCurvature, ParasiticMode),
    *(RateOffset, RateScaleError, RateBiasDrift, AngularAcceleration, Centrifugal),
    *(ForceMisalignment, DriveNonlinearity, DriveTransduction, ElectricalFeedthrough),
    *(ReadoutDelay, PickoffScaleError, PickoffTransduction),
    *(PickoffNonlinearity, PickoffCubicNonlinearity, PickoffCrosstalk),
    *(AdcSaturation, FiniteSweepRate),
)


OF_OPERATION: tuple[type[Effect], ...] = (
    *(ThermalGain, ThermalDelay, ThermalDrive, ThermalBias, SelfHeating, AgeingStiffness, AgeingOffset),
)
"""Effects that a device may carry through temperature and years, and that no diagnosis of a bench asks for."""


def every_effect(axes: int = 2) -> tuple[Effect, ...]:
    """The catalogue and the effects of operation: all that a file may name."""
    return *catalogue(axes), *(effect for kind in OF_OPERATION for effect in variants(kind, axes))


def catalogue(axes: int = 2) -> tuple[Effect, ...]:
    """Every variant of every effect that a device with so many axes can have, at strength zero."""
    return tuple(effect for kind in CATALOGUE for effect in variants(kind, axes))


def by_name(name: str, where: str = "", among: Sequence[Effect] | None = None) -> Effect:
    """The effect of a name, e.g. `by_name("cubic_stiffness", "x")`, at strength zero.

    Args:
        name: as in the catalogue; `"cubic_stiffness x"`, an effect's `label`, may stand here as a whole.
        where: the variant; may be left out where there is one only.
        among: the effects to choose from; `None` takes every one for two axes.

    Raises:
        InputError: if there is no such effect or variant, or if the variant is left open.
    """
    known = every_effect(2) if among is None else tuple(among)
    if not where and " " in name.strip():
        name, where = name.split(maxsplit=1)
    same = [effect for effect in known if effect.name == name]
    if not same:
        names = list(dict.fromkeys(effect.name for effect in known))
        raise InputError(f'An effect must be one of the catalogue, but "{name}" is not ({suggestion(name, names)}).')
    found = [effect for effect in same if effect.where == where]
    if found:
        return found[0]
    if not where and len(same) == 1:
        return same[0]
    places = ", ".join(f'"{effect.where}"' for effect in same if effect.where)
    wanted = f"must say which variant, {places}" if places else "has no variants"
    raise InputError(f"Effect `{name}` {wanted}, but {f'is given as {where!r}' if where else 'says none'}.")
