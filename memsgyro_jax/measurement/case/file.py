"""`case.toml` as a whole: its sections, as they are written, and the checks that need no other file."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Union

from pydantic import Field, create_model

from memsgyro_jax.base.complaints import Source
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.quantity import FileSection, Number
from memsgyro_jax.base.toml import checked, read_toml

from ..experiments import KINDS, AbstractRecord
from ..section import Amount, Calibrated, ExperimentSection, Name, Quantity


SCHEMA = "memsgyro-case/1"
FILE = "case.toml"


class DesignEntry(FileSection):
    """`{ value, tolerance, unit }` with a relative half width, or `{ low, high, unit }`, or all of value, low, high, or
    `{ unknown = true }`, which is to leave it out.
    """

    unit: str | None = None
    unknown: bool = False
    value: Number | None = None
    tolerance: Number | None = Field(default=None, ge=0.0, lt=1.0)
    low: Number | None = None
    high: Number | None = None


class ReadoutEntry(FileSection):
    """Section `[readout]`."""

    quantity: Literal["displacement", "velocity", "acceleration"] = "displacement"
    scale: Calibrated | None = None
    adc_range: Quantity | None = None


class DriveEntry(FileSection):
    """Section `[drive]`."""

    unit: str
    scale: Calibrated | None = None


class EnvironmentEntry(FileSection):
    """Section `[environment]`."""

    temperature: Quantity = Amount(25.0, "degC")
    bias_voltage: Quantity = Amount(0.0, "V")


class CaseFile(FileSection):
    """All sections; those of the experiments as far as every kind has them."""

    format: Literal["memsgyro-case/1"] = Field(alias="schema")
    name: Name
    description: str = ""
    device: Literal["single_mass", "resonator"]
    design: dict[str, DesignEntry] = Field(default_factory=dict)
    readout: ReadoutEntry = ReadoutEntry()
    drive: DriveEntry | None = None
    environment: EnvironmentEntry = EnvironmentEntry()
    conventions: dict[str, str] = Field(default_factory=dict)
    experiment: tuple[ExperimentSection, ...] = Field(min_length=1)


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
