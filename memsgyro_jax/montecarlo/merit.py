"""Figures of merit of a lot: percentiles, yield and ratio to the bound with their intervals, bias and scale factor."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats


@dataclass(frozen=True)
class Proportion:
    """A yield: `value` with its 95 % Wilson interval `low`..`high`, and the criterion in words."""

    value: float
    low: float
    high: float
    criterion: str


def proportion(good: int, count: int, criterion: str) -> Proportion:
    """The share of good dies among `count`; with no die at all it is unknown (0 to 1)."""
    if count == 0:
        return Proportion(float("nan"), 0.0, 1.0, criterion)
    # Its test, which nothing here asks for, is quickest of the very share that was found.
    interval = stats.binomtest(good, count, good / count).proportion_ci(0.95, method="wilson")
    return Proportion(good / count, float(interval.low), float(interval.high), criterion)


@dataclass(frozen=True)
class Percentiles:
    """Root mean square, median and 95th percentile of the magnitude of an error over the dies.

    `p95_low` to `p95_high` is the 95 % interval of the percentile, by order statistics; NaN with too few dies.
    """

    rms: float
    p50: float
    p95: float
    p95_low: float
    p95_high: float


def percentiles(errors: Float[np.ndarray, " dies"]) -> Percentiles:
    """Over the finite entries; NaN where there are none."""
    size = np.abs(errors[np.isfinite(errors)])
    if size.size == 0:
        return Percentiles(*(float("nan"),) * 5)
    median, high = np.percentile(size, [50.0, 95.0])
    ordered = np.sort(size)
    low_end, high_end = (float(ordered[end]) if 0 <= end < size.size else float("nan") for end in _ends(size.size))
    return Percentiles(float(np.sqrt(np.mean(size**2))), float(median), float(high), low_end, high_end)


@functools.cache
def _ends(count: int) -> tuple[int, int]:
    """The places in order between which the 95th percentile of so many lies: as SciPy's `quantile_test`, of which so
    much is made beside that it took a tenth of a sweep's fixed time.
    """
    return int(stats.binom.ppf(0.025, count, 0.95)) - 1, int(stats.binom.isf(0.025, count, 0.95))


def percentiles_of(rms: float, count: int, quantile: Callable[..., list[float]]) -> Percentiles:
    """Over so many numbers that only their root mean square and `quantile` are known of."""
    ranks = (stats.binom.ppf(0.025, count, 0.95), stats.binom.ppf(0.975, count, 0.95) + 1.0)
    return Percentiles(rms, *quantile(0.5, 0.95, *(rank / count for rank in ranks)))


class Ratio(NamedTuple):
    """Root mean square, over `dies`, of each die's error over its own bound, with its 95 % interval `low`..`high`, and
    the median magnitude over that of a standard normal number (0.674), which a few bad dies do not move.
    """

    value: float
    low: float
    high: float
    median: float
    dies: int


_MEDIAN = float(stats.norm.ppf(0.75))


def ratio(errors: Float[np.ndarray, " dies"], bounds: Float[np.ndarray, " dies"]) -> Ratio | None:
    """Errors over bounds, where both are finite; None without any.

    The interval is that of chi-square with as many degrees of freedom as the scatter of the squares shows, at most the
    number of dies (F. E. Satterthwaite, Biometrics Bulletin 2 (1946) 110): exact for normal errors, wide where a few
    dies make the mean.
    """
    square = (errors / bounds) ** 2
    square = square[np.isfinite(square)]
    if square.size == 0:
        return None
    mean, scatter = float(np.mean(square)), float(np.var(square))
    dof = min(2.0 * square.size * mean**2 / scatter, float(square.size)) if scatter > 0.0 else float(square.size)
    low, high = np.sqrt(mean * dof / stats.chi2.ppf([0.975, 0.025], dof))
    return Ratio(
        float(np.sqrt(mean)), float(low), float(high), float(np.sqrt(np.median(square))) / _MEDIAN, square.size
    )


class StraightError(NamedTuple):
    """Error of the settled rate over the true one: `bias` [rad/s] and `scale`, the scale-factor error (IEEE 528), each
    with its standard deviation. `scale` is None where all dies turn alike, or their rates move; `bias` is then their
    mean error.
    """

    bias: float
    bias_std: float
    scale: float | None
    scale_std: float | None


class Moments:
    """Count, mean and summed products of deviations of points, gathered part by part (T. F. Chan, G. H. Golub,
    R. J. LeVeque, The American Statistician 37 (1983) 242).
    """

    def __init__(self, size: int):
        self.count, self.mean, self.products, self.largest = 0, np.zeros(size), np.zeros((size, size)), np.zeros(size)

    def add(self, points: Float[np.ndarray, "n size"]) -> None:
        """Take points in."""
        count, total = len(points), self.count + len(points)
        # Means of equal numbers are equal, so that what does not vary has no scatter.
        mean = points[0] + np.mean(points - points[0], axis=0)
        away, apart = points - mean, mean - self.mean
        self.products += away.T @ away + np.outer(apart, apart) * (self.count * count / total)
        self.mean, self.count = (mean if not self.count else self.mean + apart * (count / total)), total
        self.largest = np.maximum(self.largest, np.max(np.abs(points), axis=0))


def straight_error(points: Moments, moves: bool = False) -> StraightError | None:
    """The straight line through the errors of dies over their rates, by least squares, of moments of (rate, error), or
    the mean error alone of rates that move; None below three dies.
    """
    count, (rate, error), ((across, both), (_, up)) = points.count, points.mean, points.products
    if count < 3:
        return None
    if moves or not np.sqrt(across / count) > 1e-9 * (points.largest[0] + 1e-9):
        return StraightError(float(error), float(np.sqrt(up / (count - 1) / count)), None, None)
    slope = both / across
    scatter = max(up - slope * both, 0.0) / (count - 2)
    std, slope_std = np.sqrt(scatter * (1.0 / count + rate**2 / across)), np.sqrt(scatter / across)
    return StraightError(float(error - slope * rate), float(std), float(slope), float(slope_std))


def settling_time(time: Float[np.ndarray, " n"], error: Float[np.ndarray, " n"], tolerance: float) -> float:
    """The time after which |error| stays within `tolerance`; NaN when it does not, zero when it always did."""
    outside = np.flatnonzero(~(np.abs(error) <= tolerance))
    if outside.size == 0:
        return 0.0
    return float("nan") if outside[-1] == len(time) - 1 else float(time[outside[-1] + 1])
