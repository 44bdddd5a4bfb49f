"""Where a waveform that nothing drives begins to die out."""

import numpy as np


_LOUD = 0.9  # of the largest envelope: the decay has not begun
_FALLEN = 0.02  # in natural logarithms: an envelope that falls by less is kept up
_EARLY = 0.88  # of the usual fall: an envelope that falls by so much in its first quarter falls from the start


def begin_of_decay(signal: np.ndarray) -> int:
    """The row (n,) from which on a waveform dies out: where its envelope was last near its largest, or the first."""
    envelope = _envelope(signal - np.mean(signal))
    return 0 if _falls_from_the_start(envelope) else int(np.flatnonzero(envelope >= _LOUD * envelope.max())[-1])


def _envelope(signal: np.ndarray) -> np.ndarray:
    """Root mean square over a fiftieth of the record around each row."""
    every = np.ones(max(len(signal) // 50, 3))
    return np.sqrt(np.convolve(signal**2, every, mode="same") / np.convolve(np.ones(len(signal)), every, mode="same"))


def _falls_from_the_start(envelope: np.ndarray) -> bool:
    """Whether a free decay has begun before the first row: until it has halved, or the record ends, it falls by nearly
    as much in the first quarter as in the others, while one that is kept up first falls later.
    """
    halved = envelope < 0.5 * envelope[0]
    end = int(np.argmax(halved)) if halved.any() else len(envelope) - 1
    quarter, fall = end // 4, float(np.log(envelope[0] / envelope[end]))
    if quarter < max(len(envelope) // 50, 3) or fall < _FALLEN:
        return False
    return bool(4.0 * np.log(envelope[0] / envelope[quarter]) > _EARLY * fall)
