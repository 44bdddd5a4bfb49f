"""Starts without a gradient: what was switched off, or stands where nothing moves, is looked for on a coarse grid."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from .objective import Objective, Values


FLAT = 1e-3  # of the standard deviation over dies: what a factor e changes less than has no effect
_POINTS = 11  # places of the grid, from bound to bound
_DIES = 16  # dies that try them
_GAIN = 0.1  # of the standard deviation of the mean over these dies: a smaller gain is none


def effects(values: Values, stretch: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Root mean square over dies of what a unit of each coordinate changes, over the loss's standard deviation."""
    assert values.slopes is not None
    alive = values.alive
    if not alive.any():
        return np.zeros(len(stretch))
    moved = np.sqrt(np.mean(values.slopes[:, alive] ** 2, axis=1)) * np.abs(stretch)
    return moved / noise_of(values)


def noise_of(values: Values) -> float:
    """Standard deviation of the loss over the dies; where all are alike, its size."""
    loss = values.loss[values.alive]
    spread = float(np.std(loss)) if loss.size > 1 else 0.0
    return spread if spread > 0.0 else max(float(np.max(np.abs(loss), initial=0.0)), np.finfo(float).tiny)


def rescued(
    objective: Objective, numbers: Float[np.ndarray, " n"], penalty: float, told: Callable[[str], None] | None = None
) -> Float[np.ndarray, " n"] | None:
    """`numbers` with the one that has no effect where it stands, and gains most elsewhere, moved there; None if none.

    Only where the other numbers are settled: else it could gain by standing in for one that is still wrong. The grids
    of all of them are tried side by side.
    """
    objective = objective.some(np.arange(min(_DIES, objective.dies)))
    tunables = objective.tunables.chosen((True,) * len(numbers), numbers)
    values = objective.slopes(numbers)
    flat = np.flatnonzero(effects(values, tunables.stretch(tunables.coordinates)) < FLAT)
    tries = [(i, value) for i in flat for value in objective.tunables.grid(i, _POINTS)]
    if not tries:
        return None
    here, _ = objective.total(values, penalty)
    found = _totals(objective, numbers, tries, penalty)
    best = int(np.argmin(found))
    if not found[best] < here - _GAIN * noise_of(values) / np.sqrt(objective.dies):
        return None
    index, value = tries[best]
    moved = np.array(numbers, float)
    moved[index] = value
    if told:
        told(f"{objective.tunables.labels[index]} has no effect where it is; the search goes on from {value:.3g}")
    return moved


def _totals(objective: Objective, numbers: np.ndarray, tries: list[tuple[int, float]], penalty: float) -> np.ndarray:
    """Loss of the lot for each try, all side by side as if they were dies."""
    dies = objective.dies
    each = np.repeat(np.tile(numbers[:, None], (1, len(tries))), dies, axis=1)
    for place, (index, value) in enumerate(tries):
        each[index, place * dies : (place + 1) * dies] = value
    many = objective.some(np.tile(np.arange(dies), len(tries)))
    values = many.values(each)
    parts = (np.arange(place * dies, (place + 1) * dies) for place in range(len(tries)))
    return np.array([objective.total(Values(values.loss[p], values.alive[p]), penalty)[0] for p in parts])
