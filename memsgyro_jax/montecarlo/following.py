"""How a varying rate was followed: the lag and the delay between the true rate and the dies' mean estimate."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import interpolate, optimize, signal, stats


@dataclass(frozen=True)
class Following:
    """How a varying rate was followed: rms error, delay in s and -3 dB bandwidth in Hz, each with its 95 % interval.

    Delay and bandwidth are those of a lag of first order with delay that maps the true rate to the mean estimate best,
    of second order where one of the first does not fit. The bandwidth is None where the record does not show it (it is
    too slow, or holds a single frequency, at which lag and delay are alike); the delay is then that of a mere shift.
    """

    rms: float
    delay: float
    delay_interval: tuple[float, float]
    bandwidth: float | None
    bandwidth_interval: tuple[float, float] | None


_FINE = 4  # points per window at which the response is computed
_WORSE = 1.2  # times the squared misfit by which the simpler law must be worse to be given up
_EVEN = 1e-6  # relative difference of two spacings that are alike
_UNCAUSED = 1e-4  # squared noise over what the start may add, in units of the rate's own size
_INSIDE = 0.1  # of a window, in time, that stays unknown because only its mean is kept
_KNOWN = 2.0  # factor within which a bandwidth must be known, up and down, to be told
_ALIKE = 0.05  # relative difference of two bandwidths that say the same
_ROUND = float(np.log(np.sqrt(0.5)))  # damping of a lag of second order that is flat (Butterworth)
_DAMPING = (0.4, 30.0)  # of a lag of second order; 30 is one of first order in all but name


class _Fit(NamedTuple):
    """Parameters (delay in s, logarithms of bandwidth and damping), their covariance, and the squared misfit."""

    values: np.ndarray
    covariance: np.ndarray
    misfit: float


def following(
    time: Float[np.ndarray, " windows"],
    rates: Float[np.ndarray, "*dies windows"],
    estimate: Float[np.ndarray, "dies windows"],
    settle: float = 0.0,
) -> Following | None:
    """Fit of the dies' mean over the given windows from `settle` [s] on; the rate before drives it, as far back as the
    windows are evenly spaced: those of the growing blocks at the start of a run in blocks are not.

    `rates` are the true rates in rad/s, of each die or of all; None for a rate that does not vary.
    """
    rates = np.broadcast_to(rates, estimate.shape)
    uneven = np.flatnonzero(np.abs(np.diff(time) / np.diff(time[-2:]) - 1.0) > _EVEN)
    even = slice(int(uneven[-1]) + 1 if uneven.size else 0, None)
    time, rates, estimate = time[even], rates[:, even], estimate[:, even]
    late = time >= settle
    true = np.mean(rates, axis=0) if len(estimate) else np.zeros(len(time))
    spread = np.std(true[late]) if late.any() else 0.0
    if late.sum() < 8 or not spread > 1e-3 * np.max(np.abs(true) + 1e-12):
        return None
    record = _Record(time, rates, estimate, late, spread)
    step = time[1] - time[0]
    shift = _fit(record, [[0.5 * step]])
    bands = np.log([0.02 / step, 0.15 / step])
    first = _fit(record, [[0.5 * step, band] for band in bands])
    delay, band = first.values
    second = _fit(record, [[0.3 * delay, band, _ROUND], [delay, band, 1.5]])
    other = _fit(record, [[0.3 * delay, band, _ROUND]], held=1)
    chosen = second if first.misfit > _WORSE * second.misfit else first
    rms = float(np.sqrt(np.mean((estimate - rates)[:, late] ** 2)))
    width = max(_half_width(fit, 1, len(estimate)) for fit in (chosen, second))
    # Where another law does as well and says something else, the record does not tell.
    doubtful = other.misfit < _WORSE * chosen.misfit and abs(other.values[1] - chosen.values[1]) > max(width, _ALIKE)
    if doubtful or not width < np.log(_KNOWN):
        usual = float(np.std(np.gradient(true, time)[late])) / spread  # rad/s: exact for a sine
        return Following(rms, *_of_a_shift(shift, first, usual, len(estimate)), None, None)
    low, high = np.exp(_ends(chosen, 1, len(estimate)))
    delay = float(chosen.values[0]), _ends(chosen, 0, len(estimate))
    return Following(rms, *delay, float(np.exp(chosen.values[1])), (float(low), float(high)))


def _of_a_shift(shift: _Fit, first: _Fit, usual: float, dies: int) -> tuple[float, tuple[float, float]]:
    """The delay of a mere shift, known no better than it agrees with a lag at the `usual` frequency of the rate."""
    (delay, band), (low, high) = first.values, _ends(shift, 0, dies)
    late = delay + np.arctan(usual / (2.0 * np.pi * np.exp(band))) / usual
    found, half = float(shift.values[0]), float(np.hypot(0.5 * (high - low), late - shift.values[0]))
    return found, (found - half, found + half)


class _Record(NamedTuple):
    """What is fitted: window times, rates and estimates of the dies, which windows count, and the size of the rate."""

    time: np.ndarray
    rates: np.ndarray
    estimate: np.ndarray
    late: np.ndarray
    spread: float

    def left(self, values: np.ndarray, course: Callable, seen: np.ndarray) -> np.ndarray:
        """What a law leaves of the estimates `seen`, but for a constant and the decay of what was before."""
        answer, free = _response(self.time, course, *_law(values))
        free, rest = free[self.late], ((answer - seen) / self.spread)[..., self.late]
        # A decay that is over before the windows begin takes nothing away.
        before = np.linalg.solve(free.T @ free + _UNCAUSED * np.eye(free.shape[1]), free.T @ rest.T)
        return rest - (free @ before).T


def _fit(record: _Record, starts: list[list[float]], held: int = 0) -> _Fit:
    """The best law that the search finds from one of these starts; the last `held` numbers stay."""
    time, late = record.time, record.late
    step, reach, count = time[1] - time[0], 0.25 * float(np.ptp(time[late])), len(starts[0]) - held
    fixed = starts[0][count:]
    course = interpolate.CubicSpline(time, np.mean(record.rates, axis=0))
    mean = np.mean(record.estimate, axis=0)
    low = [-step, np.log(0.1 / reach), np.log(_DAMPING[0])][:count]
    high = [reach, np.log(1.0 / step), np.log(_DAMPING[1])][:count]
    size = np.array([step, 1.0, 1.0])[:count]
    fits = [
        optimize.least_squares(
            lambda p: record.left(np.append(p * size, fixed), course, mean),
            np.clip(start[:count], low, high) / size,
            bounds=(low / size, high / size),
            xtol=1e-6,
        )
        for start in starts
    ]
    best = min(fits, key=lambda fit: fit.cost)
    misfit = 2.0 * best.cost
    # Dies are independent, windows are not: the scatter of the dies' own slopes counts, or the misfit where it is more.
    normal, dies = best.jac.T @ best.jac, len(record.estimate)
    variance = misfit / max(int(late.sum()) - 2 * count, 1)
    scatter = variance * normal
    if dies > 1:
        own = record.left(
            np.append(best.x * size, fixed), interpolate.CubicSpline(time, record.rates, axis=-1), record.estimate
        )
        slopes = own @ best.jac
        dispersed = np.cov(slopes, rowvar=False).reshape(count, count) / dies
        scatter = dispersed if np.trace(dispersed) > np.trace(scatter) else scatter
    # What the record does not say at all is known as loosely as a delay within reach and a factor of twenty.
    loose = np.diag((variance + 1e-12) / np.array([reach / step, 3.0, 3.0])[:count] ** 2)
    inverse = np.linalg.inv(normal + loose)
    covariance = inverse @ (scatter + loose) @ inverse
    inside = _INSIDE * np.array([1.0, 2.0 * np.pi * step * np.exp(best.x[1]) if count > 1 else 0.0, 0.0])[:count]
    return _Fit(best.x * size, (covariance + np.diag(inside**2)) * np.outer(size, size), misfit)


def _law(values: np.ndarray) -> tuple[float, tuple[list[float], list[float]]]:
    """Delay and transfer function, of unit gain at rest; `values` as in `_Fit`."""
    if len(values) == 1:
        return values[0], ([1.0], [1.0])
    band = 2.0 * np.pi * np.exp(values[1])
    if len(values) == 2:
        return values[0], ([1.0], [1.0 / band, 1.0])
    damping = np.exp(values[2])
    excess = 2.0 * damping**2 - 1.0
    # -3 dB of a lag of second order lies at its natural frequency times the root of this.
    square = np.hypot(excess, 1.0) - excess if excess < 0.0 else 1.0 / (np.hypot(excess, 1.0) + excess)
    natural = band / np.sqrt(square)
    return values[0], ([1.0], [1.0 / natural**2, 2.0 * damping / natural, 1.0])


def _response(time: np.ndarray, course: Callable, delay: float, law: tuple) -> tuple[np.ndarray, np.ndarray]:
    """The delayed and lagged course at `time`, at rest before, and what it can add without a cause: columns of a
    constant and of every free decay.
    """
    count, step = (len(time) - 1) * _FINE + 1, (time[1] - time[0]) / _FINE
    grid = time[0] + step * np.arange(count)
    driven = course(np.maximum(grid - delay, time[0]))
    begin = driven[..., :1]
    if len(law[1]) == 1:
        return driven[..., ::_FINE], np.ones((len(time), 1))
    numerator, denominator = signal.bilinear(*law, fs=1.0 / step)
    answer = begin + signal.lfilter(numerator, denominator, driven - begin, axis=-1)
    order = len(denominator) - 1
    free = [signal.lfilter(numerator, denominator, np.zeros(count), zi=row)[0] for row in np.eye(order)]
    return answer[..., ::_FINE], np.stack([np.ones(count), *free], axis=1)[::_FINE]


def _half_width(fit: _Fit, place: int, dies: int) -> float:
    return float(stats.t.ppf(0.975, max(dies - 1, 8)) * np.sqrt(fit.covariance[place, place]))


def _ends(fit: _Fit, place: int, dies: int) -> tuple[float, float]:
    half = _half_width(fit, place, dies)
    return float(fit.values[place] - half), float(fit.values[place] + half)
