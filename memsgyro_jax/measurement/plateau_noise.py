"""Noise of the means of plateaus, which need be neither white nor independent, and what is known in spite of it.

The means are y = X β + e with Cov(e) = D + s I + k R: D is what the noise within each plateau makes of its mean, s a
scatter from plateau to plateau that this does not show, and k R a random walk of the bias over time. s and k are not
known either: a figure's interval is averaged over all that the restricted likelihood (Patterson and Thompson,
Biometrika 58 (1971) 545) allows them, with half-Cauchy priors for their roots, whose scale is the spread that a plain
fit leaves (Gelman, Bayesian Analysis 1 (2006) 515). Without a walk, and D unknown, that is Student's t.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import linalg


DRAWS = 4000
_SHARES = np.array([0.0, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 5.0])  # of the spread that a plain fit leaves
_HEAVIER = np.array([10.0, 20.0, 50.0])  # a walk beside a scatter that is small
_WALK_SCALE = 3.0  # of its prior: one sweep up and down shows little of a walk, and intervals held it in 85 % with 1
_LIKELY = 1e-4  # weight from which on a pair of strengths counts
_SEED = 0
_ROUNDING = 1e-12  # of the greatest output, below which what a fit leaves is none


class Means(NamedTuple):
    """Means of plateaus and what is fitted to them.

    Args:
        output: (n,).
        shape: (n, p) columns of the response to the rate, of full rank with the others.
        beside: (n, q) columns of what else moves the output (drift, temperature, runs), each of zero mean.
        within: (n,) standard errors by the noise within each plateau; zeros where it is not known.
        walk: (n, n) covariance of a random walk of the bias over time.
    """

    output: Float[np.ndarray, " n"]
    shape: Float[np.ndarray, "n p"]
    beside: Float[np.ndarray, "n q"]
    within: Float[np.ndarray, " n"]
    walk: Float[np.ndarray, "n n"]


@dataclass(frozen=True)
class Response:
    """What the means say of the response to the rate, with draws of what it may be instead.

    Args:
        output: (n,) means without the walk of the bias and without what is beside.
        outputs: (draws, n) of it.
        effects: (q,) of the columns beside.
        effect_draws: (draws, q) of them.
        misfit: (n,) how far each mean is off what the others say of it, in standard deviations.
        spare: plateaus beyond the columns.
    """

    output: Float[np.ndarray, " n"]
    outputs: Float[np.ndarray, "draws n"]
    effects: Float[np.ndarray, " q"]
    effect_draws: Float[np.ndarray, "draws q"]
    misfit: Float[np.ndarray, " n"]
    spare: int


class _Pair(NamedTuple):
    """One pair of strengths: log-likelihood with its prior, what the means are multiplied with, and their errors."""

    weight: float
    linear: np.ndarray
    error: np.ndarray
    misfit: np.ndarray
    freedom: int


def response(means: Means) -> Response:
    """The response to the rate and its uncertainty; deterministic, as the draws have a seed of their own."""
    columns = np.column_stack([means.shape, means.beside])
    basis = linalg.null_space(columns.T)
    left = basis.T @ means.output
    known = bool(np.any(means.within > 0.0))
    spread = max(float(np.mean(left**2)) if len(left) else 0.0, np.finfo(float).tiny)
    scale = np.sqrt(max(spread, float(np.mean(means.within**2))))
    walk = means.walk / max(float(np.trace(basis.T @ means.walk @ basis)) / max(len(left), 1), np.finfo(float).tiny)
    units = Means(means.output / scale, means.shape, means.beside, means.within / scale, walk)
    strengths = _strengths(known, len(left))
    pairs = [_pair(units, basis, columns, known, *each) for each in strengths]
    weights = np.exp(np.array([pair.weight for pair in pairs]) - max(pair.weight for pair in pairs))
    weights /= weights.sum()
    return _drawn(units, pairs, weights, scale, basis)


def _strengths(known: bool, spare: int) -> list[tuple[float, float, float]]:
    """Roots of scatter and walk, and logarithm of the prior with the width that each stands for."""
    if not spare:
        return [(0.0 if known else 1.0, 0.0, 0.0)]
    walks = _SHARES if known else np.concatenate([_SHARES, _HEAVIER])
    prior = np.gradient(walks) / (1.0 + (walks / _WALK_SCALE) ** 2)
    if not known:
        return [(1.0, root, float(np.log(p))) for root, p in zip(walks, prior, strict=True)]
    scatter = np.gradient(_SHARES) / (1.0 + _SHARES**2)
    return [
        (s, k, float(np.log(p * q)))
        for s, p in zip(_SHARES, scatter, strict=True)
        for k, q in zip(walks, prior, strict=True)
    ]


def _pair(
    means: Means, basis: np.ndarray, columns: np.ndarray, known: bool, scatter: float, walk: float, prior: float
) -> _Pair:
    """What one pair of strengths says; without knowledge of D their common scale is what the means leave."""
    count = len(means.output)
    plain, walked = np.diag(means.within**2 + scatter**2), walk**2 * means.walk
    values, vectors = np.linalg.eigh(basis.T @ (plain + walked) @ basis)
    values = np.maximum(values, 1e-13 * max(values[-1], 1e-300)) if len(values) else values
    turned = basis @ vectors
    square = float(np.sum((turned.T @ means.output) ** 2 / values))
    freedom = 0 if known else len(values)
    likely = -0.5 * float(np.sum(np.log(values)))
    likely -= 0.5 * square if known else 0.5 * freedom * np.log(max(square, 1e-300))
    left = (turned / values) @ turned.T  # V⁻¹ − V⁻¹ X (Xᵀ V⁻¹ X)⁻¹ Xᵀ V⁻¹
    beta = np.linalg.pinv(columns) @ (np.eye(count) - (plain + walked) @ left)
    course = walked @ left
    course = course - course.mean(axis=0)
    places = slice(means.shape.shape[1], None)
    clean = np.eye(count) - course - means.beside @ beta[places]
    linear = np.vstack([clean, beta[places]])
    off_mean = linear.copy()
    off_mean[:count] -= 1.0 / count
    error = linear @ plain @ linear.T + off_mean @ walked @ off_mean.T
    rounding = (_ROUNDING * float(np.max(np.abs(means.output)))) ** 2
    common = 1.0 if known else max(square / max(freedom, 1), rounding)
    error = error * common
    with np.errstate(divide="ignore", invalid="ignore"):
        misfit = left @ means.output / np.sqrt(np.diag(left) * common)
    return _Pair(likely + prior, linear, error, np.nan_to_num(misfit), freedom)


def _drawn(means: Means, pairs: list[_Pair], weights: np.ndarray, scale: float, basis: np.ndarray) -> Response:
    rng, drawn = np.random.default_rng(_SEED), []
    for pair, number in zip(pairs, np.random.default_rng(_SEED).multinomial(DRAWS, weights), strict=True):
        if not number:
            continue
        values, vectors = np.linalg.eigh(pair.error)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        noise = rng.standard_normal((number, len(values))) @ root.T
        if pair.freedom:
            noise *= np.sqrt(pair.freedom / rng.chisquare(pair.freedom, (number, 1)))
        drawn.append(pair.linear @ means.output + noise)
    every, count = scale * np.concatenate(drawn), len(means.output)
    best = pairs[int(np.argmax(weights))]
    value = scale * sum(w * (pair.linear @ means.output) for w, pair in zip(weights, pairs, strict=True))
    return Response(value[:count], every[:, :count], value[count:], every[:, count:], best.misfit, basis.shape[1])
