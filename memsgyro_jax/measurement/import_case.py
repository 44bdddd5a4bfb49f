"""Files as instruments save them, written as a measurement case that says what was assumed."""

import itertools
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from memsgyro_jax.base.arguments import whole
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.quantity import amount_of_option
from memsgyro_jax.base.text import listed

from .case import Case
from .case_of_records import write_records
from .column_meaning import meaning_of
from .condition_hints import hints
from .driven_axes import axes_of_files, hint_of_axes, require_axes
from .file_names import names_of_files
from .formats import SourceTable, read_instrument_file
from .imported_conditions import conditions_of_files
from .imported_record import Given, ImportedRecord, records_of
from .imported_sweep import is_ratio
from .left_out_drive import left_out_drive
from .options_of_files import Level, joined_files, levels_of_files, of_joined
from .records_together import agreed, turned_alike, without_copies
from .sample_clock import with_clock
from .told_beside import NO_LEVEL


_PLURAL = {
    "frequency_sweep": "sweeps", "free_decay": "decays", "time_record": "records over time",
    "rate_table": "rate tables", "operating_points": "operating points",
}  # fmt: skip
_ABOUT = {  # kinds of what is assumed, the one that strengths hang on first, by the first words that it has
    "drive": re.compile(r"\bdriv|taken at|response to 1 N"),
    "readings": re.compile(r"\bread-?(?:ing|out)|phase|amplitude|effective|response is in"),
    "rows": re.compile(""),
}
_APART = 1.5  # times the readings of another sweep: what two levels show


@dataclass(frozen=True, eq=False, repr=False)
class ImportedCase(Shown):
    """What became of the files of an instrument; printed with all that was assumed.

    Args:
        case: as `load_case` reads it.
        formats: of each file.
        records: where each experiment comes from, and what was assumed of it.
        unused: drive levels that no record needs, each with its file, and files whose rows another has.
        warning: that several files were given one drive level, as none has its own, and what to do; empty otherwise.
        hints: conditions and axes that only the names of files tell, each with what says them.
    """

    case: Case
    formats: tuple[str, ...]
    records: tuple[ImportedRecord, ...]
    unused: tuple[str, ...] = ()
    warning: str = ""
    hints: tuple[str, ...] = ()

    def __str__(self) -> str:
        lines = [f"{self.case.folder}: {len(self.records)} records from {', '.join(dict.fromkeys(self.formats))}"]
        lines.append(str(self.case))
        shared = _shared(self.records)
        for sentence, names in sorted(shared.items(), key=lambda one: [*_ABOUT].index(_about(one[0]))):
            lines.append(f"Assumed of the {_about(sentence)}: {sentence}{_of(names, self.records)}.")
        for columns, names in _unused_columns(self.records).items():
            lines.append(f"Not used: {columns}{_of(names, self.records)}.")
        lines += [f"Not used: {level}." for level in self.unused]
        lines += [f"Hint: {hint}." for hint in self.hints]
        lines += [f"WARNING: {self.warning}"] if self.warning else []
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """All of it for a JSON file."""
        return {
            "schema": "memsgyro-import/1",
            "case": str(self.case.folder),
            "formats": list(self.formats),
            "warning": self.warning,
            "hints": [*self.hints],
            "records": [
                {
                    "name": r.name, "kind": r.kind, "source": r.source, "columns": list(r.columns),
                    "rows": len(next(iter(r.columns.values()))), "assumed": list(r.assumed), "unused": list(r.unused),
                }
                for r in self.records
            ],
        }  # fmt: skip


def import_case(
    paths: Sequence[str | Path],
    folder: str | Path,
    *,
    columns: str | Sequence[str] = "",
    drive: Sequence[str] = (),
    axis: Sequence[str] = (),
    reference: str = "",
    sample_rate: str = "",
    bias: Sequence[str] = (),
    temperature: Sequence[str] = (),
    every: int | None = None,
    rms: bool = False,
    overwrite: bool = False,
) -> ImportedCase:
    """Reads what instruments save, and writes a case of it: one file or several, one record or more from each.

    Text tables with any delimiter, LabOne's CSV, HDF5 and MAT, touchstone, LabVIEW's lvm and TDMS, and universal files
    are read; what a column means is told by its name and unit. A running frequency makes a frequency sweep, time and a
    drive a time record, time alone a free decay, a rate beside the phasors of a lock-in a rate table. Two channels of
    a lock-in make the case one of two axes.

    Args:
        paths: of the files.
        folder: of the case; made where it does not exist.
        columns: ``"f=Frequency (Hz),x_I=X [V],..."``, role to column, where names do not tell. Roles: f, t, x_I, x_Q,
            x_amp, x_phase, x, F_x, u_x, T, V_bias, rate, std, and of a second channel y_I, y_Q, y_amp, y_phase, y, F_y
            (over time beside F_x); a unit overrides the file's, and a factor may stand before the name,
            ``t=1e-3*count [s]``. Columns that are not named are not used. One for all files, or a list with one for
            each, ``"-"`` where the names tell.
        drive: level with its unit where no column has it, like ``"20 mV"``: one for all files, one for each, or one for
            each that needs it; ``"-"`` stands for a file that needs none.
        axis: ``"x"`` or ``"y"``, which of two axes was driven, one for all files or one for each, where neither a
            column F_x or F_y nor the name of file or folder (``drive_x_10mV``) says it, or says it wrongly; ``"-"``
            for one that does.
        reference: frequency of a lock-in that recorded over time, or operating points, like ``"32.768 kHz"``.
        sample_rate: of waveforms without a column of time where no attribute of the file tells it, like ``"50 kHz"``.
        bias: voltage of the electrodes, like ``"20 V"``, one for all files or one for each, where no column has it;
            ``"-"`` for a file of which nothing is said.
        temperature: like ``"25 degC"``, as `bias`.
        every: keeps one row of so many, waveforms behind a low pass, phasors over time as means; `None` makes such
            means of a long ringing, and else keeps all.
        rms: takes a lock-in's readings for effective values, where their unit does not say; the drive stays as it is.
            Of one file among several its unit in `columns` says it, ``"x_amp=R [Vrms]"``.
        overwrite: writes over a case that is there.

    Returns:
        The case, and all that was assumed.

    Raises:
        InputError: a file cannot be read, its columns are not clear (with the `--map` to copy), or the folder is taken.
    """
    folder = Path(folder)
    if not paths:
        raise InputError("Argument `paths` must hold at least one file, but is empty.")
    if (folder.exists() and not folder.is_dir()) or (folder.is_dir() and any(folder.iterdir()) and not overwrite):
        raise InputError(f"{folder} must be a new or empty folder, but exists; choose another, or give `--overwrite`.")
    tuned = amount_of_option(reference, "--reference", "32.768 kHz", "Hz") if reference else None
    every = None if every is None else whole("every", every, 1)
    columns = [columns] if isinstance(columns, str) else list(columns)
    rate = amount_of_option(sample_rate, "--sample-rate", "50 kHz", "Hz") if sample_rate else None
    files, read = [Path(path) for path in paths], [read_instrument_file(path) for path in paths]
    read = [(form, tuple(with_clock(table, rate) for table in tables)) for form, tables in read]
    sources = [one.shown for one in names_of_files(files)]
    files, read, parts, maps = joined_files(files, read, columns)
    called = names_of_files(files)
    axis, drive = (of_joined(option, parts, name) for option, name in ((axis, "--axis"), (drive, "--drive")))
    given = [None if text.strip() == "-" else amount_of_option(text, "--drive", "20 mV") for text in drive]
    axes = axes_of_files(axis, len(files))
    told = (of_joined(option, parts, name) for option, name in ((bias, "--bias"), (temperature, "--temperature")))
    held = conditions_of_files(dict(zip(("V_bias", "T"), told, strict=True)), len(files))

    def taken(k: int, level: Level | None) -> list[ImportedRecord]:
        tables = [replace(table, folder=called[k].folder, shown=called[k].shown) for table in read[k][1]]
        return _records(called[k].title, tables, maps[k], Given(level, tuned, every, rms, axes[k], held[k]))

    found = [taken(k, None) for k in range(len(files))]
    needing = [any("drive_force" in record.keys for record in some) for some in found]
    using = [needs or any(map(is_ratio, tables)) for needs, (_, tables) in zip(needing, read, strict=True)]
    levels = levels_of_files(given, needing, using)
    found = [taken(k, levels[k]) if levels[k] is not None and using[k] else found[k] for k in range(len(files))]
    require_axes(called, found, axis)
    names = [one.shown for one in called]
    unused = [
        f"the drive of {level[0]:g} {level[1]}, as {name} does not need it"
        for level, name, uses in zip(levels, names, using, strict=True)
        if level and not uses and (len(given) > 1 or not any(using))
    ]
    found, copies = without_copies(found)
    records = turned_alike(agreed(_named([record for some in found for record in some])))
    case, records = write_records(folder, records, sources)
    again = ["memsgyro", "import", *map(str, paths), "--out", str(folder), "--overwrite"]
    again += [*(["--map", *columns] if any(maps) else [])]
    again += ["--axis", *axis] if axis else []
    left = [some if needs else [] for some, needs in zip(found, needing, strict=True)]
    warning = left_out_drive([tables for _, tables in read], maps, found)
    warning = warning or _warning(names, left, levels, shlex.join(again))
    hinted = (*hints(called, found, {"V_bias": bias, "T": temperature}), *hint_of_axes(called, found))
    return ImportedCase(case, tuple(form for form, _ in read), tuple(records), (*unused, *copies), warning, hinted)


def _warning(
    names: Sequence[str], found: Sequence[list[ImportedRecord]], given: Sequence[Level | None], command: str
) -> str:
    """That nothing tells the drive levels of several files, and the command to give them; empty where they are told.

    Args:
        names: of all files.
        found: the records of each; none where it needs no level.
        given: level of each.
        command: that was given.
    """
    levels = []
    for some, said in zip(found, given, strict=True):
        keys = (record.keys["drive_force"] for record in some if "drive_force" in record.keys)
        known = next(((key["value"], key["unit"]) for key in keys), said)
        guessed = any(NO_LEVEL in record.assumed for record in some)
        levels.append("..." if guessed else "-" if known is None else f"{known[0]:g} {known[1]}")
    if levels.count("...") < 2:
        return _of_one_file(names, found)
    files = listed(name for name, level in zip(names, levels, strict=True) if level == "...")
    shown = " ".join(level if level == "-" else f'"{level}"' for level in levels)
    return (
        f"{levels.count('...')} files do not say at which level they were driven, and each was taken for 1 V "
        f"({files}). Where the levels differed, strengths are wrong, as are ratios between files. Give each its own, "
        "in order:\n"
        f"{command} --drive {shown}"
    )


def _of_one_file(names: Sequence[str], found: Sequence[list[ImportedRecord]]) -> str:
    """That nothing tells the drive levels of several sweeps in one file whose readings differ as those of several
    levels do; empty where none holds such.
    """
    for name, some in zip(names, found, strict=True):
        peaks = [_peak(record) for record in some if NO_LEVEL in record.assumed]
        if len(peaks) > 1 and max(peaks) > _APART * min(peaks):
            return (
                f"The {len(peaks)} sweeps of {name} do not say at which level they were driven, and each was taken "
                "for 1 V. Where the levels differed, strengths are wrong: give each its own as the `drive_force` of "
                "its experiment in case.toml."
            )
    return ""


def _peak(record: ImportedRecord) -> float:
    """The largest reading of a record."""
    read = [values for header, values in record.columns.items() if header.startswith(("Vx_I", "Vx_Q", "Vx_amp"))]
    return max((float(np.nanmax(np.abs(values))) for values in read), default=0.0)


def _of(names: Sequence[str], records: Sequence[ImportedRecord]) -> str:
    """Which records a sentence is about, in brackets; nothing where it is about all."""
    if len(names) == len(records):
        return ""
    kinds = {record.kind for record in records if record.name in names}
    every = [record.name for record in records if record.kind in kinds]
    if len(kinds) == 1 and len(every) == len(names) > 1:
        return f" (all {_PLURAL[kinds.pop()]})"
    return f" ({listed(names)})"


def _records(title: str, tables: Sequence[SourceTable], said: dict[str, str], given: Given) -> list[ImportedRecord]:
    """Of one file, under its title; tables beside those that are measurements are passed over."""
    records, first = [], None
    for table in tables:
        try:
            name = "_".join(filter(None, (title, table.name)))
            records += records_of(name, table, meaning_of(table, said), given)
        except InputError as error:
            first = first or error
    if not records and first is not None:
        raise first
    if not records:
        raise InputError(f"{tables[0].path if tables else 'The file'}: must hold columns of numbers, but holds none.")
    return records


def _named(records: list[ImportedRecord]) -> list[ImportedRecord]:
    """Records under names that differ and are file names."""
    taken: set[str] = set()
    named = []
    for record in records:
        name = re.sub(r"[^\w.+-]+", "_", record.name).strip("._") or "record"
        further = (f"{name}_{number}" for number in itertools.count(2))
        name = next(one for one in itertools.chain([name], further) if one not in taken)
        taken.add(name)
        named.append(replace(record, name=name))
    return named


def _shared(records: Sequence[ImportedRecord]) -> dict[str, list[str]]:
    """Each sentence once, with the records it is about."""
    found: dict[str, list[str]] = {}
    for record in records:
        for sentence in record.assumed:
            found.setdefault(sentence, []).append(record.name)
    return found


def _unused_columns(records: Sequence[ImportedRecord]) -> dict[str, list[str]]:
    """Columns that are not used, with the records beside which they stand."""
    found: dict[str, list[str]] = {}
    for record in records:
        if record.unused:
            found.setdefault(listed(record.unused, "`"), []).append(record.name)
    return found


def _about(sentence: str) -> str:
    """Of which kind an assumption is."""
    return next(kind for kind, words in _ABOUT.items() if words.search(sentence))
