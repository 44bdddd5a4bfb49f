"""The overlapping Allan variance of evenly sampled rates, and what five noises would make of it."""

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.arguments import whole
from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.errors import InputError


TERMS = ("N", "B", "K", "R", "Q")  # of IEEE Std 952, in this order wherever an axis has five entries
NOISES = (0, 1, 2, 4)  # the terms that are random; R is a ramp
_ASYMPTOTIC = 8  # spans beyond which flicker is taken by its tail
_FINE = 16  # starts per averaging time beyond which more overlap tells next to nothing of a smooth noise


def allan_deviation(rate: Float[Array, "*series samples"], factors: Sequence[int]) -> Float[Array, "*series factors"]:
    """Fully overlapping Allan deviation of rates, in their unit, at averaging times of `factors` samples.

    With the angle θ in sample periods, σ²(m) = ⟨(θₖ₊₂ₘ − 2 θₖ₊ₘ + θₖ)²⟩ / (2 m²) over every k (IEEE Std 952-1997, C.1).
    A constant added changes nothing; zero means a rate that does not change. It can be differentiated, compiled and
    mapped; numbers that are known now are computed by NumPy in float64.

    Raises:
        InputError: for a factor below 1 or one of which twice the samples are not there.
    """
    xp = np if is_concrete(rate) else jnp
    rate = np.asarray(rate, float) if xp is np else jnp.asarray(rate)
    factors = tuple(whole("factors", factor, least=1) for factor in factors)
    samples = rate.shape[-1] if rate.ndim else 0
    if not factors or 2 * max(factors) > samples:
        raise InputError(
            f"Argument `factors` must hold whole numbers up to half of the {samples} samples, but "
            f"{max(factors, default='none')} was given."
        )
    # Without its mean the angle stays small, and so does its rounding.
    steps = xp.cumsum(rate - rate.mean(axis=-1, keepdims=True), axis=-1)
    angle = xp.concatenate([xp.zeros_like(steps[..., :1]), steps], axis=-1)
    columns = [_mean_square(angle, m) for m in factors]
    variance = xp.stack(columns, axis=-1)
    return np.sqrt(variance) if xp is np else _root(variance)


def _mean_square(angle: Array, m: int) -> Array:
    second = angle[..., 2 * m :] - 2.0 * angle[..., m:-m] + angle[..., : -2 * m]
    return (second**2).mean(axis=-1) / (2.0 * m**2)


def _root(variance: jax.Array) -> jax.Array:
    """The root, whose slope at zero is none rather than infinite."""
    still = variance == 0.0
    return jnp.where(still, 0.0, jnp.sqrt(jnp.where(still, 1.0, variance)))


def shapes(factors: Sequence[int]) -> Float[np.ndarray, "factors 5"]:
    """Allan variance of each of the `TERMS` of strength one, with the sample period as the unit of time.

    σ²(τ) = N²/τ + (2 ln 2/π) B² + K² τ/3 + R² τ²/2 + 3 Q²/τ² (IEEE Std 952-1997, C.1).
    """
    m = np.asarray(factors, float)
    flat = np.full(m.shape, 2.0 * np.log(2.0) / np.pi)
    return np.stack([1.0 / m, flat, m / 3.0, m**2 / 2.0, 3.0 / m**2], axis=-1)


@functools.lru_cache(maxsize=8)
def covariance_parts(
    samples: int, factors: tuple[int, ...]
) -> tuple[Float[np.ndarray, "factors factors 4 4"], Float[np.ndarray, "factors factors 4"]]:
    """What the covariance of overlapping Allan variances is made of, for Gaussian noise and a ramp.

    With the random terms' squares p and the ramp's square r the covariance is Σ p_a p_b T_ab + r Σ p_a U_a: second
    differences of averaging times m, n have the covariance ρ(l) = Σ p_a ρ_a(l) at the lag l, and a sum of squares of
    Gaussian numbers with the means r^½ m² has 2 ρ² + 4 r m² n² ρ for each pair of them. Numbers of pairs at each lag
    are those of the record, so that its ends are exact. Lags are taken in steps of a sixteenth of the smaller averaging
    time around each kink of ρ and wider ones between, but for the quantisation, whose every lag is taken.
    """
    size, noises = len(factors), len(NOISES)
    squares, sums = np.zeros((size, size, noises, noises)), np.zeros((size, size, noises))
    for i, m in enumerate(factors):
        for j, n in enumerate(factors[: i + 1]):
            squares[i, j], sums[i, j] = squares[j, i], sums[j, i] = _pair(samples, m, n)
    return squares, sums


def _pair(samples: int, m: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Entries of `covariance_parts` for m >= n."""
    first, second = samples + 1 - 2 * m, samples + 1 - 2 * n
    lags = _nodes(m, n, np.array([0, first, -second, first - second]))
    edges = np.diff(lags)
    every = 0.5 * np.concatenate([edges[:1] + 1, edges[1:] + edges[:-1], edges[-1:] + 1])  # lags that a node stands for
    kinks = np.unique([j * n - i * m for i in range(3) for j in range(3)])
    smooth, at_kinks = _lagged(lags, m, n), _lagged(kinks, m, n)
    pairs, few = every * _pairs(lags, first, second), _pairs(kinks, first, second)
    smooth[3], jump = 0.0, at_kinks[3]
    square = np.einsum("l,al,bl->ab", pairs, smooth, smooth)
    square[3, :3] = square[:3, 3] = at_kinks[:3] @ (few * jump)
    square[3, 3] = np.sum(few * jump**2)
    total = smooth @ pairs
    total[3] = np.sum(few * jump)
    number = float(first) * float(second)
    return square / (2.0 * float(m) ** 2 * float(n) ** 2 * number), total / number


def _nodes(m: int, n: int, corners: np.ndarray) -> np.ndarray:
    """Lags, m >= n, dense where the covariance of second differences bends and as far as it reaches."""
    step, reach = max(1, n // _FINE), 32 * (m + n)
    near = np.arange(0, 4 * n + step, step)
    far = 4 * n * np.exp(np.arange(1, 32 * np.log(reach / (4 * n)) + 1) / 32)
    away = np.concatenate([near, np.round(far / step) * step]).astype(int)
    around = [j * m + sign * away for j in range(-2, 3) for sign in (-1, 1)]
    found = n - m + np.concatenate(around)
    found = np.concatenate([found, corners])
    return np.unique(found[np.abs(found - n + m) <= reach])


def _pairs(lags: np.ndarray, first: int, second: int) -> np.ndarray:
    """How many pairs of starts k < `first`, l < `second` have the lag k − l."""
    return np.maximum(0, np.minimum(first, second + lags) - np.maximum(0, lags)).astype(float)


def _lagged(lags: np.ndarray, m: int, n: int) -> np.ndarray:
    """(4, lags) covariance of second differences of the angle by each of `NOISES`, by its generalised covariance:
    −|t|/2, t² ln|t|/(2π), |t|³/12, and one at t = 0.
    """
    found = np.zeros((len(NOISES), lags.size))
    for i, a in enumerate((1.0, -2.0, 1.0)):
        for j, b in enumerate((1.0, -2.0, 1.0)):
            t = np.abs(lags + i * m - j * n).astype(float)
            flicker = t**2 * np.log(np.where(t > 0.0, t, 1.0)) / (2.0 * np.pi)
            found += a * b * np.stack([-t / 2.0, flicker, t**3 / 12.0, (t == 0.0).astype(float)])
    # Differences of stretches apart: of powers of t nothing is left but rounding, of flicker its fourth derivative.
    apart = np.abs(lags + m - n).astype(float)
    found[:, apart >= m + n] *= np.array([[0.0], [1.0], [0.0], [1.0]])
    far = apart > _ASYMPTOTIC * (m + n)
    found[1, far] = -((float(m) * n / apart[far]) ** 2) / np.pi
    return found
