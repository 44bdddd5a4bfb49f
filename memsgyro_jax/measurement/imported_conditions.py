"""Phasors at one frequency beside a rate or other conditions, from the columns of an instrument's table: operating
points without a clock, rate tables with one. Columns in the words of a case, keys, what is read.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.quantity import number_and_unit
from memsgyro_jax.base.text import printable
from memsgyro_jax.base.units import to_si

from .clock import is_even, usual_period
from .formats import SourceColumn, SourceTable
from .imported_columns import add_surroundings, reading_column, time_column
from .imported_sweep import PEAK, phasor_columns_of, read_as
from .told_beside import level_of


Level = tuple[float, str]  # with its unit
_WHOLE = 0.02  # cycles beside a whole number, from row to row, of a mean over so many
_STEADY = 1e-3  # of a drive: by less it stays as it is


@dataclass(frozen=True)
class _Condition:
    """What the whole of a file may have been recorded at: its option, an example, a unit, and what it is."""

    option: str
    like: str
    unit: str
    words: str


CONDITIONS = {
    "V_bias": _Condition("--bias", "20 V", "V", "bias voltage"),
    "T": _Condition("--temperature", "25 degC", "K", "temperature"),
}


def for_each_file(option: str, given: Sequence[str], files: int, without: str = "") -> list[str]:
    """What an option says of each file, once for all or once for each; empty where it is left out. `without` tells of
    which file "-" stands for nothing. Raises `InputError` for another number of words.
    """
    if len(given) not in (0, 1, files):
        beside = f" (`-` for one {without})" if without else ""
        told = f"given once or for each of {files} files{beside}, but has {len(given)}"
        raise InputError(f"Option `{option}` must be {told}.")
    return list(given) if len(given) == files else list(given or [""]) * files


def conditions_of_files(given: Mapping[str, Sequence[str]], files: int) -> list[dict[str, Level]]:
    """What the user says that each file was recorded at, role to value and unit.

    Args:
        given: by role, once for all files or for each, "-" for one of which nothing is said.
        files: how many.

    Raises:
        InputError: another number of them, or no number with a unit that fits.
    """
    out: list[dict[str, Level]] = [{} for _ in range(files)]
    for role, texts in given.items():
        known = CONDITIONS[role]
        every = for_each_file(known.option, texts, files, "of which nothing is said")
        for of_file, text in zip(out, every, strict=True):
            if text.strip() not in ("", "-"):
                of_file[role] = _level(text, known)
    return out


def _level(text: str, known: _Condition) -> Level:
    try:
        number, unit = number_and_unit(text)
    except ValueError as error:
        raise InputError(f"Option `{known.option}` {error}.") from error
    if not unit:
        must = f'must be a number with its unit, like "{known.like}", but is "{printable(text, 60)}"'
        raise InputError(f"Option `{known.option}` {must}.")
    value = to_si(number, unit, known.unit, f"option `{known.option}`")
    if known.unit == "K" and not value > 0:
        must = f'must be above absolute zero, -273.15 degC, but is "{printable(text, 60)}"'
        raise InputError(f"Option `{known.option}` {must}.")
    return number, unit


def beside_conditions(
    table: SourceTable, rows: Mapping[str, SourceColumn], given: Mapping[str, Level], assumed: list[str]
) -> dict[str, SourceColumn]:
    """The columns, and those of what was given of the whole file; raises `InputError` where a column says it."""
    out = dict(rows)
    for role, (value, unit) in given.items():
        known = CONDITIONS[role]
        if role in rows:
            told = f"`{known.option}` must be left out (`-`), as `{rows[role].name}` says it"
            raise InputError(f"{table.path}: {told}.")
        count = len(next(iter(rows.values())).values)
        out[role] = SourceColumn(known.option, unit, np.full(count, value))
        assumed.append(f"the {known.words} is {value:g} {unit}, as was given")
    return out


def columns_of_points(
    table: SourceTable, rows: Mapping[str, SourceColumn], reference: Level, drive: Level | None, axis: str,
    assumed: list[str],
) -> tuple[dict[str, SourceColumn], dict[str, Any], str]:  # fmt: skip
    """Those of settled phasors, a row for each setting; as of a sweep."""
    _check_rate(table, rows)
    columns, quantity = _phasors(rows, assumed)
    keys: dict[str, Any] = {"drive_frequency": {"value": reference[0], "unit": reference[1]}}
    if "drive" in rows:
        columns[f"F_{axis or 'x'}"] = reading_column(rows["drive"], assumed, "drive")
    else:
        keys["drive_force"] = level_of(table, drive, assumed)
    add_surroundings(columns, rows)
    assumed.append("every row was read after the device had settled at its conditions")
    if "rate" in columns:
        assumed.append("the rate is the setting of the table (`rate_reference`)")
    return columns, keys, quantity


def columns_of_rate_table(
    table: SourceTable, rows: Mapping[str, SourceColumn], reference: Level, drive: Level | None, assumed: list[str]
) -> tuple[dict[str, SourceColumn], dict[str, Any], str]:
    """Those of phasors over time: means over whole cycles of the drive, or of a low pass."""
    _check_rate(table, rows)
    columns, quantity = _phasors(rows, assumed)
    columns = {"t": time_column(table, rows["t"], assumed), "rate": rows["rate"], **columns}
    add_surroundings(columns, {role: rows[role] for role in CONDITIONS if role in rows})
    value, unit = reference
    period = usual_period(to_si(columns["t"].values, columns["t"].unit, "s", "t"))
    cycles = float(to_si(value, unit, "Hz", "f")) * period
    whole = abs(cycles - round(cycles)) <= _WHOLE and cycles > 0.5
    if whole:
        assumed.append(f"each row is the mean over the {round(cycles)} cycles of the drive from row to row")
    else:
        assumed.append("each row is what the lock-in's low pass makes of the time from row to row")
    assumed.append("the rate is the setting of the table (`rate_reference`), and the device had settled before")
    keys = {
        "drive_force": _steady_level(table, rows, drive, assumed),
        "drive_frequency": {"value": value, "unit": unit},
        **({"lock_in_cycles": round(cycles)} if whole else {}),
        **stamps(columns["t"], assumed),
    }
    return columns, keys, quantity


def stamps(time: SourceColumn, assumed: list[str]) -> dict[str, Any]:
    """`uneven` where rows are lost or stamps jitter, which are then taken for right."""
    if is_even(time.values):
        return {}
    lost = round((time.values[-1] - time.values[0]) / usual_period(time.values)) + 1 - len(time.values)
    assumed.append(f"the time of each row is right (`uneven`), though {'rows are lost' if lost > 0 else 'it jitters'}")
    return {"uneven": True}


def _phasors(rows: Mapping[str, SourceColumn], assumed: list[str]) -> tuple[dict[str, SourceColumn], str]:
    """The columns of phasors, and what is read where it shows."""
    columns = phasor_columns_of(rows, assumed)
    if not any("peak amplitude" in sentence for sentence in assumed):
        assumed.append(PEAK)
    return columns, read_as(columns["Vx_I" if "Vx_I" in columns else "Vx_amp"].unit)


def _check_rate(table: SourceTable, rows: Mapping[str, SourceColumn]) -> None:
    """A rate without a unit may be anything."""
    if "rate" in rows and not rows["rate"].unit:
        remedy = 'as in --map "rate=... [deg/s],..."'
        raise InputError(
            f"{table.path}: `{rows['rate'].name}` must have its unit, {remedy} with all columns to be used."
        )


def _steady_level(
    table: SourceTable, rows: Mapping[str, SourceColumn], given: Level | None, assumed: list[str]
) -> Mapping[str, Any]:
    """The level of a drive that stays as it is: that of its column, or as given."""
    if "drive" not in rows:
        return level_of(table, given, assumed)
    drive = reading_column(rows["drive"], assumed, "drive")
    if np.ptp(drive.values) > _STEADY * np.max(np.abs(drive.values)):
        name = rows["drive"].name
        raise InputError(f"{table.path}: the drive of a rate table must stay as it is, but `{name}` moves.")
    return {"value": float(np.median(drive.values)), "unit": drive.unit}
