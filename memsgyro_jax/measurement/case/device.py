"""Sections `[design]`, `[readout]`, `[drive]` and `[environment]` of a case, in SI."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import NamedTuple

from memsgyro_jax.base.complaints import Source
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import suggestion

from ..declared import QUANTITIES, DesignValue, Drive, Environment, Readout, Vocabulary, check_temperature, si
from ..section import Amount
from .file import CaseFile, DesignEntry, ReadoutEntry


class Instead(NamedTuple):
    """What may be given in place of a design value: key, unit, whether it is positive, and the value from it and those
    before it, rising in all numbers but the quality factor.
    """

    key: str
    unit: str
    positive: bool
    value: Callable[[dict[str, float], float], float]


def _stiffness(before: dict[str, float], frequency: float) -> float:
    return before["mass"] * frequency**2


def _quadrature(before: dict[str, float], rate: float) -> float:
    return 2.0 * math.sqrt(before["kxx"] * before["mass"]) * rate


BY_MODES = {
    "kxx": Instead("frequency_x", "rad/s", True, _stiffness),
    "kyy": Instead("frequency_y", "rad/s", True, _stiffness),
    "kxy": Instead("quadrature", "rad/s", False, _quadrature),
    "dxx": Instead("quality_factor_x", "1", True, lambda before, q: math.sqrt(before["kxx"] * before["mass"]) / q),
    "dyy": Instead("quality_factor_y", "1", True, lambda before, q: math.sqrt(before["kyy"] * before["mass"]) / q),
}
"""Of a single mass: frequencies of the uncoupled axes, the rate that looks like the coupling at that of x, and quality
factors. Intervals add up."""
BY_MASS = {"static_gain": Instead("mass", "kg", True, lambda before, m: 1.0 / (m * before["resonance"] ** 2))}
"""Of a resonator whose displacement is a length and whose drive a force: its mass."""


def gain_by_mass(file: CaseFile, resonance: float) -> DesignValue | None:
    """Of a resonator whose mass is declared, the static gain at the resonance [rad/s] that the records show."""
    given = file.design.get("mass")
    if given is None or file.device != "resonator":
        return None
    return _instead(given, BY_MASS["static_gain"], {"resonance": DesignValue(resonance, resonance, resonance)})


_FOR_A_MASS = (
    "but where its displacement is a length, by `scale` under `[readout]`, and its drive a force, by `[drive]` with "
    '`unit = "N"`, or with a `scale` such as "uN/V"'
)
UNKNOWN = DesignValue(math.nan, -math.inf, math.inf, unknown=True)


def design(file: CaseFile, source: Source, words: Vocabulary) -> dict[str, DesignValue]:
    """The design values in SI, also from what `BY_MODES` has in their place; what is left out, or declared unknown, is
    left to the records. Raises `InputError` with line and key for what is not a key, given twice or impossible.
    """
    by_modes = BY_MODES if file.device == "single_mass" else BY_MASS if words.design["static_gain"] == "m/(N)" else {}
    known = (*words.design, *(other.key for other in by_modes.values()))
    for key in file.design:
        if key not in known:
            with source.section("design", key):
                told = _FOR_A_MASS if key == "mass" else f"({suggestion(key, known)})"
                raise InputError(f"is not known to a {file.device} {told}")
    values: dict[str, DesignValue] = {}
    for key, unit in words.design.items():
        other = by_modes.get(key)
        if other is not None and other.key in file.design:
            with source.section("design", other.key):
                _check_unit(file.design[other.key], other.key, other.unit, source)
                if key in file.design:
                    raise InputError(f"must not stand beside {key}, which it gives; leave one of them out")
                values[key] = _instead(file.design[other.key], other, values)
                if other.key == "mass":
                    values["mass"] = _design_value(file.design["mass"], other.unit, other.positive)
            continue
        with source.section("design", key):
            given = file.design.get(key)
            _check_unit(given, key, unit, source)
            if given is not None and not given.unknown:
                with _in_lengths(key, unit):
                    values[key] = _design_value(given, unit, key in words.positive)
            elif key == "mass":  # part of the gain: all else is per mass until the records tell
                values[key] = DesignValue(1.0, 1.0, 1.0, unknown=True)
            else:
                values[key] = _unknown(key in words.positive)
    if file.device == "single_mass":
        with source.section("design", "kxy"):
            if values["kxy"].value ** 2 >= values["kxx"].value * values["kyy"].value:
                raise InputError("must be smaller than the geometric mean of kxx and kyy, else the mass is not held")
    return values


@contextmanager
def _in_lengths(key: str, unit: str) -> Iterator[None]:
    """Says of a static gain in volts, beside a scale that makes lengths of them, what to do."""
    try:
        yield
    except InputError as error:
        if key != "static_gain" or not unit.startswith("m/") or "must measure the same" not in str(error):
            raise
        way = "as `[readout]` has a scale, displacements are lengths; a gain that nothing needs is left out"
        raise InputError(f"{str(error).rstrip('.')} ({way})") from error


def _check_unit(entry: DesignEntry | None, key: str, unit: str, source: Source) -> None:
    if entry is not None and entry.unit is None and not entry.unknown:
        with source.section("design", key, "unit"):
            raise InputError(f'is missing; give one, such as "{unit}", or `unknown = true` instead of a value')


def _unknown(positive: bool) -> DesignValue:
    return replace(UNKNOWN, low=0.0) if positive else UNKNOWN


def _instead(entry: DesignEntry, other: Instead, before: dict[str, DesignValue]) -> DesignValue:
    """The value from what stands in its place, lowest and highest over the corners of all intervals."""
    given = _design_value(entry, other.unit, other.positive)
    at = lambda name: {key: getattr(value, name) for key, value in before.items()}  # noqa: E731
    if given.unknown or math.isnan(middle := other.value(at("value"), given.value)):
        return _unknown(other.positive)
    corners = [other.value(at(name), end) for name in ("low", "high") for end in (given.low, given.high)]
    return DesignValue(middle, min(corners), max(corners))


def _design_value(entry: DesignEntry, unit: str, positive: bool) -> DesignValue:
    if entry.unknown:
        return _unknown(positive)
    given = {name: number for name, number in entry if isinstance(number, float)}
    in_si = {
        name: si(Amount(number, entry.unit or "1"), unit, positive=positive)
        for name, number in given.items()
        if name != "tolerance"
    }
    names = set(given)
    if names == {"value", "tolerance"}:
        value, share = in_si["value"], given["tolerance"]
        low, high = sorted((value * (1 - share), value * (1 + share)))
    elif names in ({"low", "high"}, {"value", "low", "high"}):
        low, high = in_si["low"], in_si["high"]
        value = in_si.get("value", (low + high) / 2)
    else:
        found = " and ".join(f"`{name}`" for name in given) or "neither"
        raise InputError(f"must have `value` and `tolerance`, or `low` and `high`, but has {found}")
    if not low <= value <= high:
        raise InputError(f"must lie between low and high, but {value:g} does not lie between {low:g} and {high:g}")
    return DesignValue(value, low, high)


def readout(file: CaseFile, source: Source, recorded: str) -> Readout:
    """The read-out in SI, whose scale decides whether records are in volts, digital units or what the files name;
    without a scale a record is taken for the displacement, velocity or acceleration itself.

    Args:
        file, source: `case.toml`.
        recorded: unit of the readings as the header of the files has it.
    """
    entry: ReadoutEntry = file.readout
    order, own = QUANTITIES.index(entry.quantity), "m" if file.device == "single_mass" else ""
    if entry.scale is None:
        unit, scale, length = recorded, 1.0, _length(recorded, order)
    else:
        with source.section("readout", "scale"):
            unit, scale, length = _record_unit(entry.scale.amount, order, own, recorded)
            if scale == 0:
                raise InputError("must not be zero")
    adc_range = None
    if entry.adc_range is not None:
        with source.section("readout", "adc_range"):
            adc_range = si(entry.adc_range, unit)
    tolerance = 0.0 if entry.scale is None else entry.scale.tolerance
    return Readout(scale, adc_range, unit, order, "" if (own or "V") == length else length, tolerance)


def _length(recorded: str, order: int) -> str:
    """Unit of the displacement of which records show a derivative."""
    per = ("", "/s", "/s**2")[order]
    whole = recorded.replace("^2", "**2")
    return whole.removesuffix(per) if per and whole.endswith(per) else recorded + order * "*s"


def _record_unit(scale: Amount, order: int, own: str, recorded: str) -> tuple[str, float, str]:
    """Unit of the records, the scale in it, and the unit of the displacement that fit a scale per derivative."""
    per, first = ("", "/s", "/s**2")[order], None
    for length in (own,) if own else dict.fromkeys((_length(recorded, order), "V", "m", "1")):
        for unit in dict.fromkeys(("V", *("1",) * (length == "m"), recorded)):
            try:
                return unit, si(scale, f"{unit}/({length}{per})" if per else f"{unit}/{length}", positive=False), length
            except InputError as error:
                first = first or error
    raise first or InputError("must have a unit")


def drive(file: CaseFile, source: Source, recorded: str) -> Drive | None:
    """What drives the device, from the section or from the unit `recorded` in files and sections; `None` where it is
    what drives such a device usually.
    """
    usual = "N" if file.device == "single_mass" else "V"
    if file.drive is None:
        return None if recorded in ("", usual) else Drive(recorded)
    with source.section("drive", "scale"):
        scale = (
            None if file.drive.scale is None else si(file.drive.scale.amount, f"N/({file.drive.unit})", positive=False)
        )
    return Drive(file.drive.unit, scale, 0.0 if file.drive.scale is None else file.drive.scale.tolerance)


def environment(file: CaseFile, source: Source) -> Environment:
    """The environment in SI."""
    with source.section("environment", "temperature"):
        temperature = check_temperature(si(file.environment.temperature, "K"))
    with source.section("environment", "bias_voltage"):
        return Environment(temperature, si(file.environment.bias_voltage, "V", positive=False))
