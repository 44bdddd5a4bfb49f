"""Recorded angular rates: a CSV file with the columns `t [s]` and `rate [deg/s]`."""

from pathlib import Path

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table, read_table
from memsgyro_jax.loop.scenario import Recorded


COLUMNS = {"t": "s", "rate": "rad/s"}


def read_rate_record(path: str | Path) -> Recorded:
    """The rate profile that a CSV file holds, its clock started at the first row.

    The file has the header ``t [s],rate [deg/s]``, in any units of time and angular rate. Between rows the rate is
    linear; before and after them it keeps the end values.

    Raises:
        InputError: one sentence with file, line and column for a missing, unknown or doubled column, a unit of another
            kind, a value that is no finite number, a row cut short, or times that do not rise.
    """
    table = read_table(path)
    for name in [*COLUMNS, *table.columns]:
        if name not in table.columns or name not in COLUMNS:
            found = ", ".join(f"`{column}`" for column in table.columns)
            raise InputError(f'{path}: a rate record must have the columns "t [s],rate [deg/s]", but has {found}.')
    times = _column(table, "t")
    falling = np.diff(times) <= 0.0
    if np.any(falling):
        raise table.at(int(np.argmax(falling)) + 1, "t", "must be later than that of the row before")
    return Recorded(times - times[0], _column(table, "rate"))


def _column(table: Table, name: str) -> np.ndarray:
    try:
        return table.si(name, COLUMNS[name])
    except InputError as error:
        raise InputError(f"{table.path}, column `{name}`: {error}") from error
