"""What each device is called by in files: design keys and their units, columns and their units."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from memsgyro_jax.base.complaints import Source
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import suggestion
from memsgyro_jax.base.units import to_si

from .file import Amount, CaseFile, DesignEntry, ReadoutEntry
from .records import DesignValue, Environment, Readout


@dataclass(frozen=True)
class Vocabulary:
    """Names and units of one kind of device.

    Args:
        design: SI unit of each design key.
        positive: design keys that must be positive.
        displacement: unit of the displacement that the read-out scale divides by.
        force: unit of forces.
        signals: names of the channels; the first group that a file uses holds.
        forces: names of the raw inputs, likewise.
        drives: names of the drive levels, likewise.
    """

    design: Mapping[str, str]
    positive: tuple[str, ...]
    displacement: str
    force: str
    signals: tuple[tuple[str, ...], ...]
    forces: tuple[tuple[str, ...], ...]
    drives: tuple[tuple[str, ...], ...]


VOCABULARIES = {
    "single_mass": Vocabulary(
        design={"mass": "kg", "kxx": "N/m", "kyy": "N/m", "kxy": "N/m", "dxx": "N*s/m", "dyy": "N*s/m", "dxy": "N*s/m"},
        positive=("mass", "kxx", "kyy", "dxx", "dyy"),
        displacement="m",
        force="N",
        signals=(("Vx", "Vy"),),
        forces=(("u_x", "u_y"),),
        drives=(("F_x", "F_y"),),
    ),
    "resonator": Vocabulary(
        design={"resonance": "rad/s", "quality_factor": "1", "static_gain": "1"},
        positive=("resonance", "quality_factor"),
        displacement="V",
        force="V",
        signals=(("y",), ("Vx",)),
        forces=(("u",), ("u_x",)),
        drives=(("F",), ("F_x",)),
    ),
}


def si(amount: Amount, expected: str, *, positive: bool = True) -> float:
    """The amount in the SI unit `expected`; an angular frequency in rad/s may also be given in Hz."""
    number = angular(amount.number, amount.unit, "the value") if expected == "rad/s" else None
    number = to_si(amount.number, amount.unit, expected, "the value") if number is None else number
    if not np.isfinite(number):
        raise InputError(f"must be a finite number, but is {number:g} {expected}")
    if positive and not number > 0:
        raise InputError(f"must be positive, but is {amount.number:g} {amount.unit}")
    return float(number)


def angular(value: np.ndarray | float, unit: str, name: str) -> np.ndarray | float:
    """Frequency in rad/s, given in any unit of cycles or of angle per time; raises `InputError` for other units."""
    try:
        return 2 * np.pi * to_si(value, unit, "Hz", name)
    except InputError:
        pass
    try:
        return to_si(value, unit, "rad/s", name)
    except InputError as error:
        raise InputError(
            f'Unit of {name} must be one of frequency such as "Hz" or "rad/s", but is "{unit}".'
        ) from error


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
        temperature = si(file.environment.temperature, "K")
    with source.section("environment", "bias_voltage"):
        return Environment(temperature, si(file.environment.bias_voltage, "V", positive=False))


def resonances(design: Mapping[str, DesignValue]) -> tuple[float, float]:
    """Lowest and highest angular frequency [rad/s] at which a die within the design may resonate."""
    if "resonance" in design:
        return design["resonance"].low, design["resonance"].high
    mass, coupling = design["mass"], max(abs(design["kxy"].low), abs(design["kxy"].high))
    softest = min(design["kxx"].low, design["kyy"].low)
    stiffest = max(design["kxx"].high, design["kyy"].high)
    low = max(
        softest - coupling, 0.25 * softest
    )  # a coupling that would nearly buckle the die is no resonance to expect
    return float(np.sqrt(low / mass.high)), float(np.sqrt((stiffest + coupling) / mass.low))
