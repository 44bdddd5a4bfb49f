"""The likelihood of Allan deviations under the five noises of a rate sensor, whose white one may be low-passed."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .allan_variance import NOISES, TERMS, covariance_parts, shapes


LAG = len(TERMS)  # place of a low-pass behind the terms


class Expected(NamedTuple):
    """What a model expects of the cube roots of the variances."""

    variance: np.ndarray
    freedom: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    correlation: np.ndarray


def low_passed(
    lag: Float[np.ndarray, "*series"], factors: Float[np.ndarray, " factors"]
) -> Float[np.ndarray, "*series factors"]:
    """Share of the Allan variance of white noise that a low-pass takes: lag/m at averaging times m far beyond its own,
    whatever its form, the lag being three times the first moment of its autocovariance over N². Nearer to its own it is
    taken to have one pole. A negative lag is noise that swings before it falls, and adds.
    """
    lag = np.asarray(lag)[..., None]
    pole = 2.0 * np.maximum(lag, 0.0) / (3.0 + np.sqrt(9.0 + 4.0 * lag**2))  # of which lag is 3 a/(1 − a²)
    near = pole**factors
    return lag / factors * (1.0 - (4.0 * near - near**2) / 3.0)


class NoiseModel:
    """The likelihood of logarithms of the terms' squares and of a low-pass's lag, as `lag` reads it; leading axes of
    arguments are many fits at once. A lag lies within `reach` times the first factor, below and above zero.
    """

    def __init__(
        self, variance: np.ndarray, factors: tuple[int, ...], samples: int, reach: tuple[float, float]
    ) -> None:
        self.reach = reach
        self.shapes = shapes(factors)
        squares, sums = covariance_parts(samples, factors)
        self.squares, self.sums = squares.reshape(-1, len(NOISES) ** 2).T, sums.reshape(-1, len(NOISES)).T
        self.root = np.cbrt(variance)
        self.factors = np.array(factors, float)

    def repeated(self, times: int) -> "NoiseModel":
        """Each series `times` over."""
        other = object.__new__(NoiseModel)
        other.shapes, other.squares, other.sums = self.shapes, self.squares, self.sums
        other.factors, other.reach = self.factors, self.reach
        other.root = np.repeat(self.root, times, axis=0)
        return other

    def only(self, chosen: np.ndarray) -> "NoiseModel":
        """The series that are `chosen`."""
        other = self.repeated(1)
        other.root = self.root[chosen]
        return other

    def lag(self, logs: np.ndarray) -> np.ndarray:
        below, above = self.reach
        at = logs[..., LAG]
        low, high = below * np.tanh(np.minimum(at, 0.0) / below), above * np.tanh(np.maximum(at, 0.0) / above)
        return self.factors[0] * (low + high)

    def expected(self, logs: np.ndarray) -> Expected:
        power = np.exp(logs[..., :LAG])
        random, ramp = power[..., list(NOISES)], power[..., 3]
        pairs = (random[..., :, None] * random[..., None, :]).reshape(*random.shape[:-1], -1)
        size = len(self.shapes)
        covariance = (pairs @ self.squares + ramp[..., None] * (random @ self.sums)).reshape(*ramp.shape, size, size)
        variance = power @ self.shapes.T
        own = np.diagonal(covariance, axis1=-2, axis2=-1)
        freedom, std = 2.0 * variance**2 / own, np.sqrt(own)
        correlation = covariance / (std[..., :, None] * std[..., None, :])
        spread = 2.0 / (9.0 * freedom)
        # At averaging times beyond its own a low-pass changes how large deviations are, hardly their correlation.
        variance = variance - power[..., :1] * self.shapes[:, 0] * low_passed(self.lag(logs), self.factors)
        scale = np.cbrt(variance)
        return Expected(variance, freedom, scale * (1.0 - spread), scale * np.sqrt(spread), correlation)

    def whitened(self, expected: Expected) -> np.ndarray:
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
