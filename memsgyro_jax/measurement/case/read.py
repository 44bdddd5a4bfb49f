"""Reading a measurement case: `case.toml` and the CSV files it names, checked so that nothing is silently wrong."""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from memsgyro_jax.base.complaints import Source
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import LARGEST_TABLE, read_whole
from memsgyro_jax.base.table import Table, read_table

from ..columns import Columns
from ..declared import Readout, vocabulary
from ..experiments import KINDS, AbstractRecord, Sheet
from ..section import ExperimentSection
from .content import Case
from .device import design, drive, environment, readout
from .file import FILE, read_file
from .unknown import recorded_units, with_found_design


def load_case(folder: str | Path, *, kinds: Sequence[type[AbstractRecord]] = ()) -> Case:
    """Reads the measurement case in a folder: `case.toml` and the CSV files that it names.

    Quantities may have any unit of their kind, CSV headers name each column with its unit. Everything is checked that
    the files, the declarations and the design say of each other; a file with a declared `sha256` must have it.

    Args:
        folder: of the case, or its `case.toml`.
        kinds: of measurement that the package does not have: subclasses of `measurement.experiments.AbstractRecord`.

    Raises:
        InputError: one sentence with file, and line, key or column, and what must hold.
    """
    folder = Path(folder)
    path = folder if folder.is_file() else folder / FILE
    known = _by_name(kinds)
    file, source = read_file(path, tuple(known.values()))
    declared, driven = recorded_units(file, path.parent)
    seen, force = readout(file, source, declared), drive(file, source, driven)
    case = Case(
        folder=path.parent,
        name=file.name,
        description=file.description,
        device=file.device,
        design=design(file, source, vocabulary(file.device, seen, force)),
        readout=seen,
        environment=environment(file, source),
        conventions=dict(file.conventions),
        drive=force,
        records=(),
    )
    records = [_record(known[entry.kind], case, source, n, entry) for n, entry in enumerate(file.experiment)]  # type: ignore[attr-defined]
    return with_found_design(replace(case, records=tuple(records)), file, path)


def _by_name(kinds: Sequence[type[AbstractRecord]]) -> dict[str, type[AbstractRecord]]:
    """The package's kinds and further ones by the word that `case.toml` has for them."""
    known = {kind.kind: kind for kind in KINDS}
    for kind in kinds:
        if kind.kind in known:
            raise InputError(f"Argument `kinds` must hold kinds of other names, but `{kind.kind}` is there already.")
        known[kind.kind] = kind
    return known


def _record(
    kind: type[AbstractRecord], case: Case, source: Source, number: int, entry: ExperimentSection
) -> AbstractRecord:
    path = _path(case, source, number, entry)
    columns = Columns(
        read_table(path),
        case.words,
        case.readout.unit,
        case.drive,
        entry.carried,
        entry.convention == "exp(-iwt)",
        entry.inverted,
    )
    record = kind.read(Sheet(case, source, number, entry, columns))
    names = (name.rsplit(" [", 1)[0] for name in columns.others)
    record = replace(record, carried=columns.others, undeclared=tuple(set(names) - set(entry.carried)))
    _check_range(record, columns.table, case.readout)
    record.check(columns.table, case)
    return record


def _path(case: Case, source: Source, number: int, entry: ExperimentSection) -> Path:
    """The CSV file, which must lie below the folder of the case and be the one that was declared."""
    with source.section("experiment", number, "file"):
        name, folder = Path(entry.file), case.folder
        inside = not name.is_absolute() and ".." not in name.parts and "\\" not in entry.file
        if not (inside and (folder / name).resolve().is_relative_to(folder.resolve())):
            raise InputError(f'must name a file below the folder of the case, but is "{name}"')
        path = folder / name
        if not path.is_file():
            raise InputError(f'must name a file that exists, but there is no "{name}" in {folder}')
    if entry.sha256 is not None:
        with source.section("experiment", number, "sha256"):
            found = hashlib.sha256(read_whole(path, "table", most=LARGEST_TABLE)).hexdigest()
            if found != entry.sha256:
                raise InputError(
                    f"must be the checksum of {name}, but that file has {found[:12]}…: it was changed since; "
                    "restore it, or remove the key if the change is meant"
                )
    return path


def _check_range(record: AbstractRecord, table: Table, readout: Readout) -> None:
    """No reading exceeds the converter's range; the phasor of a clipped wave reaches 4/π of it."""
    if readout.adc_range is None:
        return
    phasors = np.iscomplexobj(record.readings)
    limit = 1.01 * readout.adc_range * (4 / np.pi if phasors else 1.0) + 8 * (record.noise_std or 0.0)
    row, channel = np.unravel_index(np.argmax(np.abs(record.readings)), record.readings.shape)
    largest = abs(record.readings[row, channel])
    if largest > limit:
        raise InputError(
            f"{table.path}, line {table.lines[row]}: a reading must lie within the declared `adc_range` of "
            f"±{readout.adc_range:g} {readout.unit}, but channel {'xy'[channel]} reads {largest:g} {readout.unit}; "
            "is the unit right?"
        )
