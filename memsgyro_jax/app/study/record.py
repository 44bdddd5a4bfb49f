"""Recorded rates and temperatures: a CSV file with the columns `t [s]` and `rate [deg/s]` or `T [degC]`."""

from pathlib import Path

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table, read_table
from memsgyro_jax.loop.scenario import Recorded


_UNITS = {"rate": "rad/s", "T": "K"}
_HEADS = {"rate": "rate [deg/s]", "T": "T [degC]"}


def read_rate_record(path: str | Path) -> Recorded:
    """The rate profile that a CSV file holds, its clock started at the first row.

    The file has the header ``t [s],rate [deg/s]``, in any units of time and angular rate. Between rows the rate is
    linear; before and after them it keeps the end values.

    Raises:
        InputError: one sentence with file, line and column for a missing, unknown or doubled column, a unit of another
            kind, a value that is no finite number, a row cut short, or times that do not rise.
    """
    return _read(path, "rate", "a rate record")


def read_temperature_record(path: str | Path) -> Recorded:
    """The temperature profile [K] of a CSV file with the header ``t [s],T [degC]``, as `read_rate_record` reads one."""
    return _read(path, "T", "a temperature record")


def _read(path: str | Path, what: str, called: str) -> Recorded:
    table, columns = read_table(path), ("t", what)
    for name in [*columns, *table.columns]:
        if name not in table.columns or name not in columns:
            found = ", ".join(f"`{column}`" for column in table.columns)
            raise InputError(f'{path}: {called} must have the columns "t [s],{_HEADS[what]}", but has {found}.')
    times = _column(table, "t", "s")
    falling = np.diff(times) <= 0.0
    if np.any(falling):
        raise table.at(int(np.argmax(falling)) + 1, "t", "must be later than that of the row before")
    return Recorded(times - times[0], _column(table, what, _UNITS[what]))


def _column(table: Table, name: str, unit: str) -> np.ndarray:
    try:
        return table.si(name, unit)
    except InputError as error:
        raise InputError(f"{table.path}, column `{name}`: {error}") from error
