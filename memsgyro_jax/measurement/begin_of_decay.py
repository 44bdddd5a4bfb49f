"""Where a waveform that nothing drives begins to die out."""

import numpy as np

from .experiments.clipping import clipped_rows


_LOUD = 0.9  # of the largest envelope: the decay has not begun
_FALLEN = 0.02  # in natural logarithms: an envelope that falls by less is kept up
_EARLY = 0.94  # of the usual fall: an envelope that falls by so much in its first quarter falls from the start


def begin_of_decay(signal: np.ndarray) -> int:
    """The row (n,) from which on a waveform dies out: where its envelope was last near its largest, or the first."""
    width = max(len(signal) // 50, 3)
    envelope = _envelope(signal - np.mean(signal), width)
    return 0 if _falls_from_the_start(envelope, width) else int(np.flatnonzero(envelope >= _LOUD * envelope.max())[-1])


def behind_clipping(signal: np.ndarray) -> int:
    """The row (n,) behind the last one in which a waveform seems to be clipped, 0 where it is not."""
    rows = clipped_rows(signal)
    return int(rows[-1]) + 1 if len(rows) else 0


def _envelope(signal: np.ndarray, width: int) -> np.ndarray:
    """Root mean square over so many rows around each."""
    every = np.ones(width)
    return np.sqrt(np.convolve(signal**2, every, mode="same") / np.convolve(np.ones(len(signal)), every, mode="same"))


def _falls_from_the_start(envelope: np.ndarray, width: int) -> bool:
    """Whether a free decay has begun before the first row: until it has halved, or the record ends, it falls by nearly
    as much in the first quarter as in the others, while one that is kept up first falls later.
    """
    whole = envelope[width // 2 :]  # before, there are not as many rows around each, and it seems to fall more slowly
    halved = whole < 0.5 * whole[0]
    end = int(np.argmax(halved)) if halved.any() else len(whole) - 1
    quarter, fall = end // 4, float(np.log(whole[0] / whole[end]))
    if quarter < width or fall < _FALLEN:
        return False
    return bool(4.0 * np.log(whole[0] / whole[quarter]) > _EARLY * fall)
