"""Sections `[design]`, `[readout]` and `[environment]` of a case, in SI."""

from memsgyro_jax.base.complaints import Source
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import suggestion

from ..declared import VOCABULARIES, DesignValue, Environment, Readout, check_temperature, si
from ..section import Amount
from .file import CaseFile, DesignEntry, ReadoutEntry


def design(file: CaseFile, source: Source) -> dict[str, DesignValue]:
    """The design values in SI; raises `InputError` with line and key for what is missing, unknown or impossible."""
    words = VOCABULARIES[file.device]
    for key in file.design:
        if key not in words.design:
            with source.section("design", key):
                raise InputError(f"is not known to a {file.device} ({suggestion(key, words.design)})")
    values = {}
    for key, unit in words.design.items():
        with source.section("design", key):
            if key not in file.design:
                raise InputError(f'is missing; give {{ value, tolerance, unit = "{unit}" }}')
            values[key] = _design_value(file.design[key], unit, key in words.positive)
    if file.device == "single_mass":
        with source.section("design", "kxy"):
            if values["kxy"].value ** 2 >= values["kxx"].value * values["kyy"].value:
                raise InputError("must be smaller than the geometric mean of kxx and kyy, else the mass is not held")
    return values


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
