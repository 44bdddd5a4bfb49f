"""Where the further numbers of an effect begin to be fitted: a gap beyond the swing shows nothing at any strength."""

from collections.abc import Iterable
from itertools import product

import numpy as np

from .joint_residual import Joint
from .optimum import Optimum
from .score import basis, score, within_bounds


POINTS = 9  # of each number between its bounds


def with_numbers_that_show(joint: Joint, optimum: Optimum, places: np.ndarray) -> tuple[np.ndarray, dict[int, int]]:
    """The vector of an optimum in which effects that are absent, and that the fitted readings would not show with the
    numbers that they have, have those of a grid between their bounds with which they would explain most; and, by the
    places of those effects, how many points were looked at, which chance had as well.

    Strength zero leaves the model as it is whatever those numbers are. None but those at `places` move.
    """
    vector, q, (low, high) = optimum.vector.copy(), basis(optimum.jacobian), joint.bounds
    looked: dict[int, int] = {}
    for effect in range(len(joint.model.effects)):
        mine, numbers = joint.of_effect(effect), np.intersect1d(joint.numbers_of(effect), places)
        if not numbers.size or np.any(vector[mine]):
            continue

        def seen(point: Iterable[float], mine=mine, numbers=numbers) -> np.ndarray:
            at = vector.copy()
            at[numbers] = [*point]
            slopes = joint.linearise(at, np.eye(at.size)[mine], joint.fitted)[1]
            return np.where(np.isfinite(slopes), slopes, 0.0)

        def told(point: Iterable[float], mine=mine, seen=seen) -> float:
            slopes = seen(point)
            if not np.any(slopes):
                return 0.0
            alone = score(optimum.residual, q, slopes)
            return within_bounds(alone, optimum.residual, slopes, low[mine], high[mine]).statistic

        if np.any(seen(vector[numbers])):
            continue
        points = [*product(*(_between(low[k], high[k], vector[k]) for k in numbers))]
        vector[numbers], looked[effect] = max(points, key=told), len(points)
    return vector, looked


def _between(low: float, high: float, start: float) -> np.ndarray:
    """Values to try: its own first, as the first of equals is taken, and some within bounds that are finite."""
    if not np.isfinite(high - low):
        return np.array([start])
    return np.concatenate([[start], low + (high - low) * (np.arange(POINTS) + 0.5) / POINTS])
