"""Logs of rates over time: plain CSV files below a header with units, and text as instruments write it."""

from pathlib import Path

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import LARGEST_TABLE, read_whole
from memsgyro_jax.base.table import Table, read_table
from memsgyro_jax.base.units import parse_header

from .formats import SourceColumn, read_instrument_file


def log_table(path: str | Path) -> Table:
    """The columns of numbers of a log. A file whose header reads ``t [s],rate [deg/s]`` is read to the letter; others
    are read as instruments write them, with semicolons, tabs, decimal commas, dates for times and units in brackets.

    Raises:
        InputError: for what `read_table` refuses of the former; for the latter, what cannot be read, columns that lack
            a number in some row, and several tables in one file.
    """
    path = Path(path)
    if _is_plain(path):
        return read_table(path)
    _, tables = read_instrument_file(path)
    if len(tables) != 1:
        raise InputError(f"{path}: must hold one table, but holds {len(tables)}; save the log alone.")
    columns = [column for column in tables[0].columns if column.values.dtype.kind in "iuf" and len(column.values) > 1]
    if not columns:
        raise InputError(f"{path}: must hold columns of numbers over two rows or more, but holds none.")
    for column in columns:
        _require_finite(path, column)
    numbers = {column.name: np.asarray(column.values, float) for column in columns}
    units = {column.name: column.unit or "1" for column in columns}
    return Table(path, numbers, units, np.arange(1, len(columns[0].values) + 1))


def _is_plain(path: Path) -> bool:
    """Whether the first line that says something is a header with a unit in each column."""
    lines = read_whole(path, "file", most=LARGEST_TABLE)[:65536].decode(errors="replace").splitlines()
    head = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    try:
        headers = [parse_header(field) for field in head.split(",")]
    except InputError:
        return False
    return not any(";" in header.name or "\t" in header.name for header in headers)


def _require_finite(path: Path, column: SourceColumn) -> None:
    lost = np.flatnonzero(~np.isfinite(np.asarray(column.values, float)))
    if lost.size:
        raise InputError(
            f"{path}, row {lost[0] + 1} below the header, column `{column.name}`: must be a number, but is none (in "
            f"{lost.size} rows); remove them."
        )
