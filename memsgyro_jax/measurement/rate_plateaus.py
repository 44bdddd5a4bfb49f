"""Plateaus of a rate-table test: what a gyro put out at each constant rate, from a raw log or one row each."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table
from memsgyro_jax.base.text import listed

from .allan_variance import allan_deviation
from .plateau_search import BATCHES, MOST, Settling, batch_means, plateaus, settling
from .table_columns import TableColumns, columns_of_test, measures, table_of


_SAMPLES = 10  # of the usual plateau, from which on a file with times is a raw log
_GAP = 1.5  # of the usual period, from which on samples are missing
_SAME = 1e-4  # of the greatest rate, within which rates are the same
_MOST = 400  # plateaus
_FEWEST_KEPT = BATCHES  # samples of a plateau behind the settling


@dataclass(frozen=True)
class RatePlateaus:
    """Means of plateaus, in the order of the test.

    Args:
        rate: of the table [rad/s].
        output: mean, in `unit`.
        unit: of the output; "deg/s" for any unit of angular rate.
        time: middle of each plateau [s]; their numbers where no times are known.
        timed: whether the times are known.
        within: standard error of each mean by the noise within its plateau; zeros where it is not known.
        scatter: standard deviation of the samples of each plateau; NaN where it is not known.
        walk: square of the random walk N of each plateau by its Allan deviation, in squares of `unit` times s; NaN
            where it is not known.
        run: number of the run (turn-on) from zero on.
        direction: +1 for a rate approached from below, -1 from above, 0 where there is none.
        temperature, voltage: of each plateau [K], [V]; `None` without such a column.
        lines: of the file, on which each begins.
        where: file, for messages.
        settling: left out at the begin of each plateau [s]; `None` for one row each.
        notes: what was assumed or left out, one sentence each.
    """

    rate: Float[np.ndarray, " n"]
    output: Float[np.ndarray, " n"]
    unit: str
    time: Float[np.ndarray, " n"]
    timed: bool
    within: Float[np.ndarray, " n"]
    scatter: Float[np.ndarray, " n"]
    walk: Float[np.ndarray, " n"]
    run: Int[np.ndarray, " n"]
    direction: Int[np.ndarray, " n"]
    temperature: Float[np.ndarray, " n"] | None
    voltage: Float[np.ndarray, " n"] | None
    lines: Int[np.ndarray, " n"]
    where: str
    settling: float | None = None
    notes: tuple[str, ...] = ()

    def without(self, number: int) -> "RatePlateaus":
        """All but one."""
        keep = np.arange(len(self.rate)) != number
        arrays = {name: value[keep] for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return replace(self, **arrays)


def read_plateaus(
    source: Any, rate_column: str | None = None, output_column: str | None = None, settle: float | str | None = None
) -> RatePlateaus:
    """The plateaus of a CSV file or of columns by header, as `scale_factor_test` takes them."""
    table = table_of(source)
    columns = columns_of_test(table, rate_column, output_column)
    rate = table.si(columns.rate, "rad/s")
    is_rate = measures(table, columns.output, "rad/s")
    output = np.degrees(table.si(columns.output, "rad/s")) if is_rate else table.columns[columns.output]
    unit = "deg/s" if is_rate else table.units[columns.output]
    time = None if columns.time is None else table.si(columns.time, "s")
    if time is not None and np.any(np.diff(time) <= 0.0):
        row = int(np.flatnonzero(np.diff(time) <= 0.0)[0]) + 1
        raise table.at(row, columns.time or "t", "must lie behind that of the row before, as rows of a test follow")
    found = [] if time is None else plateaus(rate)
    raw = bool(found) and np.median([one.stop - one.start for one in found]) >= _SAMPLES
    if raw and time is not None:
        read = _of_log(table, columns, found, rate, output, time, settle)
    elif len(rate) > _MOST:
        what = (
            "times, so that plateaus of a raw log are found" if time is None else "rates that stand still for 10 rows"
        )
        raise InputError(
            f"{table.path}: a file of more than {_MOST} rows must have {what}, but has {len(rate)} rows without."
        )
    elif settle is not None:
        raise InputError(
            f"{table.path}: argument `settle` must go with a raw log, whose plateaus have {_SAMPLES} samples or more "
            "and times, but this file has one row a plateau; leave it out."
        )
    else:
        read = _of_rows(table, columns, rate, output, time)
    if len(read.rate) > _MOST:
        raise InputError(
            f"{table.path}: a test must have {_MOST} plateaus or fewer, but has {len(read.rate)}; judge its runs apart."
        )
    said = [f"The rate is `{columns.rate} [{table.units[columns.rate]}]`, the output `{columns.output}`."]
    said += [f"Columns not used: {listed(columns.unused, '`')}."] if columns.unused else []
    if 2 * (read.run.max() + 1) > len(read.rate):  # a number of each plateau
        said += [f"Column `{columns.run}` has hardly two plateaus a run, and tells no runs."] if columns.run else []
        read = replace(read, run=np.zeros(len(read.rate), int))
    return replace(read, unit=unit, direction=_directions(table, columns, read), notes=(*read.notes, *said))


def _of_rows(
    table: Table, columns: TableColumns, rate: np.ndarray, output: np.ndarray, time: np.ndarray | None
) -> RatePlateaus:
    count = len(rate)
    notes = ["One row a plateau, without times: the plateaus are taken as equally far apart, in the order of the rows."]
    scatter = np.full(count, np.nan)
    if columns.scatter is not None:
        scatter = _in_unit_of(table, columns.scatter, columns.output)
        if np.any(scatter < 0.0):
            raise table.at(int(np.argmin(scatter)), columns.scatter, "must not be negative")
    return RatePlateaus(
        rate, output, "", np.arange(float(count)) if time is None else time, time is not None, np.zeros(count), scatter,
        np.full(count, np.nan), _runs(table, columns, np.arange(count)), np.zeros(count, int),
        _mean_of(table, columns.temperature, "K", None), _mean_of(table, columns.voltage, "V", None), table.lines,
        str(table.path), None, tuple(notes if time is None else ()),
    )  # fmt: skip


def _in_unit_of(table: Table, name: str, output: str) -> np.ndarray:
    """A column in the unit of the output, which may be one that nobody knows."""
    if measures(table, output, "rad/s"):
        return np.degrees(table.si(name, "rad/s"))
    unit = table.units[output]
    return table.columns[name] if table.units[name] == unit else table.si(name, unit)


def _of_log(
    table: Table, columns: TableColumns, found: list[slice], rate: np.ndarray, output: np.ndarray, time: np.ndarray,
    settle: float | str | None,
) -> RatePlateaus:  # fmt: skip
    period = float(np.median(np.diff(time)))
    _check_gaps(table, columns, found, time, period)
    shortest = min(one.stop - one.start for one in found)
    if settle is None:
        left = settling(output, found)
    else:
        seconds = quantity("settle", settle, "s")
        if not 0.0 <= seconds <= (shortest - _FEWEST_KEPT) * period:
            raise InputError(
                f"Argument `settle` must leave {_FEWEST_KEPT} samples or more of each plateau, the shortest of which "
                f"lasts {shortest * period:.4g} s, but {seconds:g} s was given."
            )
        left = Settling(round(seconds / period), True)
    kept = [slice(one.start + left.samples, one.stop) for one in found]
    parts = [output[one] for one in kept if one.stop - one.start >= _FEWEST_KEPT]
    kept = [one for one in kept if one.stop - one.start >= _FEWEST_KEPT]
    if not kept:
        raise InputError(
            f"{table.path}: a plateau must have {_FEWEST_KEPT} samples or more behind {left.samples * period:.3g} s of "
            f"settling, but the longest has {max(one.stop - one.start for one in found)} in all."
        )
    mean = lambda values: np.array([np.mean(values[one]) for one in kept])  # noqa: E731
    at_rate, begins = mean(rate), [one.start for one in kept]
    return RatePlateaus(
        at_rate, mean(output), "", mean(time), True, _errors(parts, at_rate),
        np.array([np.std(part, ddof=1) for part in parts]), _walks(parts, period), _runs(table, columns, begins),
        np.zeros(len(kept), int), _mean_of(table, columns.temperature, "K", kept),
        _mean_of(table, columns.voltage, "V", kept), table.lines[begins], str(table.path),
        left.samples * period, _said(found, kept, left, period, len(rate)),
    )  # fmt: skip


def _said(found: list[slice], kept: list[slice], left: Settling, period: float, rows: int) -> tuple[str, ...]:
    """What a raw log is told of how it was read."""
    used = sum(one.stop - one.start for one in kept)
    away = rows - sum(one.stop - one.start for one in found)
    left_out = f"{left.samples * period:.3g} s at the begin of each plateau are left out as settling"
    head = f"Raw log at {1.0 / period:.6g} Hz: {used} of {rows} samples count; {away} are of changes of the rate"
    said = [f"{head}, and {left_out}."]
    if not left.seen:
        said.append(
            f"The output does not settle to a millionth of a step within {100.0 * MOST:.0f} % of the shortest plateau: "
            "means may hold some of the step before; longer plateaus would not (`settle`, `--settle`, leaves out more)."
        )
    if len(kept) < len(found):
        said.append(f"{len(found) - len(kept)} plateaus with fewer than {_FEWEST_KEPT} samples are left out.")
    return tuple(said)


def _errors(parts: list[np.ndarray], rate: np.ndarray) -> np.ndarray:
    """Standard errors of the means of plateaus, by means of batches: what is correlated for shorter than a batch counts
    as it does in the mean, and what batches still share is added as for a series that remembers one batch.

    A straight course of each plateau is taken out, as the bias that walks from plateau to plateau is not of this noise.
    All plateaus together tell it; where the noise depends on the rate, as a power of e in its modulus.
    """
    length = np.array([len(part) for part in parts])
    line = np.vander(np.arange(BATCHES), 2)
    keep = np.eye(BATCHES) - line @ np.linalg.pinv(line)
    rest = np.array([batch_means(part) for part in parts]) @ keep
    # Of white noise neighbours share that much once a line is taken out.
    usual = np.trace(keep[1:, :-1]) / np.trace(keep)
    shared = float(np.sum(rest[:, 1:] * rest[:, :-1]) / max(np.sum(rest**2), 1e-300)) - usual
    longer = (1.0 + shared) / (1.0 - shared) if 0.0 < shared < 1.0 else 1.0
    density = np.sum(rest**2, axis=1) / (BATCHES - 2) / BATCHES * length * longer
    if np.all(density > 0.0) and len(parts) >= 6:
        place = np.column_stack([np.ones(len(rate)), np.abs(rate) / np.max(np.abs(rate))])
        slope, left = np.linalg.lstsq(place, np.log(density), rcond=None)[:2]
        error = np.sqrt(np.sum(left) / (len(rate) - 2) * np.linalg.inv(place.T @ place)[1, 1])
        if abs(slope[1]) > 3.0 * error:
            course = np.exp(place @ slope)
            return np.sqrt(course * np.mean(density / course) / length)
    return np.sqrt(np.mean(density) / length)


def _walks(parts: list[np.ndarray], period: float) -> np.ndarray:
    """N² of each plateau, its Allan variance at the length of a batch times that length."""
    widths = [len(part) // BATCHES for part in parts]
    each = [allan_deviation(part, (width,))[0] ** 2 * width for part, width in zip(parts, widths, strict=True)]
    return period * np.array(each)


def _check_gaps(table: Table, columns: TableColumns, found: list[slice], time: np.ndarray, period: float) -> None:
    """Samples may be missing between plateaus, where a recorder was stopped, but not within one."""
    for one in found:
        steps = np.diff(time[one])
        if np.any(steps > _GAP * period):
            row = one.start + int(np.argmax(steps)) + 1
            raise InputError(
                f"{table.path}, line {table.lines[row]}, column `{columns.time}`: within a plateau the rows must "
                f"follow each other every {period:.4g} s, but this one is {np.max(steps):.4g} s after the one before; "
                "are rows missing?"
            )


def _runs(table: Table, columns: TableColumns, rows: Any) -> np.ndarray:
    if columns.run is None:
        return np.zeros(len(rows), int)
    return np.unique(table.columns[columns.run][rows], return_inverse=True)[1]


def _mean_of(table: Table, name: str | None, unit: str, kept: list[slice] | None) -> np.ndarray | None:
    if name is None:
        return None
    values = table.si(name, unit)
    return values if kept is None else np.array([np.mean(values[one]) for one in kept])


def _directions(table: Table, columns: TableColumns, read: RatePlateaus) -> np.ndarray:
    """From the column, or from the last other rate in the same run."""
    if columns.direction is not None:
        rows = np.searchsorted(table.lines, read.lines)
        return np.sign(table.columns[columns.direction][rows]).astype(int)
    found = np.zeros(len(read.rate), int)
    same = _SAME * np.max(np.abs(read.rate))
    for number, step in enumerate(np.diff(read.rate), 1):
        if read.run[number] == read.run[number - 1]:
            found[number] = np.sign(step) if abs(step) > same else found[number - 1]
    return found


def levels(rate: np.ndarray) -> tuple[Float[np.ndarray, " levels"], Int[np.ndarray, " n"]]:
    """Rates that are different, in order, and which of them each is; those of zero are exactly so."""
    order = np.argsort(rate)
    step = np.diff(rate[order], prepend=rate[order][:1]) > _SAME * np.max(np.abs(rate))
    which = np.empty(len(rate), int)
    which[order] = np.cumsum(step)
    found = np.array([np.mean(rate[which == k]) for k in range(which.max() + 1)])
    return np.where(np.abs(found) <= _SAME * np.max(np.abs(rate)), 0.0, found), which
