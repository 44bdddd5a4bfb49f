"""Time as instruments count it: whole ticks of a clock that a file may name."""

from collections.abc import Mapping, Sequence

import numpy as np

from .base import SourceColumn


CLOCKS = ("timebase", "clockbase")
_NAMES = ("timestamp", "timestamps", "ticks")
_BEYOND = 1e11  # s, three thousand years: whole numbers beyond that are no seconds
_APART = 1e4  # s from row to row, likewise


def seconds_per_tick(attributes: Mapping[str, str]) -> float | None:
    """Of the clock that a file names by its frequency or its period; `None` where it names none."""
    for key, value in attributes.items():
        if key.lower().rpartition("/")[2] in CLOCKS:
            try:
                number = float(value.split()[0])
            except (ValueError, IndexError):
                continue
            if np.isfinite(number) and number > 0:
                return 1 / number if number > 1 else number
    return None


def in_seconds(columns: Sequence[SourceColumn], attributes: Mapping[str, str]) -> list[SourceColumn]:
    """The same columns with time stamps without a unit that can be no seconds as ticks since the first, in seconds
    where the clock is named.
    """
    base = seconds_per_tick(attributes)
    return [_since_first(one, base) if _counts_ticks(one) else one for one in columns]


def _counts_ticks(column: SourceColumn) -> bool:
    if column.unit or column.name.lower() not in _NAMES or column.values.dtype.kind != "f" or len(column.values) < 2:
        return False
    values = column.values
    whole = np.isfinite(values).all() and np.all(values == np.round(values))
    return bool(whole and (values[0] > _BEYOND or np.median(np.abs(np.diff(values))) >= _APART))


def _since_first(column: SourceColumn, base: float | None) -> SourceColumn:
    ticks = column.values - column.values[0]
    return SourceColumn(column.name, "ticks", ticks) if base is None else SourceColumn("time", "s", ticks * base)
