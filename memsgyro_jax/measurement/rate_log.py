"""Rate logs: what a sensor at rest put out, as a CSV file."""

import dataclasses
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.base.concrete import check_positive
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table
from memsgyro_jax.base.text import listed
from memsgyro_jax.base.units import parse_header, to_si

from .clock import check_period
from .log_table import log_table
from .lost_rows import bridged


_RATE = re.compile(r"gyr|rate|omega|ω|ang|^[gw][_ ]?(rs_s_)?[xyz]$", re.I)
_LIKELY = 0.5, 1e4  # Hz of a log
_MISMATCH = 0.01  # relative, between times and a given sample rate
_JITTER = 0.25  # of a period, by which stamps may lie off an even clock: a board's that reads as it can


class RateLog(NamedTuple):
    """Rates of one or several axes, evenly sampled.

    Args:
        names: of the series.
        rate: [rad/s].
        period: [s] from sample to sample.
        notes: what was assumed or left out, one sentence each.
        temperature: (samples,) [K] beside the rates, `None` where no column or more than one has it.
    """

    names: tuple[str, ...]
    rate: Float[np.ndarray, "series samples"]
    period: float
    notes: tuple[str, ...] = ()
    temperature: Float[np.ndarray, " samples"] | None = None


def read_rate_log(path: str | Path, sample_rate: float | str | None = None, column: str | None = None) -> RateLog:
    """The rates of a CSV file with a header like ``t [s],rate_z [deg/h]``, in any unit of angular rate.

    Every column of a rate is a series, or `column` alone; others are left out. A unit behind its name, as in
    "Gyr_X [rad/s]", is that of a file which names none. The clock is the column of times, or
    `sample_rate` [Hz], which also takes times as they jitter for those of even sampling; those that lie within a
    quarter of a period of one clock are anyway, and a note says so. Up to a tenth of the rows may
    be lost on an even clock: rows from beside, mirrored, stand in their place, and a note says so.

    Raises:
        InputError: with file, line and column for what `log_table` refuses, no or an unknown column of a rate, neither
            times nor `sample_rate` or both in contradiction, more lost rows than that, and times that jitter more.
    """
    table, column = _named(log_table(path), column)
    rates = [name for name in table.columns if _measures(table, name, "rad/s")]
    times = [name for name in table.columns if _measures(table, name, "s")]
    if not rates or (column is not None and column not in rates):
        raise InputError(
            f'{table.path}: a rate log must have a column such as "{column or "rate"} [deg/s]", but has '
            f"{listed((_headed(*one) for one in table.units.items()), '`')}{_unit_to_say(table, column)}."
        )
    chosen = rates if column is None else [column]
    if len(times) > 1:
        raise InputError(f"{table.path}: a rate log must have one column of times, but has {listed(times, '`')}.")
    if not times and sample_rate is None:
        raise InputError(
            f'{table.path}: a rate log must have a column of times such as "t [s]", but has none; add it, or give the '
            f"sample rate (`sample_rate`, `--rate`){_rate_to_say(table, chosen)}."
        )
    period = None if sample_rate is None else _period(sample_rate)
    clock = (
        dataclasses.replace(table, columns={"t": table.columns[times[0]]}, units={"t": table.units[times[0]]})
        if times
        else None
    )
    left = [name for name in table.columns if name not in (*chosen, *times)]
    notes = [f"Columns not used: {listed(left, '`')}."] if left else []
    if clock is not None and period is not None:
        notes.append(f"The rows are taken as sampled at {1.0 / period:g} Hz, whatever their times jitter.")
    warm = [name for name in left if _measures(table, name, "K")]
    beside = [table.si(warm[0], "K")] if len(warm) == 1 else []
    rate = np.stack([*(table.si(name, "rad/s") for name in chosen), *beside])
    whole = None if clock is None else bridged(clock, rate)
    if whole is not None and period is not None:
        _require_near(table, whole.period, period)
    if whole is None:
        own, more = _clocked(clock, period)
    else:
        rate, own, more = whole.rate, whole.period, (whole.note,)
    return RateLog(tuple(chosen), rate[: len(chosen)], own, (*notes, *more), rate[-1] if beside else None)


def _named(table: Table, column: str | None) -> tuple[Table, str | None]:
    """The table with the unit that stands behind the name of a `column` of it, and that name."""
    if column is None or column in table.columns:
        return table, column
    try:
        name, unit = parse_header(column)
    except InputError:
        return table, column
    if name not in table.columns:
        return table, column
    return dataclasses.replace(table, units={**table.units, name: unit}), name


def _headed(name: str, unit: str) -> str:
    return name if unit == "1" else f"{name} [{unit}]"


def _unit_to_say(table: Table, column: str | None) -> str:
    """What to do where the rates have no unit in the file; empty where every column has one."""
    bare = [name for name, unit in table.units.items() if unit == "1" and column in (None, name)]
    if not bare:
        return ""
    named = [name for name in bare if _RATE.search(name)]
    return f'; if one of these is a rate, say its unit: `--column "{[*named, bare[-1]][0]} [deg/s]"` (`column`)'


def _rate_to_say(table: Table, rates: list[str]) -> str:
    """What the sample rate would be if a column without a unit that rises from row to row were times; empty where none
    does.
    """
    for name, unit in table.units.items():
        steps = np.diff(table.columns[name])
        if name in rates or unit != "1" or not np.all(steps > 0):
            continue
        told = {u: 1.0 / float(to_si(float(np.mean(steps)), u, "s", name)) for u in ("s", "ms", "us", "ns")}
        likely = [f"`--rate {hz:.6g}` if it is in {u}" for u, hz in told.items() if _LIKELY[0] <= hz <= _LIKELY[1]]
        if likely:
            return f"; `{name}` has no unit: {', '.join(likely)}"
    return ""


def _measures(table: Table, name: str, unit: str) -> bool:
    try:
        table.si(name, unit)
    except InputError:
        return False
    return True


def _period(sample_rate: float | str) -> float:
    rate = quantity("sample_rate", sample_rate, "Hz")
    check_positive("sample_rate", rate)
    return 1.0 / float(rate)


def _require_near(clock: Table, own: float, period: float) -> None:
    if abs(own - period) > _MISMATCH * period:
        raise InputError(
            f"{clock.path}: the times must agree with the given sample rate, {1.0 / period:g} Hz, but rise as at "
            f"{1.0 / own:.6g} Hz; is a unit wrong, or are rows missing?"
        )


def _clocked(clock: Table | None, period: float | None) -> tuple[float, tuple[str, ...]]:
    """The period [s] that times, a given one, or both say, and a sentence where times jitter about it."""
    if clock is None:
        assert period is not None
        return period, ()
    times = clock.si("t", "s")
    own = float(times[-1] - times[0]) / (len(times) - 1)
    if period is None:
        try:
            check_period(clock, None)
        except InputError as error:
            off, even = _scatter(times)
            if off <= _JITTER * even:
                said = f"The times jitter by up to {off:.2g} s about an even clock of {1.0 / even:.6g} Hz, by which the"
                return even, (f"{said} rows are taken to be sampled.",)
            raise InputError(
                f"{str(error).rstrip('.')} (with a sample rate, `sample_rate` or `--rate {1.0 / own:.6g}`, jitter is "
                "passed over)."
            ) from error
        return own, ()
    _require_near(clock, own, period)
    wrong = np.flatnonzero(np.abs(np.diff(times) - period) > 0.5 * period)
    if wrong.size:
        row = int(wrong[0]) + 1
        raise InputError(
            f"{clock.path}, line {clock.lines[row]}: at the given sample rate the times must rise by {period:.6g} "
            f"s a row, but here by {times[row] - times[row - 1]:.6g} s; is a row missing?"
        )
    return period, ()


def _scatter(times: np.ndarray) -> tuple[float, float]:
    """How far times (n,) lie off the best line through them at most, and its slope, the period of a row [s]."""
    rows = np.arange(len(times)) - (len(times) - 1) / 2
    slope = float(rows @ times / (rows @ rows))
    return float(np.max(np.abs(times - times.mean() - slope * rows))), slope
