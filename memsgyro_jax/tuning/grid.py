"""Coarse grids: they bring a bad start near, and find what has no gradient where it stands, off or at a bound."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from .objective import Objective, Values, noise_of


FLAT = 1e-3  # of the standard deviation over dies: what a factor e changes less than has no effect
_POINTS = 11  # places of the grid, from bound to bound
_DIES = 16  # dies that try them
_GAIN = 0.1  # standard errors of the mean over these dies: a smaller gain is none
_CLEAR = 1.0  # standard errors that a step of the first scan must gain
EDGE = 0.02  # of the range: so near to a bound counts as at it


def changes_of(values: Values, stretch: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Root mean square over dies of what a unit of each coordinate changes, over the loss's standard deviation."""
    assert values.slopes is not None
    alive = values.alive
    if not alive.any():
        return np.zeros(len(stretch))
    moved = np.sqrt(np.mean(values.slopes[:, alive] ** 2, axis=1)) * np.abs(stretch)
    return moved / noise_of(values)


def scanned(
    objective: Objective, numbers: Float[np.ndarray, " n"], penalty: float, told: Callable[[str], None]
) -> Float[np.ndarray, " n"]:
    """`numbers` with one after the other moved to the best of its coarse grid, the one that gains most first.

    A few runs bring a bad start near, where a descent would take dozens of gradients; all tries run side by side.
    """
    for _ in range(len(numbers)):
        moved = _better(objective, numbers, np.arange(len(numbers)), penalty, _CLEAR, told)
        if moved is None:
            break
        numbers = moved
    return numbers


def rescued(
    objective: Objective, numbers: Float[np.ndarray, " n"], penalty: float, told: Callable[[str], None]
) -> Float[np.ndarray, " n"] | None:
    """`numbers` with one that has no effect where it stands, or is at a bound, moved where it gains; None if none.

    Only where the other numbers are settled: else it could gain by standing in for one that is still wrong.
    """
    tunables = objective.tunables.starting(numbers)
    stretch, places = tunables.stretch(tunables.coordinates), tunables.places(numbers)
    values = objective.slopes(numbers)
    stuck = (changes_of(values, stretch) < FLAT) | (places < EDGE) | (places > 1.0 - EDGE)
    return _better(objective, numbers, np.flatnonzero(stuck), penalty, _GAIN, told)


def _better(
    objective: Objective, numbers: np.ndarray, which: np.ndarray, penalty: float, worth: float,
    told: Callable[[str], None],
) -> np.ndarray | None:  # fmt: skip
    """The best of the grids of some numbers; None if it gains less than `worth` standard errors."""
    objective = objective.some(np.arange(min(_DIES, objective.dies)))
    grid = objective.tunables.at_places((np.arange(_POINTS)[:, None] + 0.5) / _POINTS)
    tries = [(i, value) for i in which for value in grid[:, i]]
    if not tries:
        return None
    values = objective.values(numbers)
    here, _ = objective.total(values, penalty)
    found = _totals(objective, numbers, tries, penalty)
    best = int(np.argmin(found))
    if not found[best] < here - worth * noise_of(values) / np.sqrt(objective.dies):
        return None
    index, value = tries[best]
    moved = np.array(numbers, float)
    moved[index] = value
    told(f"{objective.tunables.labels[index]} from {numbers[index]:.3g} to {value:.3g}, the best of a coarse grid")
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
