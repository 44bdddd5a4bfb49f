"""Rate logs that lost rows: the clock on which the others lie, and what stands in their place."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table


_MOST = 0.1  # of all rows: more are not filled
_OFF = 0.02  # of a period, by which a stamp may leave its clock


class Bridged(NamedTuple):
    """Rates (series, samples) with what was lost filled, the period [s] of their clock, and a sentence on it."""

    rate: Float[np.ndarray, "series samples"]
    period: float
    note: str


def bridged(clock: Table, rate: Float[np.ndarray, "series rows"]) -> Bridged | None:
    """The rates with rows from beside each gap, mirrored, in the place of lost ones: these have the noise of the record
    at all averaging times, where a straight line would have none. `None` where no row is lost, or times do not lie on
    one clock.

    **Raises:** `InputError` with the line of the longest gap where more than a tenth of the rows are lost.
    """
    times = clock.si("t", "s")
    steps = np.diff(times)
    typical = float(np.median(steps)) if steps.size else 0.0
    if not typical > 0.0:
        return None
    missing = np.round(steps / typical).astype(int) - 1
    if missing.min() < 0 or not missing.any():
        return None
    place = np.concatenate([[0], np.cumsum(missing + 1)])
    period = float(times[-1] - times[0]) / float(place[-1])
    if np.max(np.abs(times - times[0] - place * period)) > _OFF * period:
        return None
    lost, total = int(missing.sum()), int(place[-1]) + 1
    longest = int(np.argmax(missing))
    if lost > _MOST * total:
        raise InputError(
            f"{clock.path}, line {clock.lines[longest + 1]}, column `t`: at most a tenth of the rows may be lost, but "
            f"{lost} of {total} are, {missing[longest]} of them here; analyse the longest part without a gap alone."
        )
    out = np.zeros((len(rate), total))
    out[:, place] = rate
    for row in np.flatnonzero(missing):
        out[:, place[row] + 1 : place[row + 1]] = _from_beside(rate, int(row), int(missing[row]))
    gaps = int(np.count_nonzero(missing))
    where = "a gap" if gaps == 1 else f"{gaps} gaps"
    note = (
        f"{lost} of {total} rows ({100.0 * lost / total:.2g} %) are lost, in {where} of up to "
        f"{missing[longest] * period:.4g} s: rows from beside, mirrored, stand in their place."
    )
    return Bridged(out, period, note)


def _from_beside(rate: np.ndarray, row: int, count: int) -> np.ndarray:
    """(series, count) rows before and after the gap behind a row, mirrored at its ends, each for half of it."""
    before, after = rate[:, max(row - 1, 0) :: -1], rate[:, min(row + 2, rate.shape[1] - 1) :]
    first = count // 2
    left = np.take(before, np.arange(first) % before.shape[1], axis=1)
    right = np.take(after, np.arange(count - first) % after.shape[1], axis=1)
    return np.concatenate([left, right[:, ::-1]], axis=1)
