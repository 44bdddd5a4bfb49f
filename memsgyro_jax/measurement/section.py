"""What an `[[experiment]]` of `case.toml` may say, whatever its kind, and the quantities in it."""

import math
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BeforeValidator, Field, WithJsonSchema

from memsgyro_jax.base.quantity import FileSection, number_and_unit, quantity_schema


class Amount(NamedTuple):
    """A number with its unit, as written."""

    number: float
    unit: str


class Calibration(NamedTuple):
    """A number with its unit and the relative standard deviation with which it is known, as written."""

    amount: Amount
    tolerance: float = 0.0


_TOLERANCE = "Standard deviation (1σ) as a share of the value; left out, exact."


def _amount(given: Any) -> Amount:
    if isinstance(given, Amount):
        return given
    number, unit = number_and_unit(given)
    if not math.isfinite(number):
        raise ValueError(f"must be a finite number, but is {number:g}")
    if not unit:
        raise ValueError(f'must carry a unit, for example {{ value = {number:g}, unit = "V" }}, but none was given')
    return Amount(number, unit)


def _calibration(given: Any) -> Any:
    if isinstance(given, Calibration):
        return given
    tolerance = 0.0
    if isinstance(given, dict) and "tolerance" in given:
        tolerance = given["tolerance"]
        given = {key: value for key, value in given.items() if key != "tolerance"}
        if isinstance(tolerance, bool) or not isinstance(tolerance, int | float) or not 0.0 <= tolerance < 1.0:
            raise ValueError("must have a relative `tolerance` from 0 to 1, for example tolerance = 0.05")
    return Calibration(_amount(given), float(tolerance))


def _name(given: Any) -> Any:
    if isinstance(given, str) and (not given.isprintable() or given != given.strip() or not given):
        raise ValueError(f"must be printable text without blanks at its ends, but is {given!r}")
    return given


Quantity = Annotated[Amount, BeforeValidator(_amount), WithJsonSchema(quantity_schema())]
Seconds = Annotated[Quantity, WithJsonSchema(quantity_schema("s"))]
Frequency = Annotated[Quantity, WithJsonSchema(quantity_schema("Hz"))]
Temperature = Annotated[Quantity, WithJsonSchema(quantity_schema("K"))]
Voltage = Annotated[Quantity, WithJsonSchema(quantity_schema("V"))]
Calibrated = Annotated[
    Calibration,
    BeforeValidator(_calibration),
    WithJsonSchema(quantity_schema(tolerance={"type": "number", "description": _TOLERANCE})),
]
Name = Annotated[str, BeforeValidator(_name)]
Axis = Literal["x", "y"]


class ExperimentSection(FileSection):
    """What every `[[experiment]]` may say; a kind adds its own keys in a subclass."""

    name: Name
    """Name of the record, one for each."""
    file: Name
    """The CSV file, below the folder of the case, one for each record."""
    role: Literal["fit", "validation"] | None = None
    """What it is for: "fit" lets a fit see all of it, "validation" none of it, so that it judges; left out, its kind
    decides which rows are fitted and which judge."""
    note: str = ""
    """Free text."""
    noise_std: Quantity | None = None
    """Standard deviation (1σ) of the noise of a single reading, of I and Q each, in a unit of the readings. Left out,
    that of columns `std`, or estimated from the record."""
    temperature_std: Temperature | None = None
    """Standard deviation (1σ) of the temperature at which the record was taken, a difference in K: by so much an oven
    may be off its set point, in all rows of one temperature alike. Left out, the temperature is exact."""
    convention: Literal["exp(+iwt)", "exp(-iwt)"] = "exp(+iwt)"
    """Time factor of the phasors: the sign with which their phase runs."""
    inverted: bool = False
    """Whether the readings have the other sign."""
    carried: tuple[str, ...] = ()
    """Names of columns that are meant to be there though nothing depends on them."""
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = None
    """Checksum that the file must have; left out, it is not checked."""


class DrivenSection(ExperimentSection):
    """What records of one driven axis say."""

    drive_axis: Axis | None = None
    """The driven electrode; needed of two axes."""


class ToneSection(DrivenSection):
    """What records of a drive at one frequency say."""

    drive_force: Quantity
    """Amplitude (peak) of the drive, a force, or in the unit that `[drive]` has for it."""
    drive_frequency: Frequency
    """Frequency of the drive."""
