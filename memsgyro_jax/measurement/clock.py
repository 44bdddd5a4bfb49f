"""Whether rows follow each other at one period, as far as the printed digits can tell."""

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table
from memsgyro_jax.base.units import to_si


_JITTER = 1e-6  # of a period: what rounding in double precision may add where every digit was printed
_WHOLE = 1e15  # below which double precision holds every tenth of a number: it is rounded to decimals as in print
_MISMATCH = 1e-3  # relative, between blocks and cycles: a drive frequency is declared with a few digits


def check_period(table: Table, period: float | None, remedy: str = "") -> None:
    """Raises `InputError` with the line where column `t` leaves a straight line by more than its printed digits round.

    Args:
        table: the file.
        period: [s] that must pass from row to row; `None` takes that of the file.
        remedy: a sentence on what else may be done, after a blank.
    """
    printed = table.columns["t"]
    unit = float(to_si(1.0, table.units["t"], "s", "column `t`"))
    steps = np.diff(printed)
    typical = float(np.median(steps))
    wrong = np.flatnonzero(np.abs(steps - typical) > 0.5 * typical)
    if wrong.size:
        raise _uneven(table, int(wrong[0]) + 1, steps[wrong[0]] * unit, typical * unit, remedy)
    slope, rounding, excess = _off_line(printed)
    if period is not None and abs(slope * unit - period) > _MISMATCH * period + 2 * rounding * unit:
        raise InputError(
            f"{table.path}, column `t`: the rows must be as far apart as a lock-in block of `lock_in_cycles` drive "
            f"cycles lasts, {period:.6g} s, but are {slope * unit:.6g} s apart; is a unit or a number wrong?"
        )
    if np.any(excess > 0):
        row = int(np.argmax(excess))
        raise table.at(
            row, "t", f"must lie on a clock of one period, {slope * unit:.9g} s, within its printed digits{remedy}"
        )


def is_even(printed: np.ndarray) -> bool:
    """Whether times (n,) lie on a clock of one period within their printed digits."""
    return not np.any(_off_line(printed)[2] > 0)


def _off_line(printed: np.ndarray) -> tuple[float, float, np.ndarray]:
    """Slope of the best line through times (n,) in print, their largest rounding, and by how much each leaves the line
    more than it explains.
    """
    rows, rounding = np.arange(len(printed)) - (len(printed) - 1) / 2, _half_digit(printed)
    slope = float(rows @ (printed - printed.mean()) / (rows @ rows))
    # The line is known better than one row, but for few rows not much better: hence half a rounding more.
    residual = np.abs(printed - printed.mean() - slope * rows)
    most = float(rounding.max())
    return slope, most, residual - (rounding + 0.5 * most + _JITTER * slope * len(rows) ** 0.5)


def usual_period(time: np.ndarray) -> float:
    """Period of the clock (n,) of which stamps jitter by less than a quarter and some are lost [s]."""
    steps = np.diff(time)
    return float(time[-1] - time[0]) / float(np.sum(np.maximum(np.round(steps / np.median(steps)), 1.0)))


def _uneven(table: Table, row: int, step: float, typical: float, remedy: str) -> InputError:
    return InputError(
        f"{table.path}, line {table.lines[row]}, column `t`: the rows must follow each other every {typical:.6g} s, "
        f"but this one is {step:.6g} s after the one before; is a row missing or a digit wrong{remedy}?"
    )


def _half_digit(values: np.ndarray) -> np.ndarray:
    """Half of the last printed digit of each value.

    Numbers of one decade are printed with the same number of decimals, of which trailing zeros are lost: the longest
    of the decade tells.
    """
    decades = np.floor(np.log10(np.where(values == 0, 1.0, np.abs(values)))).astype(int)
    half = np.empty(len(values))
    for decade in np.unique(decades):
        here = decades == decade
        half[here] = 0.5 * 10.0 ** -_most_decimals(values[here])
    half[values == 0] = 0.0
    return half


def _most_decimals(values: np.ndarray) -> int:
    """The largest of `_decimals` of values (n,)."""
    for decimals in range(16):
        if np.max(np.abs(values)) * 10.0**decimals > _WHOLE:
            break
        longer = values[np.round(values, decimals) != values]
        if longer.size == 0 and decimals > 0:
            return decimals
        if longer.size == 0:  # whole ones may be tens or hundreds
            break
        values = longer
    return max(_decimals(value) for value in values.tolist())


def _decimals(value: float) -> int:
    """Digits after the point in the shortest text that reads as `value`; negative for whole tens, hundreds."""
    digits, _, exponent = f"{value!r}".partition("e")
    after = digits.partition(".")[2].rstrip("0")
    return len(after) - int(exponent or 0)
