"""What became of each free number: moved, without effect, at its bound, or part of a direction without effect."""

import numpy as np
from jaxtyping import Float

from memsgyro_jax.base.text import combination

from .grid import EDGE, FLAT, changes_of
from .objective import Values, noise_of
from .result import TunedNumber
from .tunable import Tunables


_STAYED = 0.01  # of ln(value), or of the range: less is no move
_PART = 0.1  # shares of a direction below this are not named


def fates(tunables: Tunables, found: Float[np.ndarray, " n"], values: Values) -> tuple[str, ...]:
    """In words, for each number."""
    effect = changes_of(values, _units(tunables, found))
    places = tunables.places(found)
    nulls = _null_vectors(tunables, found, values)
    words = []
    for i in range(len(tunables.paths)):
        parts = [_moved(tunables, found, i)]
        if places[i] < EDGE:
            parts.append("at its lower bound")
        elif places[i] > 1.0 - EDGE:
            parts.append("at its upper bound")
        if effect[i] < FLAT:
            parts.append("small changes there have no effect")
        elif any(abs(vector[i]) > _PART for vector in nulls):
            parts.append("in a direction without effect")
        words.append(", ".join(parts))
    return tuple(words)


def tuned_numbers(
    tunables: Tunables, found: Float[np.ndarray, " n"], values: Values, stage: str
) -> tuple[TunedNumber, ...]:
    """What the stage of this name made of each number."""
    rows = np.stack([tunables.values, found, tunables.low, tunables.high], axis=1).tolist()
    named = zip(tunables.labels, tunables.paths, rows, fates(tunables, found, values), strict=True)
    return tuple(TunedNumber(label, path, *row, stage=stage, fate=fate) for label, path, row, fate in named)


def null_directions(tunables: Tunables, found: Float[np.ndarray, " n"], values: Values) -> tuple[str, ...]:
    """Combinations of numbers, each with an effect of its own, along which no die's loss changes; logarithmic."""
    return tuple(
        combination(vector, tunables.labels, _PART, len(vector)) for vector in _null_vectors(tunables, found, values)
    )


def _null_vectors(tunables: Tunables, found: np.ndarray, values: Values) -> list[np.ndarray]:
    """Right singular vectors, of the dies' slopes by relative changes, that change less than counts as an effect."""
    assert values.slopes is not None
    units = _units(tunables, found)
    own = changes_of(values, units) >= FLAT
    slopes = (values.slopes[own] * units[own, None])[:, values.alive] / noise_of(values)
    if slopes.shape[0] < 2 or slopes.shape[1] < slopes.shape[0]:
        return []
    squares, vectors = np.linalg.eigh(slopes @ slopes.T / slopes.shape[1])
    out = []
    for square, vector in zip(squares, vectors.T, strict=True):
        if np.sqrt(max(square, 0.0)) < FLAT:
            whole = np.zeros(len(own))
            whole[own] = vector * np.sign(vector[np.argmax(np.abs(vector))])
            out.append(whole)
    return out


def _units(tunables: Tunables, found: np.ndarray) -> np.ndarray:
    """A factor e of each number, or its range where it is not on a logarithmic scale."""
    return np.where(tunables.logarithmic, found, tunables.high - tunables.low)


def _moved(tunables: Tunables, found: np.ndarray, i: int) -> str:
    start, value = tunables.values[i], found[i]
    if tunables.logarithmic[i]:
        return f"moved x {value / start:.3g}" if abs(np.log(value / start)) > _STAYED else "stayed"
    change = value - start
    return f"moved {change:+.3g}" if abs(change) > _STAYED * (tunables.high[i] - tunables.low[i]) else "stayed"
