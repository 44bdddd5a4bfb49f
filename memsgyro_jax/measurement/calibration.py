"""What the tolerances of the read-out's and the drive's scale leave unsure of a number in SI, whatever records say.

Records hold volts. Had the scale been larger by the share a and the drive's by b, all lengths would be smaller by a and
all forces larger by b, while frequencies, damping rates and everything in volts stay: a number of unit Nᵖ mʳ moves by
p·b − r·a. A mass declared beside both scales holds a + b, as the gain of the records is their product over the mass.
"""

import re

import numpy as np

from memsgyro_jax.base.text import listed
from memsgyro_jax.base.units import base_powers

from .declared import Declared


_OF_READINGS = ("V", "V/N", "V·s/N", "1/V")  # of terms of the read-out; of a bias there are squares


def calibration_share(declared: Declared, unit: str) -> float:
    """Relative standard deviation of a number of that unit by the calibration of a case alone; zero for one that does
    not hang on it, and where no scale has a tolerance.
    """
    drive = declared.drive
    spread = np.diag([declared.readout.tolerance**2, 0.0 if drive is None else drive.tolerance**2])
    if not spread.any():
        return 0.0
    mass = _mass_tolerance(declared)
    both = spread.sum(axis=1)
    spread = spread - np.outer(both, both) / (both.sum() + mass**2)
    lengths, forces = _powers(unit)
    moved = np.array([-lengths, forces])
    return float(np.sqrt(max(0.0, moved @ spread @ moved)))


def calibration_text(declared: Declared) -> str:
    """The scales of a case and how well they are known, in a sentence; empty where it has none."""
    readout, drive = declared.readout, declared.drive
    length = declared.words.displacement + readout.order * "/s"
    known = []
    if length.startswith("m") and (readout.scale, readout.unit) != (1.0, length):
        known.append(f"read-out {readout.scale:.5g} {readout.unit}/{bracketed(length)}{_within(readout.tolerance)}")
    if drive is not None and drive.scale is not None:
        known.append(f"drive {drive.scale:.5g} N/{drive.unit}{_within(drive.tolerance)}")
    return f"Calibration: {listed(known)}." if known else ""


def length_of_records(declared: Declared) -> str:
    """What displacements are in: metres, or what the records are in and its integrals, of a current a charge."""
    named = declared.words.displacement.replace("*", "·")
    return "C" if named == "A·s" else named


def per_second(length: str) -> str:
    """The unit of a velocity, of displacements in `length`: that of a charge is a current."""
    return "A" if length == "C" else length.removesuffix("·s") if length.endswith("·s") else f"{bracketed(length)}/s"


def unit_of_records(declared: Declared, unit: str) -> str:
    """What a number of that SI unit is in where a case does not say what its records are in metres and newtons: of a
    resonator's spring, V/V³ for N/m³. A reading is in what the read-out is in.
    """
    if unit in _OF_READINGS:
        unit = _of_readings(unit, declared.readout.unit.replace("*", "·"))
    length, force = length_of_records(declared), declared.words.force.replace("*", "·")
    if (length, force) == ("m", "N"):
        return unit
    length, force = (bracketed(name) for name in (length, force))
    if unit == "1/kg":
        return f"{length}/({force}·s²)"
    told = {"m": length, "N": force, "kg": f"({force}·s²/{length})", "W": f"({force}·{length}/s)"}
    named = re.sub(r"[A-Za-z]+", lambda word: told.get(word[0], word[0]), unit)
    return re.sub(r"/1[²³]?(?![\d·])|(?<=\()1·", "", named)  # readings without a unit


def units_of_records(declared: Declared) -> str:
    """A line on what m and N stand for in numbers of a case that does not say its records in them; else empty."""
    length, force = length_of_records(declared), declared.words.force
    if (length, force) == ("m", "N"):
        return ""
    return f"lengths are in {length} and forces in {force}, as the records are: m stands for {length}, N for {force}"


def _of_readings(unit: str, reading: str) -> str:
    """The same in the unit of the readings, "1" where they are numbers."""
    told = reading if unit == "V" else unit.replace("V", bracketed(reading))
    return {"1/1": "1", "1·s/N": "s/N"}.get(told, told)


def bracketed(unit: str) -> str:
    """A unit that may stand before a power or below a slash."""
    return f"({unit})" if re.search("[/·]", unit) else unit


def _within(tolerance: float) -> str:
    return f" ± {100 * tolerance:.3g} %" if tolerance else " (taken for exact: no tolerance)"


def _mass_tolerance(declared: Declared) -> float:
    """Relative half width of the declared mass; infinite where it is not declared."""
    value = declared.design.get("mass") or declared.design.get("static_gain")
    if value is None or value.unknown or not value.value:
        return np.inf
    return abs((value.high - value.low) / (2.0 * value.value))


def _powers(unit: str) -> tuple[float, float]:
    """Powers of length and of force, of which a mass is N s²/m; volts are what records have, and count for nothing."""
    powers = base_powers(unit)
    volts = -powers.get("ampere", 0.0)  # V = kg m² s⁻³ A⁻¹
    masses = powers.get("kilogram", 0.0) - volts
    lengths = powers.get("meter", 0.0) - 2.0 * volts
    return lengths - masses, masses
