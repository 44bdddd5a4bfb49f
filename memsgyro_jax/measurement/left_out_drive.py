"""A column that nobody uses although the readings go with it from sweep to sweep: very probably the drive."""

from collections.abc import Mapping, Sequence

import numpy as np

from memsgyro_jax.base.text import listed, printable

from .column_map import ROLES, SECOND
from .column_meaning import Meaning, meaning_of
from .drive_columns import is_amount, is_steady, levels_of
from .formats import SourceColumn, SourceTable
from .imported_record import ImportedRecord
from .told_beside import NO_LEVEL


_BAND = 0.5  # of a file's band that a level lasts for: a range that changes within a sweep is none
_APART = 1.2  # times the lowest level, from which on it tells how the readings go with it
_SLOPE = 0.35  # by which the power of the level may be off one, as a device that is not linear makes it
_OFF = 0.1  # of a logarithm, by which a reading may lie off that power
_WORDS = {"I": "x_I", "Q": "x_Q", "amp": "x_amp", "phase": "x_phase", "drive": "F_x"}


def left_out_drive(
    tables: Sequence[Sequence[SourceTable]],
    maps: Sequence[Mapping[str, str]],
    found: Sequence[Sequence[ImportedRecord]],
) -> str:
    """The warning that a column which is not used is very probably the drive, with the `--map` to copy; empty where
    none is, or every record has a level.

    Args:
        tables: of each file.
        maps: what was said of the columns of each; more of them, all empty, where files were joined.
        found: the records of each.
    """
    runs: dict[str, list[tuple[float, float]]] = {}
    said: dict[str, tuple[str, list[str]]] = {}
    for each, given, records in zip(tables, maps, found, strict=False):
        guessed = {record.source: record for record in records if NO_LEVEL in record.assumed}
        for table in each:
            record = guessed.get(f"{table.path.name}{', ' + table.name if table.name else ''}")
            if record is None:
                continue
            meaning = meaning_of(table, given)
            for column in (one for one in table.columns if meaning.swept and one.header in meaning.unused):
                if some := _runs(meaning, column):
                    runs.setdefault(column.header, []).extend(some)
                    said.setdefault(column.header, (_as_map(meaning, column, record.axis), []))[1].append(record.source)
    whole = next((header for header, some in runs.items() if _goes_with(np.array(some))), None)
    if whole is None:
        return ""
    text, files = said[whole]
    return (
        f"`{printable(whole)}` of {listed(dict.fromkeys(files))} is very probably the drive, as the readings go with "
        "it from sweep to sweep, but it is not used, and each sweep was taken for 1 V. Strengths are wrong then, and "
        f'sweeps at different drives pass for repeats. Name it: --map "{text}"'
    )


def _runs(meaning: Meaning, column: SourceColumn) -> list[tuple[float, float]]:
    """Each level of a column, and the largest reading at it; none where it is no column of levels."""
    numbers = column.values.dtype.kind in "iuf" and np.isfinite(column.values).all()
    if not numbers or (column.unit and not is_amount(column.unit)) or not is_steady(column):
        return []
    decibel = column.unit.startswith("dB")
    levels = 10 ** (column.values / 20.0) if decibel else column.values.astype(float)
    band, read = meaning.columns["f"].values, _size(meaning)
    pieces = levels_of(column.values)
    whole = all(np.ptp(band[rows]) >= _BAND * np.ptp(band) for rows in pieces)
    if not whole or not np.all(levels > 0.0):
        return []
    return [(float(np.mean(levels[rows])), float(np.nanmax(read[rows]))) for rows in pieces]


def _size(meaning: Meaning) -> np.ndarray:
    """(n,) how large the readings are."""
    columns = meaning.columns
    if "I" in columns:
        return np.hypot(columns["I"].values.astype(float), columns["Q"].values.astype(float))
    size = columns["amp"]
    return 10 ** (size.values / 20.0) if size.unit.startswith("dB") else np.abs(size.values.astype(float))


def _goes_with(runs: np.ndarray) -> bool:
    """Whether the readings go with the levels, (n, 2), about in proportion."""
    if len(runs) < 2 or np.any(runs <= 0.0) or runs[:, 0].max() < _APART * runs[:, 0].min():
        return False
    level, size = np.log(runs).T
    slope, offset = np.polyfit(level, size, 1)
    return abs(slope - 1.0) < _SLOPE and bool(np.max(np.abs(size - slope * level - offset)) < _OFF)


def _as_map(meaning: Meaning, column: SourceColumn, axis: str) -> str:
    """What `--map` must say for the columns as they were taken, and this one."""
    known = {role: one for role, one in meaning.columns.items() if role in (*ROLES, *SECOND)}
    pairs = [f"{_WORDS.get(role, role)}={one.header}" for role, one in known.items()]
    return ",".join([*pairs, f"F_{axis or 'x'}={column.header}{'' if column.unit else ' [V]'}"])
