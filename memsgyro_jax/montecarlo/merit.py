"""Figures of merit of a lot: percentiles, yield and ratio to the bound with their intervals, bias and scale factor."""

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
    interval = stats.binomtest(good, count).proportion_ci(0.95, method="wilson")
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
    ends = stats.quantile_test(size, p=0.95).confidence_interval(0.95)
    return Percentiles(float(np.sqrt(np.mean(size**2))), float(median), float(high), float(ends.low), float(ends.high))


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
    with its standard deviation. `scale` is None where all dies turn alike; `bias` is then their mean error.
    """

    bias: float
    bias_std: float
    scale: float | None
    scale_std: float | None


def straight_error(rate: Float[np.ndarray, " dies"], error: Float[np.ndarray, " dies"]) -> StraightError | None:
    """The straight line through the errors of dies that turn at `rate`, by least squares; None below three dies."""
    if len(error) < 3:
        return None
    varied = float(np.std(rate)) > 1e-9 * (float(np.max(np.abs(rate))) + 1e-9)
    table = np.stack([np.ones_like(rate), rate], axis=1)[:, : 1 + varied]
    line, *_ = np.linalg.lstsq(table, error)
    scatter = np.sum((error - table @ line) ** 2) / (len(error) - len(line))
    std = np.sqrt(scatter * np.diag(np.linalg.inv(table.T @ table)))
    scale, scale_std = (float(line[1]), float(std[1])) if varied else (None, None)
    return StraightError(float(line[0]), float(std[0]), scale, scale_std)


def settling_time(time: Float[np.ndarray, " n"], error: Float[np.ndarray, " n"], tolerance: float) -> float:
    """The time after which |error| stays within `tolerance`; NaN when it does not, zero when it always did."""
    outside = np.flatnonzero(~(np.abs(error) <= tolerance))
    if outside.size == 0:
        return 0.0
    return float("nan") if outside[-1] == len(time) - 1 else float(time[outside[-1] + 1])
