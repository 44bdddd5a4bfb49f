"""Reading a measurement case: `case.toml` and the CSV files it names, checked so that nothing is silently wrong."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from memsgyro_jax.base.complaints import Source
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import read_table

from . import checks
from .columns import Columns
from .device import VOCABULARIES, design, environment, readout, resonances, si
from .file import FILE, Amount, Entry, RateTableEntry, RingDownEntry, SweepEntry, TimeEntry, read_file
from .records import AbstractRecord, Case, FrequencySweepRecord, RateTableRecord, RingDownRecord, TimeRecord


def load_case(folder: str | Path) -> Case:
    """Reads the measurement case in a folder: `case.toml` and the CSV files that it names.

    Quantities may have any unit of their kind, CSV headers name each column with its unit. Everything is checked that
    the files, the declarations and the design say of each other; a file with a declared `sha256` must have it.

    Args:
        folder: of the case, or its `case.toml`.

    Raises:
        InputError: one sentence with file, and line, key or column, and what must hold.
    """
    folder = Path(folder)
    path = folder if folder.is_file() else folder / FILE
    file, source = read_file(path)
    case = Case(
        folder=path.parent,
        name=file.name,
        description=file.description,
        device=file.device,
        design=design(file, source),
        readout=readout(file, source),
        environment=environment(file, source),
        conventions=dict(file.conventions),
        records=(),
    )
    records = [_Experiment(case, source, number, entry).read() for number, entry in enumerate(file.experiment)]
    return replace(case, records=tuple(records))


Kind = TypeVar("Kind", bound=Entry)


@dataclass(frozen=True)
class _Experiment(Generic[Kind]):
    """One `[[experiment]]` on its way to a record."""

    case: Case
    source: Source
    number: int
    entry: Kind

    def read(self) -> AbstractRecord:
        path = self._path()
        columns = Columns(read_table(path), VOCABULARIES[self.case.device], self.case.readout.unit)
        record = _READERS[type(self.entry)](self, columns)
        checks.check(record, columns.table, self.case.readout, resonances(self.case.design))
        return record

    def amount(self, key: str, unit: str) -> float:
        """A positive quantity of the experiment in SI."""
        with self.source.section("experiment", self.number, key):
            return si(getattr(self.entry, key), unit)

    def frequency(self, key: str) -> float:
        """A drive frequency [rad/s], near where a die within the design may resonate."""
        value = self.amount(key, "rad/s")
        with self.source.section("experiment", self.number, key):
            checks.near_resonance(value, value, resonances(self.case.design))
        return value

    def axis(self, given: str | None) -> int:
        """The driven axis; a device of one axis needs no word."""
        with self.source.section("experiment", self.number, "drive_axis"):
            if given is None and self.case.channels == 2:
                raise InputError('is missing; give "x" or "y"')
            if given == "y" and self.case.channels == 1:
                raise InputError('must be "x" for a device of one axis, but is "y"')
        return 1 if given == "y" else 0

    def force_unit(self) -> str:
        """Unit of the drive."""
        return VOCABULARIES[self.case.device].force

    def common(self, columns: Columns) -> dict[str, Any]:
        """What every record holds."""
        entry = self.entry
        noise = None if entry.noise_std is None else self._noise(entry.noise_std)
        lines = columns.table.lines
        return {
            "name": entry.name, "file": entry.file, "lines": lines, "role": entry.role, "note": entry.note,
            "noise_std": noise,
        }  # fmt: skip

    def _noise(self, noise: Amount) -> float:
        with self.source.section("experiment", self.number, "noise_std"):
            if noise.number <= 0:
                raise InputError(
                    f"must be positive, but is {noise.number:g} {noise.unit}; leave it out to have it estimated"
                )
            return si(noise, self.case.readout.unit)

    def _path(self) -> Path:
        """The CSV file, which must lie below the folder of the case and be the one that was declared."""
        with self.source.section("experiment", self.number, "file"):
            name, folder = Path(self.entry.file), self.case.folder
            inside = not name.is_absolute() and ".." not in name.parts and "\\" not in self.entry.file
            if not (inside and (folder / name).resolve().is_relative_to(folder.resolve())):
                raise InputError(f'must name a file below the folder of the case, but is "{name}"')
            path = folder / name
            if not path.is_file():
                raise InputError(f'must name a file that exists, but there is no "{name}" in {folder}')
        if self.entry.sha256 is not None:
            with self.source.section("experiment", self.number, "sha256"):
                found = hashlib.sha256(path.read_bytes()).hexdigest()
                if found != self.entry.sha256:
                    raise InputError(
                        f"must be the checksum of {name}, but that file has {found[:12]}…: it was changed since; "
                        "restore it, or remove the key if the change is meant"
                    )
        return path


def _sweep(experiment: _Experiment[SweepEntry], columns: Columns) -> FrequencySweepRecord:
    entry, around = experiment.entry, experiment.case.environment
    axis = experiment.axis(entry.drive_axis)
    drives = [name for group in columns.words.drives for name in group]
    conditions = ("T", "V_bias", "rate", "t")
    columns.refuse_others(["f", *columns.signal_names("_I", "_Q", "_amp", "_phase"), *drives, *conditions])
    drive = columns.drive(axis)
    with experiment.source.section("experiment", experiment.number, "drive_force"):
        if drive is not None and entry.drive_force is not None:
            raise InputError("must be left out where a column holds the drive level")
        if drive is None and entry.drive_force is None:
            name = columns.words.drives[-1][axis]
            raise InputError(f"is missing; give the drive level here or in a column `{name}` of {entry.file}")
    if drive is None:
        drive = np.full(len(columns.table.lines), experiment.amount("drive_force", experiment.force_unit()))
    return FrequencySweepRecord(
        **experiment.common(columns),
        axis=axis,
        settled=entry.settled,
        frequency=columns.frequency(),
        drive=drive,
        temperature=columns.optional("T", "K", around.temperature),
        bias_voltage=columns.optional("V_bias", "V", around.bias_voltage),
        rate=columns.optional("rate", "rad/s", 0.0),
        phasors=columns.phasors(),
        time=columns.time() if columns.has("t") else None,
    )


def _ring_down(experiment: _Experiment[RingDownEntry], columns: Columns) -> RingDownRecord:
    columns.refuse_others(["t", *columns.signal_names("")])
    return RingDownRecord(
        **experiment.common(columns),
        axis=experiment.axis(experiment.entry.drive_axis),
        drive_force=experiment.amount("drive_force", experiment.force_unit()),
        drive_frequency=experiment.frequency("drive_frequency"),
        drive_duration=experiment.amount("drive_duration", "s"),
        time=columns.time(),
        signals=columns.signals(),
    )


def _rate_table(experiment: _Experiment[RateTableEntry], columns: Columns) -> RateTableRecord:
    columns.refuse_others(["t", "rate", *columns.signal_names("_I", "_Q", "_amp", "_phase")])
    return RateTableRecord(
        **experiment.common(columns),
        axis=experiment.axis(experiment.entry.drive_axis),
        drive_force=experiment.amount("drive_force", experiment.force_unit()),
        drive_frequency=experiment.frequency("drive_frequency"),
        lock_in_cycles=experiment.entry.lock_in_cycles,
        rate_calibrated=experiment.entry.rate_reference == "calibrated",
        has_rate=columns.has("rate"),
        time=columns.time(),
        rate=columns.optional("rate", "rad/s", 0.0),
        phasors=columns.phasors(),
    )


def _time_record(experiment: _Experiment[TimeEntry], columns: Columns) -> TimeRecord:
    inputs = [name for group in columns.words.forces for name in group]
    columns.refuse_others(["t", *inputs, *columns.signal_names(""), "rate"])
    return TimeRecord(
        **experiment.common(columns),
        hold=experiment.entry.hold,
        start=experiment.entry.start,
        time=columns.time(),
        forces=columns.forces(),
        signals=columns.signals(),
        rate=columns.optional("rate", "rad/s", 0.0),
    )


_READERS: dict[type[Entry], Callable[[Any, Columns], AbstractRecord]] = {
    SweepEntry: _sweep,
    RingDownEntry: _ring_down,
    RateTableEntry: _rate_table,
    TimeEntry: _time_record,
}
