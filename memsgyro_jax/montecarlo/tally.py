"""Figures of a lot gathered part by part, so that no column of a large one is ever in memory."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int

from .batch import DIVERGED, LOST, OK, STATUS, Plan
from .merit import Moments, Percentiles, percentiles, percentiles_of


EXACT = 65536  # sizes that are kept as they are
FOLLOWED = 8192  # dies whose rate and estimate over time are kept, where the rate varies
_DROPPED = 40  # of the 52 digits of a number: what is left tells it to one part in 8192


class Sketch:
    """Sizes of numbers, for quantiles: `EXACT` of them as they are, beyond that counts in bins.

    A bin holds the numbers that agree in all but their last 40 binary digits. Its middle is within 1 part in 8192 of
    each of them, which is the error of a quantile; how many lie below a bin is counted exactly. The counts of two
    sketches add up, in any order to the same.
    """

    def __init__(self) -> None:
        self._kept: list[np.ndarray] = []
        self._bins, self._counts = np.empty(0, np.uint64), np.empty(0, np.int64)
        self._waiting, self.count, self.squares = 0, 0, 0.0

    def add(self, numbers: Float[np.ndarray, " n"]) -> None:
        """Take numbers in; what is none is left out, and infinity counts as the largest."""
        size = np.abs(numbers[~np.isnan(numbers)])
        self._kept.append(size)
        self.count, self._waiting = self.count + size.size, self._waiting + size.size
        with np.errstate(over="ignore"):  # infinity is what it then is
            self.squares += float(np.sum(size**2))
        if self._waiting > EXACT:
            self._bin()

    def quantile(self, *shares: float) -> list[float]:
        """Each the least size that so large a share of the numbers does not exceed; exact ones are interpolated."""
        if self.count == 0:
            return [float("nan")] * len(shares)
        if not self._bins.size:
            return [_interpolated(np.sort(self._sizes()), share) for share in shares]
        self._bin()
        ranks = np.clip(np.ceil(np.asarray(shares) * self.count), 1, self.count)
        found = self._bins[np.searchsorted(np.cumsum(self._counts), ranks)]
        low, high = ((found + np.uint64(k) << np.uint64(_DROPPED)).view(np.float64) for k in (0, 1))
        finite = np.isfinite(high)
        return [float(value) for value in np.where(finite, 0.5 * (low + np.where(finite, high, low)), low)]

    @property
    def rms(self) -> float:
        """Root mean square, exactly."""
        return float(np.sqrt(self.squares / self.count)) if self.count else float("nan")

    @property
    def percentiles(self) -> Percentiles:
        """What is printed of errors."""
        return percentiles_of(self.rms, self.count, self.quantile) if self._bins.size else percentiles(self._sizes())

    def _sizes(self) -> np.ndarray:
        return np.concatenate([*self._kept, np.empty(0)])

    def _bin(self) -> None:
        found = self._sizes().view(np.uint64) >> np.uint64(_DROPPED)
        self._bins, place = np.unique(np.concatenate([self._bins, found]), return_inverse=True)
        counts = np.concatenate([self._counts, np.ones(found.size, np.int64)])
        self._counts = np.bincount(place, counts).astype(np.int64)
        self._kept, self._waiting = [], 0


class Tally:
    """What the summary of a lot is made of, from parts of it in the order of their dies.

    Sums, counts and root mean squares are exact, quantiles as a `Sketch` has them. Of the first `bounded` dies the
    error at the end is kept, to be compared with their bounds; of diverged ones all numbers and the first `EXACT`
    coefficients; of the first `FOLLOWED` ones the rate over time, where it varies.
    """

    def __init__(self, plan: Plan, bounded: int):
        self.plan, self.settled = plan, plan.window_times >= plan.settle
        self.computed = self.lost = self.redrawn = self.good = 0
        self.end, self.sound, self.run, self.nees, self.converged = (Sketch() for _ in range(5))
        self.series_squares = 0.0
        self.series_count = 0
        self.sums = dict.fromkeys(("nees_end", "nis_mean"), (0, 0.0))
        self.straight = Moments(2)
        self.first = np.full((2, bounded), np.nan)  # errors at the end: all, and those of sound dies
        self._diverged: list[np.ndarray] = []
        self._theta: list[np.ndarray] = []
        self._followed: list[tuple[np.ndarray, np.ndarray]] = []

    def add(self, rows: Mapping[str, np.ndarray], first: int) -> None:
        """Take in the dies from `first` on; those that are pending are left out."""
        status, end = rows[STATUS], rows["rate_error_end"]
        sound, lost, astray = status == OK, status == LOST, status == DIVERGED
        alive = sound | astray
        self.computed += int(np.sum(alive | lost))
        self.lost += int(np.sum(lost))
        self.redrawn += int(np.sum(rows["redrawn"][alive | lost] > 0))
        self.good += int(np.sum(np.abs(end[alive]) <= self.plan.tolerance))
        self.end.add(_finite(end[alive]))
        self.sound.add(_finite(end[sound]))
        self.run.add(_finite(rows["rate_error_rms"][alive]))
        series = _finite(rows["rate_series_std"][alive])
        self.series_squares, self.series_count = (
            self.series_squares + float(np.sum(series**2)),
            self.series_count + series.size,
        )
        self.nees.add(rows["nees_end"][alive])
        late = rows["convergence_time"][alive]
        self.converged.add(np.where(np.isfinite(late), late, np.inf))
        for name, (count, total) in self.sums.items():
            finite = _finite(rows[name][alive])
            self.sums[name] = count + finite.size, total + float(np.sum(finite))
        if (few := min(len(status), self.first.shape[1] - first)) > 0:
            self.first[:, first : first + few] = np.where(alive, end, np.nan)[:few], np.where(sound, end, np.nan)[:few]
        self._diverge(rows, first, np.flatnonzero(astray))
        self._over_time(rows, alive)

    @property
    def diverged(self) -> tuple[Int[np.ndarray, " dies"], Float[np.ndarray, "first coefficients"]]:
        """Numbers of the diverged dies, and the coefficients of the first of them."""
        return np.concatenate([*self._diverged, np.empty(0, int)]), np.concatenate(self._theta or [np.empty((0, 0))])

    @property
    def over_time(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Rate and estimate of the first dies; None where no rate varies."""
        rates, estimates = zip(*self._followed, strict=True) if self._followed else ((), ())
        return (np.concatenate(rates), np.concatenate(estimates)) if rates else None

    def mean(self, name: str) -> float | None:
        """Of NEES or NIS, over the dies that have one."""
        count, total = self.sums[name]
        return total / count if count else None

    def _diverge(self, rows: Mapping[str, np.ndarray], first: int, places: Int[np.ndarray, " diverged"]) -> None:
        if places.size:
            self._diverged.append(first + places)
            room = EXACT - sum(map(len, self._theta))
            self._theta.append(rows["coefficient_true"][places[: max(room, 0)]])

    def _over_time(self, rows: Mapping[str, np.ndarray], alive: np.ndarray) -> None:
        true, estimate = rows["rate_true"][alive], rows["rate_estimate"][alive]
        if not alive.any():
            return
        mean = np.mean(true[:, self.settled], axis=1)
        self.straight.add(np.stack([mean, np.mean(estimate[:, self.settled], axis=1) - mean], axis=1))
        room = FOLLOWED - sum(len(rates) for rates, _ in self._followed)
        if room > 0 and np.ptp(true[:, self.settled], axis=1).any():
            self._followed.append((true[:room].copy(), estimate[:room].copy()))


def _interpolated(ordered: Float[np.ndarray, " n"], share: float) -> float:
    """As `numpy.quantile`, which does not bear infinite numbers."""
    place = share * (len(ordered) - 1)
    low, high = ordered[int(place)], ordered[int(np.ceil(place))]
    return float(low if high == low else low + (place - int(place)) * (high - low))


def _finite(values: np.ndarray) -> np.ndarray:
    return values[np.isfinite(values)]
