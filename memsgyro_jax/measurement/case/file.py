"""`case.toml` as a whole: its sections, as they are written, and the checks that need no other file."""

from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BeforeValidator, Field, StrictBool, StrictFloat

from memsgyro_jax.base.complaints import Source
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.quantity import FileSection, Whole, number_and_unit
from memsgyro_jax.base.toml import checked, read_toml


SCHEMA = "memsgyro-case/1"
FILE = "case.toml"


class Amount(NamedTuple):
    """A number with its unit, as written."""

    number: float
    unit: str


def _amount(given: Any) -> Amount:
    if isinstance(given, Amount):
        return given
    try:
        number, unit = number_and_unit(given)
    except OverflowError as error:
        raise ValueError("must be a finite number, but is larger than any") from error
    if not unit:
        raise ValueError(f'must carry a unit, for example {{ value = {number:g}, unit = "V" }}, but none was given')
    return Amount(number, unit)


def _name(given: Any) -> Any:
    if isinstance(given, str) and (not given.isprintable() or given != given.strip() or not given):
        raise ValueError(f"must be printable text without blanks at its ends, but is {given!r}")
    return given


Quantity = Annotated[Amount, BeforeValidator(_amount)]
Name = Annotated[str, BeforeValidator(_name)]
Axis = Literal["x", "y"]


class DesignEntry(FileSection):
    """`{ value, tolerance, unit }` with a relative half width, or `{ low, high, unit }`, or all of value, low, high."""

    unit: str
    value: StrictFloat | None = None
    tolerance: StrictFloat | None = Field(default=None, ge=0.0, lt=1.0)
    low: StrictFloat | None = None
    high: StrictFloat | None = None


class ReadoutEntry(FileSection):
    """Section `[readout]`."""

    scale: Quantity
    adc_range: Quantity | None = None


class EnvironmentEntry(FileSection):
    """Section `[environment]`."""

    temperature: Quantity = Amount(25.0, "degC")
    bias_voltage: Quantity = Amount(0.0, "V")


class Entry(FileSection):
    """What every `[[experiment]]` may say."""

    name: Name
    file: Name
    role: Literal["fit", "validation"] | None = None
    note: str = ""
    noise_std: Quantity | None = None
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = None


class SweepEntry(Entry):
    """Frequency sweep; the drive level stands here or in a column `F_x` or `F_y`."""

    kind: Literal["frequency_sweep"]
    settled: StrictBool
    drive_axis: Axis | None = None
    drive_force: Quantity | None = None


class RingDownEntry(Entry):
    """Ring-down."""

    kind: Literal["ring_down"]
    drive_axis: Axis | None = None
    drive_force: Quantity
    drive_frequency: Quantity
    drive_duration: Quantity


class RateTableEntry(Entry):
    """Rate table."""

    kind: Literal["rate_table"]
    drive_axis: Axis | None = None
    drive_force: Quantity
    drive_frequency: Quantity
    lock_in_cycles: Annotated[Whole, Field(gt=0, le=10**9)]
    rate_reference: Literal["table", "calibrated"] = "table"


class TimeEntry(Entry):
    """Raw signals under held forces."""

    kind: Literal["time_record"]
    hold: Literal["zero_order", "linear", "band_limited"]
    start: Literal["rest", "unknown"]


AnyEntry = Annotated[SweepEntry | RingDownEntry | RateTableEntry | TimeEntry, Field(discriminator="kind")]


class CaseFile(FileSection):
    """All sections."""

    format: Literal["memsgyro-case/1"] = Field(alias="schema")
    name: Name
    description: str = ""
    device: Literal["single_mass", "resonator"]
    design: dict[str, DesignEntry]
    readout: ReadoutEntry
    environment: EnvironmentEntry = EnvironmentEntry()
    conventions: dict[str, str] = Field(default_factory=dict)
    experiment: tuple[AnyEntry, ...] = Field(min_length=1)


def read_file(path: Path) -> tuple[CaseFile, Source]:
    """The sections of `case.toml`; raises `InputError` with line and key of everything that is wrong with them."""
    data, source = read_toml(path, "file", f"a measurement case is a folder with a `{FILE}`")
    file = checked(CaseFile, data, source)
    _refuse_twins(file, source)
    return file, source


def _refuse_twins(file: CaseFile, source: Source) -> None:
    """One name and one file per experiment: a record that is fitted must not judge the fit under another name."""
    for key in ("name", "file"):
        seen: dict[str, int] = {}
        for number, entry in enumerate(file.experiment):
            value = getattr(entry, key)
            if value in seen:
                with source.section("experiment", number, key):
                    raise InputError(
                        f'must differ from that of every other experiment, but "{value}" is also that of number '
                        f"{seen[value] + 1}"
                    )
            seen[value] = number
