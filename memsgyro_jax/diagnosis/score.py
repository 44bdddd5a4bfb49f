"""Score tests of candidates: what each could explain of a residual, with everything already free projected out.

At strength zero a candidate moves the whitened residual by its sensitivity S. With Q an orthonormal basis of the
sensitivities of all free parameters, only S⊥ = S − QQᵀS is news. T = |P(S⊥)·r|² is χ²-distributed with as many degrees
of freedom as the candidate has numbers, if nothing is missing (Rao's score, or Lagrange multiplier, test).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special


RELATIVE = 1e-9  # kept share of a sensitivity below which it is a combination of what is free already


def basis(jacobian: np.ndarray, null: float = 1e-7) -> np.ndarray:
    """Orthonormal basis (r, k) of the columns of a Jacobian, without the directions that the data do not hold."""
    size = np.linalg.norm(jacobian, axis=0)
    u, s, _ = np.linalg.svd(jacobian / np.where(size > 0, size, 1.0), full_matrices=False)
    return u[:, s > null * s.max(initial=0.0)]


@dataclass(frozen=True, eq=False)
class Score:
    """The score of one candidate.

    Args:
        statistic: T.
        size: degrees of freedom; zero where the records cannot see the candidate apart from what is free.
        p_value: of T alone.
        share: part of the misfit above the noise that the candidate explains, T/(χ² − dof), within 0 and 1.
        kept: part of the candidate's sensitivity that is news, |S⊥|²/|S|².
        directions: orthonormal basis of S⊥ (r, size).
        information: smallest singular value of S⊥ per unit strength: the strength 1/information moves χ² by one.
        low, high: of a single number, the bounds of its strength in standard deviations from where it is.
    """

    statistic: float
    size: int
    p_value: float
    share: float
    kept: float
    directions: np.ndarray
    information: float
    low: float = -np.inf
    high: float = np.inf

    def visible(self, sigmas: float) -> float:
        """Strength that stands `sigmas` standard deviations above the noise."""
        return sigmas / self.information if self.information > 0 else float("inf")


def score(residual: np.ndarray, q: np.ndarray, sensitivity: np.ndarray) -> Score:
    """Score of a candidate with sensitivity (r, k) on a residual (r,) beside the basis `q` of what is free."""
    clean = sensitivity - q @ (q.T @ sensitivity)
    clean -= q @ (q.T @ clean)  # twice is enough
    whole = float(np.sum(sensitivity**2))
    kept = float(np.sum(clean**2)) / whole if whole > 0 else 0.0
    u, s, _ = np.linalg.svd(clean, full_matrices=False)
    held = s > max(np.sqrt(RELATIVE * whole), 1e-300)
    u = u[:, held]
    size = int(held.sum())
    statistic = float(np.sum((u.T @ residual) ** 2))
    excess = float(residual @ residual) - (np.count_nonzero(residual) - q.shape[1])  # padding is exactly zero
    share = float(np.clip(statistic / excess, 0.0, 1.0)) if excess > 0 else 0.0
    p_value = float(special.chdtrc(size, statistic)) if size else 1.0
    return Score(statistic, size, p_value, share, kept, u, float(s[held].min()) if size else 0.0)


def within_bounds(
    found: Score, residual: np.ndarray, sensitivity: np.ndarray, low: np.ndarray, high: np.ndarray
) -> Score:
    """The same score, or what is left of it where the one strength (zero at present) would have to leave its bounds;
    its direction is then the one along which the strength grows.
    """
    if found.size != 1 or sensitivity.shape[1] != 1:
        return found
    along = -np.sign((found.directions.T @ sensitivity)[0, 0]) * found.directions
    least, most = float(low[0]) * found.information, float(high[0]) * found.information
    statistic = float(gain(along.T @ residual, least, most)[0])
    share = found.share * statistic / found.statistic if found.statistic > 0 else found.share
    bounded = replace(found, statistic=statistic, share=share, directions=along, low=least, high=most)
    return replace(bounded, p_value=survival(bounded))


def gain(estimate: np.ndarray, low: float, high: float) -> np.ndarray:
    """Fall of χ² by a strength that moves from zero towards its estimate, all in standard deviations, within bounds."""
    end = np.clip(estimate, low, high)
    return end * (2.0 * estimate - end)


def survival(found: Score, freedom: float = np.inf, scale: float = 1.0) -> float:
    """Probability that noise alone gives a larger statistic.

    A strength whose sign is known is tempted half as often, one near a bound little more. A noise that is known as well
    as an estimate with `freedom` degrees of freedom tells it makes the normal distribution Student's, and χ² Fisher's.

    Args:
        found: with its statistic and bounds.
        freedom: of the noise estimate.
        scale: variance of the noise over the one that the residual was whitened with.
    """
    return float(_survival(np.array([found.statistic / scale]), found, freedom)[0])


def _survival(statistic: np.ndarray, found: Score, freedom: float = np.inf) -> np.ndarray:
    """The same for many statistics (n,)."""
    known, size = np.isinf(freedom), found.size
    if size != 1:
        return np.asarray(special.chdtrc(size, statistic) if known else special.fdtrc(size, freedom, statistic / size))
    out, root = np.zeros(statistic.shape), np.sqrt(np.maximum(statistic, 0.0))
    for bound in (-found.low, found.high):
        if bound > 0:
            beyond = root if np.isinf(bound) else np.where(root <= bound, root, (statistic / bound + bound) / 2.0)
            out += special.ndtr(-beyond) if known else special.stdtr(freedom, -beyond)
    return np.where(statistic > 0, out, 1.0)


def overlap(a: Score, b: Score) -> float:
    """How much of `a` is within the span of `b`: the smallest squared cosine, 1 where `b` could take its place."""
    if a.size == 0 or b.size == 0:
        return 0.0
    cosines = np.linalg.svd(b.directions.T @ a.directions, compute_uv=False)
    return float(min(cosines[: a.size].min(), 1.0) ** 2) if cosines.size >= a.size else 0.0


def family_p_values(
    scores: Sequence[Score], draws: int = 20_000, seed: int = 0, best: np.ndarray | None = None
) -> np.ndarray:
    """Probability that the best of *all* candidates would reach each p-value by noise alone.

    The candidates' correlations and bounds are taken into account by simulation, so that twins do not count twice
    (Westfall and Young); beyond what the draws resolve, Bonferroni's bound stands. `best`, from `best_by_noise`, is the
    simulation where it is known.
    """
    alone = np.array([s.p_value for s in scores])
    seen = [s for s in scores if s.size]
    if not seen:
        return np.ones(len(scores))
    best = best_by_noise(seen, draws, seed) if best is None else best
    draws = best.size
    simulated = (np.searchsorted(best, alone, side="right") + 1) / (draws + 1)
    bound = np.minimum(1.0, alone * len(seen))
    return np.where(simulated > 20 / draws, np.minimum(simulated, bound), np.minimum(bound, 20 / draws))


def best_by_noise(seen: Sequence[Score], draws: int = 20_000, seed: int = 0) -> np.ndarray:
    """The smallest p-value of all candidates that records see, in draws of noise, ascending."""
    every = np.concatenate([s.directions for s in seen], axis=1)
    values, vectors = np.linalg.eigh(every.T @ every)
    held = values > 1e-10
    root = vectors[:, held] * np.sqrt(values[held])
    noise = np.random.default_rng(seed).standard_normal((draws, int(held.sum()))) @ root.T
    best, place = np.ones(draws), 0
    for s in seen:
        mine = noise[:, place : place + s.size]
        statistic = gain(mine[:, 0], s.low, s.high) if s.size == 1 else np.sum(mine**2, axis=1)
        best = np.minimum(best, _survival(statistic, s))
        place += s.size
    return np.sort(best)


def separation(wald: float, first: Score, second: Score) -> float:
    """Expected Δχ² between an effect that stands at `wald` = (estimate/std)² and its best imitation by another."""
    return wald * (1.0 - overlap(first, second))
