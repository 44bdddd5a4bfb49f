"""How objects show themselves: numbers with their units in a terminal, and the same in a notebook.

An object is written as it would be made, but many numbers as shape and range. The unit of a field stands in its
metadata, `eqx.field(metadata={"unit": "kg"})`, or in the table below.
"""

import dataclasses
import html
import re
from dataclasses import is_dataclass
from typing import Any

import equinox as eqx
import numpy as np

from .concrete import is_concrete
from .converter import FieldConverter
from .errors import InputError
from .text import said_in


WIDTH = 100  # characters of a line beyond which each field gets its own
FEW = 6  # entries of an array that are written out

# Fields by name, or by `Class.name` where a name stands for several things; `*` is the unit of the field in which the
# object stands itself, as a profile does in `Scenario.rate`.
_FIELDS = {
    "Ω": "resistor",
    "F/m": "CarrierReadout.gradient",
    "1": "fingers rejection excess ceiling cut relative gain gain_ratio drive_ratio quality quality_factor force_yx "
    "force_xy damping_change force_gain cross_damping adaptation unit realisation progress record rate_trusted share "
    "softness rounding static_gain legs Process.pressure PlateLayout.loss ChargeStage.gain SlidingMode.slope "
    "SlidingMode.forgetting layer",
    "samples": "Blocks.length Blocks.start",
    "kg": "mass mass_x mass_y",
    "1/kg": "mobility",
    "N/m": "kxx kyy kxy kyx PhaseLockedDrive.force_gain",
    "N·s/m": "dxx dyy dxy cross_damping_asymmetry",
    "1/s²": "NormalisedDevice.stiffness CoupledModes.stiffness_coupling PhaseLockedDrive.phase_integral",
    "1/s": "NormalisedDevice.damping CoupledModes.damping_coupling forgetting settling PhaseLockedDrive.phase_gain",
    "m": "width gap overlap mismatch DesignedMotion.tones SlidingMode.tones length travel over_etch thickness side "
    "length_x length_y",
    "m²": "area",
    "m/s": "creep",
    "m, m/s": "motion motion_std start",
    "m/s²": "acceleration DampingCompensation.tones ReferenceModel.tones WholeAngle.tones",
    "N": "OpenLoop.tones PhaseLockedDrive.limit",
    "N/(m·s)": "PhaseLockedDrive.force_integral",
    "V": "bias opamp_offset offset offset_std offset_drift limit reference_bias bias_voltage "
    "CarrierDetection.amplitude",
    "V/√Hz": "noise_density ChargeStage.noise",
    "V/m or V·s/m": "scale",
    "F": "feedback parasitic sensor sampler CarrierReadout.mismatch",
    "K": "reference_temperature temperature",
    "Pa": "stress young PlateLayout.pressure",
    "kg/m³": "density",
    "1/K": "softening",
    "rad": "phase phase_asymmetry drive_asymmetry AxisAngles.stiffness AxisAngles.damping AxisAngles.drive "
    "AxisAngles.sense WholeAngle.rocking sidewall misalignment",
    "rad/s": "rate cross_rate omega resonance LyapunovObserver.frequency SlidingMode.frequency tolerance",
    "rad/s²": "angular_acceleration",
    "rad²/s²": "rate_variance",
    "Hz": "gain_bandwidth corner sample_rate frequency bandwidth low high",
    "s": "at until time times delay duration decay window settle allowed",
    "SI per kg": "theta theta_std",
    "m²/s³": "ProcessNoise.acceleration",
    "SI²/s": "ProcessNoise.motion ProcessNoise.offset ProcessNoise.theta",
    "SI": "Normal.std Uniform.low Uniform.high",
    "*": "level after before values Ramp.start RandomWalk.start Tone.amplitude Sine.amplitude Chirp.amplitude",
    "(*)/s": "slope",
    "(*)²/s": "intensity",
}
UNITS = {name: unit for unit, names in _FIELDS.items() for name in names.split()}


class Shown:
    """An object that writes its text, or else its numbers with their units, in a notebook too."""

    def __repr__(self) -> str:
        if type(self).__str__ is not object.__str__:
            return str(self)
        return shown(self) if _can_be(self) else f"{shown(self, bare=True)}  # a derivative by one: no units"

    def _repr_html_(self) -> str:
        return f'<pre style="line-height: 1.25">{html.escape(repr(self))}</pre>'


class Displayed(Shown, eqx.Module):
    """A module that writes its numbers with their units. The converters of its fields learn the names of these."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for name, field in vars(cls).items():
            converter = field.metadata.get("converter") if isinstance(field, dataclasses.Field) else None
            if isinstance(converter, FieldConverter):
                converter.called(name, cls)


def shown(value: Any, unit: str = "", *, bare: bool = False) -> str:
    """`value` as it would be written, its numbers in `unit`; without any unit where `bare`."""
    unit = "" if bare else unit
    if _is_number(value):
        return said_in(_number(value), unit)
    if dataclasses.is_dataclass(value) and not isinstance(value, type) and _is_plain(value):
        fields = (_field(value, field, unit, bare) for field in dataclasses.fields(value))
        return _enclosed(type(value).__name__, [text for text in fields if text])
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        named = zip(value._fields, value, strict=True)
        parts = [f"{name}={shown(held, bare=bare)}" for name, held in named if held is not None]
        return _enclosed(type(value).__name__, parts)
    if isinstance(value, tuple | list):
        numbers = len(value) > 0 and all(_is_number(entry) and np.ndim(entry) == 0 for entry in value)
        text = _enclosed("", [shown(entry, "" if numbers else unit, bare=bare) for entry in value])
        return said_in(text, unit) if numbers else text
    return repr(value)


def stated_unit(value: Any, field: dataclasses.Field, around: str = "") -> str | None:
    """Unit of a field of an object that stands in a field of unit `around`; None where nobody stated it."""
    named = (f"{kind.__name__}.{field.name}" for kind in type(value).__mro__)
    stated = next((UNITS[name] for name in (*named, field.name) if name in UNITS), None)
    if field.name == "strength":
        stated = getattr(value, "unit", None)
    unit = field.metadata.get("unit", stated)
    return unit if unit is None or "*" not in unit else unit.replace("*", around) if around else "1"


def stated_at(root: Any, path: str) -> str:
    """The unit of the number at a dotted path; empty where nobody stated it, or where an array holds several."""
    here, unit = root, ""
    for part in path.split("."):
        field = next((f for f in dataclasses.fields(here) if f.name == part), None) if is_dataclass(here) else None
        unit = unit if field is None else stated_unit(here, field, unit) or ""
        here = here[int(part)] if part.isdigit() else getattr(here, part.replace(" ", "_"))
    return "" if re.search(",| or |SI", unit) else unit


def _field(value: Any, field: dataclasses.Field, around: str, bare: bool) -> str:
    held = getattr(value, field.name, None)  # None, too, in an object that is not yet made
    if not field.repr or (_is_empty(held) and _is_empty(field.default)):
        return ""
    if field.name in ("axis", "source", "target") and held in (0, 1):
        return f"{field.name}='{'xy'[held]}'"
    return f"{field.name}={shown(held, stated_unit(value, field, around) or '', bare=bare)}"


def _can_be(value: Any) -> bool:
    """Whether it passes its own checks. The gradient by a device is an object of its class, in units per unit of each
    number, and has a mass of zero or below, say.
    """
    try:
        for kind in type(value).__mro__:
            vars(kind).get("__check_init__", lambda _: None)(value)
    except (InputError, AttributeError, TypeError, ValueError):
        return False
    return True


def _is_empty(value: Any) -> bool:
    return value is None or (isinstance(value, tuple) and not value)


def _is_plain(value: Any) -> bool:
    """Whether its class has no text of its own."""
    method = type(value).__repr__
    return method in (Shown.__repr__, eqx.Module.__repr__) or hasattr(method, "__wrapped__")


def _is_number(value: Any) -> bool:
    return eqx.is_array_like(value) and not isinstance(value, bool)


def _number(value: Any) -> str:
    kind = f"{np.dtype(value.dtype).name}{list(value.shape)}" if eqx.is_array(value) else ""
    if not is_concrete(value):
        return f"traced {kind}"
    if np.ndim(value) == 0:
        return f"{value.item() if kind else value:.6g}"
    entries = np.ravel(np.asarray(value))
    if entries.size <= FEW and np.ndim(value) == 1:
        return f"[{', '.join(f'{entry:.6g}' for entry in entries)}]"
    if not entries.size or np.iscomplexobj(entries):
        return kind
    return f"{kind} from {np.min(entries):.6g} to {np.max(entries):.6g}"


def _enclosed(head: str, parts: list[str]) -> str:
    line = f"{head}({', '.join(parts)}{',' if not head and len(parts) == 1 else ''})"
    if len(line) <= WIDTH and "\n" not in line:
        return line
    inside = ",\n".join(parts).replace("\n", "\n  ")
    return f"{head}(\n  {inside}\n)"
