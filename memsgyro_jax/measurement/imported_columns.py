"""Columns of an instrument's table in the units and headers of a case."""

from collections.abc import Mapping

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.units import TO_PEAK, to_si

from .formats import SourceColumn, SourceTable
from .formats.header import SPECIAL


NOISE_COLUMNS = {"std": "std", "x_std": "Vx_std", "y_std": "Vy_std"}
"""Standard deviation of each row, role to column of a case."""
_REFERENCE = {"dB": (1.0, "1"), "dBV": (np.sqrt(2.0), "V"), "dBm": (np.sqrt(2.0 * 1e-3 * 50.0), "V")}


def cut_column(column: SourceColumn, rows: slice) -> SourceColumn:
    """Some rows of a column."""
    return SourceColumn(column.name, column.unit, column.values[rows])


def headed(columns: Mapping[str, SourceColumn]) -> dict[str, np.ndarray]:
    """Columns under the headers of a case."""
    return {f"{name} [{column.unit}]": column.values for name, column in columns.items()}


def with_usual_unit(column: SourceColumn, unit: str, what: str, assumed: list[str]) -> SourceColumn:
    """The column in its unit, or in the usual one."""
    if not column.unit:
        assumed.append(f"the {what} `{column.name}` is in {unit}, as the file does not say")
    return SourceColumn(column.name, column.unit or unit, column.values)


def time_column(table: SourceTable, column: SourceColumn, assumed: list[str]) -> SourceColumn:
    """Times in their unit, or in seconds; raises `InputError` for ticks of a clock that nobody names."""
    if column.unit == "ticks":
        raise InputError(
            f"{table.path}: `{column.name}` must be in seconds, but counts ticks of a clock that is not named; "
            f'say it as in --map "t=1.6667e-8*{column.name} [s],..." for one of 60 MHz, with all columns to be used.'
        )
    return with_usual_unit(column, "s", "time", assumed)


def in_decibels(rows: Mapping[str, SourceColumn], assumed: list[str]) -> dict[str, SourceColumn]:
    """The columns with the magnitudes in dB that are below zero, as no amplitude is, and have no unit."""
    found = {}
    for role in ("amp", "y_amp"):
        column = rows.get(role)
        if column is not None and not column.unit and np.median(column.values) < 0:
            assumed.append(f"`{column.name}` is in dB, as it is below zero")
            found[role] = SourceColumn(column.name, "dB", column.values)
    return {**rows, **found}


def angle_column(column: SourceColumn, assumed: list[str]) -> SourceColumn:
    """Phases in their unit, or in that which their values suggest."""
    if column.unit:
        return column
    unit = "deg" if np.ptp(column.values) > 7.0 else "rad"
    return with_usual_unit(column, unit, "phase", assumed)


def reading_column(column: SourceColumn, assumed: list[str], what: str = "reading") -> SourceColumn:
    """Peak amplitudes in a linear unit."""
    if special := SPECIAL.fullmatch(column.unit):
        if special["decibel"]:
            factor, unit = _REFERENCE[special["decibel"]]
            assumed.append(f"`{column.name}` in {column.unit} is turned to a peak amplitude in {unit}")
            return SourceColumn(column.name, unit, factor * 10 ** (column.values / 20))
        if special["how"] != "pk":
            assumed.append(f"`{column.name}` in {column.unit} is turned to a peak amplitude")
        return SourceColumn(column.name, special["base"], TO_PEAK[special["how"]] * column.values)
    return with_usual_unit(column, "V", what, assumed)


def from_effective(rows: Mapping[str, SourceColumn], assumed: list[str]) -> dict[str, SourceColumn]:
    """Readings of a lock-in that are effective values, as the user says, as peak amplitudes; not those whose unit says
    how they are meant.
    """
    turned = dict(rows)
    for name in [role for role in ("I", "Q", "amp", "y_I", "y_Q", "y_amp", *NOISE_COLUMNS) if role in rows]:
        column = rows[name]
        if not SPECIAL.fullmatch(column.unit):
            turned[name] = SourceColumn(column.name, column.unit, TO_PEAK["rms"] * column.values)
            assumed.append(f"`{column.name}`, rms as was given, is turned to a peak amplitude")
    return turned


def add_surroundings(columns: dict[str, SourceColumn], rows: Mapping[str, SourceColumn]) -> None:
    """Temperature, bias and rate, where their unit says that they are."""
    for name, expected in (("T", "K"), ("V_bias", "V"), ("rate", "rad/s")):
        if name in rows and rows[name].unit and is_same_kind(rows[name].unit, expected):
            columns[name] = rows[name]


def _linear(unit: str) -> str:
    """The unit without how an amplitude in it is meant; empty for decibels."""
    special = SPECIAL.fullmatch(unit)
    return (special["base"] or "") if special else unit


def add_noise(
    columns: dict[str, SourceColumn], rows: Mapping[str, SourceColumn], unit: str, assumed: list[str]
) -> None:
    """The standard deviation of each row, where it is that of readings in this unit and positive."""
    for role, name in NOISE_COLUMNS.items():
        if role not in rows or (role == "y_std" and not any(one.startswith("Vy") for one in columns)):
            continue
        column = rows[role]
        linear = is_same_kind(_linear(column.unit), unit)
        if not linear or not np.all(column.values > 0):
            assumed.append(f"`{column.name}` is left out, as it is no positive noise of each row in {unit}")
            continue
        columns[name] = reading_column(column, assumed)
        assumed.append(f"`{column.name}` is the standard deviation of each row (`noise_std` and estimates give way)")


def is_same_kind(unit: str, expected: str) -> bool:
    """Whether one unit can be converted into the other."""
    try:
        to_si(1.0, unit, expected, "the column")
    except InputError:
        return False
    return True
