"""Sections `[design]`, `[readout]` and `[environment]` of a case, in SI."""

import math
from collections.abc import Callable
from typing import NamedTuple

from memsgyro_jax.base.complaints import Source
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import suggestion

from ..declared import VOCABULARIES, DesignValue, Environment, Readout, check_temperature, si
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


def design(file: CaseFile, source: Source) -> dict[str, DesignValue]:
    """The design values in SI, also from what `BY_MODES` has in their place; raises `InputError` with line and key for
    what is missing, unknown, given twice or impossible.
    """
    words = VOCABULARIES[file.device]
    by_modes = BY_MODES if file.device == "single_mass" else {}
    known = (*words.design, *(other.key for other in by_modes.values()))
    for key in file.design:
        if key not in known:
            with source.section("design", key):
                raise InputError(f"is not known to a {file.device} ({suggestion(key, known)})")
    values: dict[str, DesignValue] = {}
    for key, unit in words.design.items():
        other = by_modes.get(key)
        if other is not None and other.key in file.design:
            with source.section("design", other.key):
                if key in file.design:
                    raise InputError(f"must not stand beside {key}, which it gives; leave one of them out")
                values[key] = _instead(file.design[other.key], other, values)
            continue
        with source.section("design", key):
            if key not in file.design:
                raise InputError(f'is missing; give {{ value, tolerance, unit = "{unit}" }}')
            values[key] = _design_value(file.design[key], unit, key in words.positive)
    if file.device == "single_mass":
        with source.section("design", "kxy"):
            if values["kxy"].value ** 2 >= values["kxx"].value * values["kyy"].value:
                raise InputError("must be smaller than the geometric mean of kxx and kyy, else the mass is not held")
    return values


def _instead(entry: DesignEntry, other: Instead, before: dict[str, DesignValue]) -> DesignValue:
    """The value from what stands in its place, lowest and highest over the corners of all intervals."""
    given = _design_value(entry, other.unit, other.positive)
    at = lambda name: {key: getattr(value, name) for key, value in before.items()}  # noqa: E731
    corners = [other.value(at(name), end) for name in ("low", "high") for end in (given.low, given.high)]
    return DesignValue(other.value(at("value"), given.value), min(corners), max(corners))


def _design_value(entry: DesignEntry, unit: str, positive: bool) -> DesignValue:
    given = {name: number for name, number in entry if isinstance(number, float)}
    in_si = {
        name: si(Amount(number, entry.unit), unit, positive=positive)
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


def readout(file: CaseFile, source: Source) -> Readout:
    """The read-out in SI, whose scale decides whether records are in volts or in digital units."""
    entry: ReadoutEntry = file.readout
    length = VOCABULARIES[file.device].displacement
    with source.section("readout", "scale"):
        unit, scale = _record_unit(entry.scale, length)
        if scale == 0:
            raise InputError("must not be zero")
    adc_range = None
    if entry.adc_range is not None:
        with source.section("readout", "adc_range"):
            adc_range = si(entry.adc_range, unit)
    return Readout(scale, adc_range, unit)


def _record_unit(scale: Amount, length: str) -> tuple[str, float]:
    """Unit of the records, volts or (for a displacement in metres) digital, and the scale in it."""
    try:
        return "V", si(scale, f"V/{length}", positive=False)
    except InputError:
        if length == "m":
            try:
                return "1", si(scale, "1/m", positive=False)
            except InputError:
                pass
        raise


def environment(file: CaseFile, source: Source) -> Environment:
    """The environment in SI."""
    with source.section("environment", "temperature"):
        temperature = check_temperature(si(file.environment.temperature, "K"))
    with source.section("environment", "bias_voltage"):
        return Environment(temperature, si(file.environment.bias_voltage, "V", positive=False))
