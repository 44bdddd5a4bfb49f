"""The five noises of a rate sensor, fitted to Allan deviations by maximum likelihood."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .allan_variance import NOISES, TERMS, covariance_parts, shapes


# Fall of twice the log-likelihood at the ends of a 95 % interval. It is 3.84 for many degrees of freedom, of which the
# longest averaging times have few; beside a ramp the slower noises have but two or three, as Student's t has, and a
# walk's own drift passes for the ramp. By simulation the intervals hold the truth in 92 to 99 %, beside a ramp in 93 to
# 98 %, more than 99 % where the walk is none.
_FALL = 5.0
_BESIDE_RAMP = (5.0, 13.0, 10.0, 11.0, 5.0)  # of each term
_RAMP = 0.1  # share of the variance at the longest averaging time from which a ramp counts
_NOTHING = np.log(1e6)  # a term this far below the curve is as good as absent
_MOST = np.log(1e4)  # and none can lie further above it
_IN_SIGHT = np.log(50.0)  # below the curve, from where a term is pulled to where it belongs
_STEP = 1e-4  # of a logarithm, for slopes
_HALVINGS = 18


class NoiseFit(NamedTuple):
    """Terms of the noise model with the sample period as the unit of time, one row per series.

    Args:
        value: of each term; zero where it vanishes.
        low, high: ends of the 95 % interval by the profile likelihood; `low` is zero where the record cannot tell the
            term from none.
        variance: Allan variance of the model at each factor.
        freedom: degrees of freedom of the measured variance at each factor, 2 σ⁴/variance of it.
        chi2: squared whitened residual.
        dof: of `chi2`: deviations less terms that do not vanish.
    """

    value: Float[np.ndarray, "series 5"]
    low: Float[np.ndarray, "series 5"]
    high: Float[np.ndarray, "series 5"]
    variance: Float[np.ndarray, "series factors"]
    freedom: Float[np.ndarray, "series factors"]
    chi2: Float[np.ndarray, " series"]
    dof: Float[np.ndarray, " series"]


class _Expected(NamedTuple):
    """What a model expects of the cube roots of the variances."""

    variance: np.ndarray
    freedom: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    correlation: np.ndarray


def fit_noise(variance: Float[np.ndarray, "series factors"], factors: tuple[int, ...], samples: int) -> NoiseFit:
    """Fit `TERMS` to overlapping Allan variances of series of `samples` rates, each an average over its period.

    A variance follows a multiple of χ² with ν degrees of freedom, whose cube root is nearly normal with the mean
    1 − 2/(9ν) and the variance 2/(9ν) (Wilson and Hilferty 1931), also where ν is 1. The cube roots are taken as
    jointly normal with the correlations of the variances. Mean, ν and correlations are those of the model at hand, so
    that the likelihood is whole: no weights from the data.
    """
    model = _Model(variance, factors, samples)
    nearest = np.log(np.min(variance[:, :, None] / model.shapes, axis=1))
    floor, start = nearest - _NOTHING, nearest - np.log(len(TERMS))
    free = np.ones(start.shape, bool)
    best, least = _descend(model.loss, start, floor, free, 80)
    ramp = np.exp(best[:, 3]) * model.shapes[-1, 3] > _RAMP * model.expected(best).variance[:, -1]
    fall = np.where(ramp[:, None], _BESIDE_RAMP, _FALL)
    # What describes no record may have a term further above the curve still, whose end lies above it all the same.
    most = np.maximum(nearest, best) + _MOST
    ends, absent = _profile(model, best, least[:, None] + 0.5 * fall, floor, most, nearest)
    expected = model.expected(best)
    gone = best <= floor + 1.0
    value = np.where(gone, 0.0, np.exp(0.5 * best))
    low = np.where(absent, 0.0, np.exp(0.5 * ends[0]))
    return NoiseFit(
        value,
        low,
        np.exp(0.5 * ends[1]),
        expected.variance,
        expected.freedom,
        np.sum(model.whitened(expected) ** 2, axis=-1),
        np.maximum(len(factors) - np.sum(~gone, axis=-1), 1.0),
    )


class _Model:
    """The likelihood of logarithms of the terms' squares; leading axes of arguments are many fits at once."""

    def __init__(self, variance: np.ndarray, factors: tuple[int, ...], samples: int) -> None:
        self.shapes = shapes(factors)
        squares, sums = covariance_parts(samples, factors)
        self.squares, self.sums = squares.reshape(-1, len(NOISES) ** 2).T, sums.reshape(-1, len(NOISES)).T
        self.root = np.cbrt(variance)

    def repeated(self, times: int) -> "_Model":
        """Each series `times` over."""
        other = object.__new__(_Model)
        other.shapes, other.squares, other.sums = self.shapes, self.squares, self.sums
        other.root = np.repeat(self.root, times, axis=0)
        return other

    def only(self, chosen: np.ndarray) -> "_Model":
        """The series that are `chosen`."""
        other = self.repeated(1)
        other.root = self.root[chosen]
        return other

    def expected(self, logs: np.ndarray) -> _Expected:
        power = np.exp(logs)
        random, ramp = power[..., list(NOISES)], power[..., 3]
        pairs = (random[..., :, None] * random[..., None, :]).reshape(*random.shape[:-1], -1)
        size = len(self.shapes)
        covariance = (pairs @ self.squares + ramp[..., None] * (random @ self.sums)).reshape(*ramp.shape, size, size)
        variance = power @ self.shapes.T
        own = np.diagonal(covariance, axis1=-2, axis2=-1)
        freedom, std = 2.0 * variance**2 / own, np.sqrt(own)
        correlation = covariance / (std[..., :, None] * std[..., None, :])
        spread = 2.0 / (9.0 * freedom)
        scale = np.cbrt(variance)
        return _Expected(variance, freedom, scale * (1.0 - spread), scale * np.sqrt(spread), correlation)

    def whitened(self, expected: _Expected) -> np.ndarray:
        residual = ((self.root - expected.mean) / expected.std)[..., None]
        return np.linalg.solve(_factor(expected.correlation), residual)[..., 0]

    def loss(self, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Negative log-likelihood, and the whitened residual."""
        expected = self.expected(logs)
        factor = _factor(expected.correlation)
        residual = ((self.root - expected.mean) / expected.std)[..., None]
        white = np.linalg.solve(factor, residual)[..., 0]
        size = np.log(np.diagonal(factor, axis1=-2, axis2=-1)) + np.log(expected.std)
        return 0.5 * np.sum(white**2, axis=-1) + np.sum(size, axis=-1), white


def _factor(correlation: np.ndarray) -> np.ndarray:
    # Of a walk under a ramp all deviations are one and the same, to rounding.
    size = correlation.shape[-1]
    return np.linalg.cholesky(correlation + 1e-5 * np.eye(size))


Loss = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def _descend(
    loss: Loss, at: np.ndarray, floor: np.ndarray, free: np.ndarray, rounds: int
) -> tuple[np.ndarray, np.ndarray]:
    """Levenberg-Marquardt on many losses at once, over logarithms not below `floor`, moving those that are `free`."""
    value, _ = loss(at)
    damping = np.full(len(at), 1e-2)
    units = _STEP * np.eye(at.shape[-1])
    for _ in range(rounds):
        sides = [[loss(at + sign * unit) for sign in (1.0, -1.0)] for unit in units]
        slope = np.stack([(up[0] - down[0]) / (2 * _STEP) for up, down in sides], axis=-1)
        bend = np.stack([(up[1] - down[1]) / (2 * _STEP) for up, down in sides], axis=-1)
        moving = free & ~((at <= floor) & (slope > 0.0))
        slope, bend = np.where(moving, slope, 0.0), np.where(moving[:, None, :], bend, 0.0)
        normal = np.swapaxes(bend, -1, -2) @ bend
        scale = np.einsum("...ii->...i", normal) + 1e-4
        lifted = normal + (damping[:, None] * scale)[..., None] * np.eye(at.shape[-1])
        lifted += np.where(moving, 1e-9, 1.0)[..., None] * np.eye(at.shape[-1])
        step = np.clip(-np.linalg.solve(lifted, slope[..., None])[..., 0], -2.0, 2.0)
        trial = np.maximum(at + np.where(moving, step, 0.0), floor)
        tried, _ = loss(trial)
        better = tried < value
        gain = np.max(np.where(better, value - tried, 0.0))
        at, value = np.where(better[:, None], trial, at), np.where(better, tried, value)
        damping = np.clip(np.where(better, damping * 0.3, damping * 5.0), 1e-6, 1e6)
        if gain < 1e-7 and np.all(better | (damping > 1e2)):
            break
    return at, value


def _profile(
    model: _Model, best: np.ndarray, limits: np.ndarray, floor: np.ndarray, most: np.ndarray, nearest: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(2, series, 5) logarithms where the loss, least over the other terms, has risen to `limits` (series, 5), below
    and above; and (series, 5) whether a vanishing term is within it.
    """
    series, terms = best.shape
    number = 2 * terms
    many, held = model.repeated(number), np.tile(np.eye(terms, dtype=bool), (2 * series, 1))
    base, bottom = np.repeat(best, number, axis=0), np.repeat(floor, number, axis=0)
    limit = np.tile(limits, 2).ravel()
    down = np.tile(np.repeat([True, False], terms), series)
    own = base[held]
    far = np.where(down, bottom[held], np.repeat(most, number, axis=0)[held])
    inside, others = own, base

    # Far below the curve a term has no slope and would stay there, whatever the held one needs of it: the walk, say,
    # whose drift passes for the ramp. So each way is also begun with all terms in sight.
    seen = np.maximum(base, np.repeat(nearest - _IN_SIGHT, number, axis=0))

    def at(position: np.ndarray, start: np.ndarray, rounds: int) -> tuple[np.ndarray, np.ndarray]:
        found, cost = _descend(many.loss, np.where(held, position[:, None], start), bottom, ~held, rounds)
        poor = cost > limit
        if not np.any(poor):
            return found, cost
        begun = np.where(held, position[:, None], seen)[poor]
        moved, less = _descend(many.only(poor).loss, begun, bottom[poor], ~held[poor], rounds + 6)
        better = less < cost[poor]
        found[poor], cost[poor] = np.where(better[:, None], moved, found[poor]), np.where(better, less, cost[poor])
        return found, cost

    _, value = at(far, base, 25)
    absent = (down & (value <= limit)).reshape(series, 2, terms)[:, 0]
    outside = far
    for _ in range(_HALVINGS):
        middle = 0.5 * (inside + outside)
        moved, value = at(middle, others, 6)
        within = value <= limit
        inside, outside = np.where(within, middle, inside), np.where(within, outside, middle)
        others = np.where(within[:, None], moved, others)
    return np.moveaxis(inside.reshape(series, 2, terms), 1, 0), absent
