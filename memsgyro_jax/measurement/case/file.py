"""`case.toml` as a whole: its sections, as they are written, and the checks that need no other file."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Union

from pydantic import Field, create_model

from memsgyro_jax.base.complaints import Source
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.quantity import FileSection, Number, number_and_unit
from memsgyro_jax.base.toml import checked, read_toml, toml_text

from ..experiments import KINDS, AbstractRecord
from ..section import Calibrated, ExperimentSection, Name, Quantity, Temperature, Voltage


SCHEMA = "memsgyro-case/1"
FILE = "case.toml"


class DesignEntry(FileSection):
    """`{ value, tolerance, unit }` with a relative half width, or `{ low, high, unit }`, or all of value, low, high, or
    `{ unknown = true }`, which is to leave it out.
    """

    unit: str | None = None
    """Unit of `value`, `low` and `high`."""
    unknown: bool = False
    """Whether the number is left to the records, as one that is left out is."""
    value: Number | None = None
    """What the maker meant, in `unit`."""
    tolerance: Number | None = Field(default=None, ge=0.0, lt=1.0)
    """Half width of the interval in which the die lies, as a share of `value`."""
    low: Number | None = None
    """Lower end of that interval, in `unit`."""
    high: Number | None = None
    """Upper end of that interval, in `unit`."""

    @classmethod
    def alone(cls, given: Any) -> str:
        """The number or the interval that was `given` as an entry is written; any where it is neither."""
        if isinstance(given, list) and len(given) == 2 and all(type(end) in (int, float) for end in given):
            return f"{{ low = {given[0]:g}, high = {given[1]:g} }}"
        try:
            number, unit = number_and_unit(given)
        except ValueError:
            number, unit = 100.0, ""
        return f"{{ value = {number:g}, {f'unit = {toml_text(unit)}, ' if unit else ''}tolerance = 0.1 }}"


class ReadoutEntry(FileSection):
    """Section `[readout]`: what the readings are of."""

    quantity: Literal["displacement", "velocity", "acceleration"] = "displacement"
    """What the read-out shows."""
    scale: Calibrated | None = None
    """Reading per displacement, velocity or acceleration, in a unit like V/m, and how well it is known; left out, the
    readings are taken for that quantity itself."""
    adc_range: Quantity | None = None
    """Largest reading of the converter, to either side, in a unit of the readings; left out, none is checked."""


class DriveEntry(FileSection):
    """Section `[drive]`: what drives the device."""

    unit: str
    """Unit of the drive in the records: "N", "V" or "A"."""
    scale: Calibrated | None = None
    """Force per drive, in a unit like N/V, and how well it is known; left out, it is part of the gain that a fit
    finds."""


class EnvironmentEntry(FileSection):
    """Section `[environment]`: what holds where records do not say otherwise."""

    temperature: Temperature = Field(default="25 degC", validate_default=True)
    """Temperature where a record has no column `T`."""
    bias_voltage: Voltage = Field(default="0 V", validate_default=True)
    """Bias voltage of the electrodes where a record has no column `V_bias`."""


class CaseFile(FileSection):
    """All sections; those of the experiments as far as every kind has them."""

    format: Literal["memsgyro-case/1"] = Field(alias="schema")
    """Format of the file, and its version."""
    name: Name
    """Name of the case."""
    description: str = ""
    """Free text."""
    device: Literal["single_mass", "resonator"]
    """A mass with two axes, or a resonator with one."""
    design: dict[str, DesignEntry] = Field(default_factory=dict)
    """What the maker meant, by name ("mass", "kxx", "quality_factor"); what is left out is found from the records."""
    readout: ReadoutEntry = ReadoutEntry()
    """What the readings are of."""
    drive: DriveEntry | None = None
    """What drives the device; left out, what the units of the files say, else a force on two axes, volts on one."""
    environment: EnvironmentEntry = EnvironmentEntry()
    """What holds where records do not say otherwise."""
    conventions: dict[str, str] = Field(default_factory=dict)
    """Free text by topic."""
    experiment: tuple[ExperimentSection, ...] = Field(min_length=1)
    """The records, each a table `[[experiment]]`."""


def read_file(path: Path, kinds: Sequence[type[AbstractRecord]]) -> tuple[CaseFile, Source]:
    """The sections of `case.toml`; raises `InputError` with line and key of everything that is wrong with them."""
    data, source = read_toml(path, "file", f"a measurement case is a folder with a `{FILE}`")
    file = checked(_with_kinds(tuple(kinds)), data, source)
    _refuse_twins(file, source)
    return file, source


def case_model() -> type[CaseFile]:
    """All sections with the kinds that the package knows."""
    return _with_kinds(tuple(KINDS))


@cache
def _with_kinds(kinds: tuple[type[AbstractRecord], ...]) -> type[CaseFile]:
    """All sections, each experiment with the keys of its kind."""
    tagged = [create_model(k.__name__, __base__=k.section, kind=(Literal[k.kind], ...)) for k in kinds]
    section: Any = Annotated[Union[tuple(tagged)], Field(discriminator="kind")]  # noqa: UP007
    return create_model("CaseFile", __base__=CaseFile, experiment=(tuple[section, ...], Field(min_length=1)))


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
