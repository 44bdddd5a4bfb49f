"""Columns that are the level of a drive by their name, their unit and their values."""

import re
from itertools import pairwise

import numpy as np

from .formats import SourceColumn
from .formats.header import SPECIAL
from .imported_columns import is_same_kind
from .two_channels import plain_words


_LEVEL = re.compile(  # whole names: a reading may have a part of them
    r"[vuif] ?(ac|exc|excitation|drv|drive|in|rf|mod)( (amplitude|ampl?|level|set ?point))?|"
    r"(ac|rf) (voltage|current|force|level|amplitude|ampl?|drive)|(voltage|current) (ac|rf)"
)
_UNITS = ("V", "A", "N")
_STEP = 0.02  # of the largest value: less is the scatter of one level
_FEWEST = 3  # rows of a level


def is_drive_level(column: SourceColumn) -> bool:
    """Whether a column is the drive by its whole name and unit: a force `F`, or steady levels of `Vac` and the like."""
    name = plain_words(column.name)
    if name == "f":
        return bool(column.unit) and is_same_kind(column.unit, "N")
    return _LEVEL.fullmatch(name) is not None and (not column.unit or is_amount(column.unit)) and is_steady(column)


def is_amount(unit: str) -> bool:
    """Whether a unit is that of a voltage, a current or a force, however an amplitude in it is meant."""
    special = SPECIAL.fullmatch(unit)
    base = unit if special is None else special["base"] or "V"
    return unit != "dB" and any(bool(base) and is_same_kind(base, one) for one in _UNITS)


def is_steady(column: SourceColumn) -> bool:
    """Whether the values are some levels, each of which lasts for rows: those of a resonance change from row to row."""
    values = column.values[np.isfinite(column.values)]
    if values.size == 0 or not values.any():
        return False
    return all(rows.stop - rows.start >= _FEWEST for rows in levels_of(values))


def levels_of(values: np.ndarray) -> list[slice]:
    """The rows of each level: a new one begins where values (n,) step by more than one level scatters."""
    begins = np.flatnonzero(np.abs(np.diff(values)) > _STEP * np.max(np.abs(values))) + 1
    return [slice(int(a), int(b)) for a, b in pairwise([0, *begins, values.size])]


def take_levels(found: dict[str, list[SourceColumn]]) -> None:
    """An "amplitude" in steady levels, beside readings that are none, is that of the drive."""
    if "drive" in found:
        return
    steady = [c for c in found.get("amp", []) if c.unit and is_amount(c.unit) and is_steady(c)]
    others = [c for c in found.get("amp", []) if all(c is not one for one in steady)]
    if len(steady) == 1 and (others or {"I", "Q"} <= {*found}):
        found["drive"] = steady
        found.pop("amp")
        found.update({"amp": others} if others else {})
