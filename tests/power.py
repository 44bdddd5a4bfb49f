"""Power and level of the search where everything is linear: residual = sensitivity · strength + noise.

At strengths of a few standard deviations a model is linear, and a diagnosis is decided by vectors that are computed
once: the residual's sensitivities to the base parameters and to every candidate. Thousands of draws then cost nothing.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import stats

from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.score import Score, basis, family_p_values, overlap, score


@dataclass(frozen=True, eq=False)
class Linear:
    """A fitted case as vectors.

    Args:
        labels: of the candidates.
        q: orthonormal basis of the sensitivities of all free parameters (r, k).
        slopes: sensitivity of each candidate (r, size).
    """

    labels: tuple[str, ...]
    q: np.ndarray
    slopes: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, joint: Joint, vector: np.ndarray) -> "Linear":
        """The base parameters free, every effect of the model a candidate."""
        fitted = joint.fitted
        _, slopes = joint.linearise(vector, np.eye(vector.size), fitted)
        effects = joint.model.effects
        parts = tuple(slopes[:, joint.of_effect(i)] for i in range(len(effects)))
        return cls(tuple(e.label for e in effects), basis(slopes[:, joint.base()]), parts)

    def with_free(self, place: int) -> "Linear":
        """One candidate accepted: free like the base, and no candidate any more."""
        q = np.concatenate([self.q, self.scores[place].directions], axis=1)
        kept = [i for i in range(len(self.labels)) if i != place]
        return Linear(tuple(self.labels[i] for i in kept), q, tuple(self.slopes[i] for i in kept))

    @cached_property
    def scores(self) -> tuple[Score, ...]:
        """Scores of a residual of zeros: directions, information, kept share."""
        return tuple(score(np.zeros(len(self.q)), self.q, slope) for slope in self.slopes)

    def noise(self, draws: int, rng: np.random.Generator) -> np.ndarray:
        """White residuals after the fit of everything free (draws, r)."""
        white = rng.standard_normal((draws, len(self.q)))
        return white - (white @ self.q) @ self.q.T

    def shown(self, place: int, sigmas: float) -> np.ndarray:
        """What a candidate leaves in the residual (r,) at a strength of so many standard deviations.

        One of several numbers shows its best known combination.
        """
        return sigmas * self.scores[place].directions[:, -1]

    def group(self, place: int, alike: float = 0.9) -> tuple[int, ...]:
        """The candidates that these records hardly tell from this one, itself included."""
        mine = self.scores[place]
        return tuple(i for i, theirs in enumerate(self.scores) if i == place or overlap(mine, theirs) >= alike)

    def statistics(self, residuals: np.ndarray) -> np.ndarray:
        """T of every candidate for every residual (draws, candidates)."""
        return np.stack([np.sum((residuals @ s.directions) ** 2, axis=1) for s in self.scores], axis=1)

    def single(self, residuals: np.ndarray) -> np.ndarray:
        """p-value of every candidate alone for every residual (draws, candidates)."""
        sizes = np.array([s.size for s in self.scores])
        return np.where(sizes > 0, stats.chi2.sf(self.statistics(residuals), np.maximum(sizes, 1)), 1.0)

    def threshold(self, level: float) -> float:
        """Largest p-value alone that the package's rule for families calls significant at this level."""
        low, high = level / (2 * len(self.labels)), level
        for _ in range(12):
            middle = np.sqrt(low * high)
            family = family_p_values([replace(s, p_value=middle if s.size else 1.0) for s in self.scores])
            low, high = (middle, high) if family.min() <= level else (low, middle)
        return low
