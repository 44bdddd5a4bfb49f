"""Where a waveform that nothing drives begins to die out, and where it can no longer be read."""

from typing import NamedTuple

import numpy as np

from .experiments.clipping import clipped_rows
from .experiments.converter_steps import lost_in_steps, rms_around


_LOUD = 0.9  # of the largest envelope: the decay has not begun
_FALLEN = 0.02  # in natural logarithms: an envelope that falls by less is kept up
_EARLY = 0.94  # of the usual fall: an envelope that falls by so much in its first quarter falls from the start


class DecayRows(NamedTuple):
    """The rows of a record that are a free decay.

    Args:
        begin, end: the first row, and the one behind the last.
        why: where it begins and why, in words to put a time into; empty for the first row. `until` likewise of its end.
    """

    begin: int
    end: int
    why: str = ""
    until: str = ""


def part_of_decay(signal: np.ndarray, unit: str, fewest: int) -> DecayRows:
    """What of a waveform (n,) in a unit is a free decay that its converter could read, of `fewest` rows at least.

    It begins where its envelope was last near its largest, or is no longer clipped.
    """
    rows, begin, why = len(signal), begin_of_decay(signal), "begins at {}, where its envelope falls for good"
    if begin <= 0.02 * rows:
        begin, why = 0, ""
    if begin < (whole := _behind_clipping(signal)) < rows - fewest:
        begin, why = whole, "begins at {}, where it is no longer clipped, as at the end of a range"
    end, step = lost_in_steps(signal)
    if end == rows or end - begin < fewest:
        return DecayRows(begin, rows, why)
    small = f"where it falls below four steps of {step:.3g} {unit}, in which it was read and which hide what is smaller"
    return DecayRows(begin, end, why, f"ends at {{}}, {small}")


def begin_of_decay(signal: np.ndarray) -> int:
    """The row (n,) from which on a waveform dies out: where its envelope was last near its largest, or the first."""
    width = max(len(signal) // 50, 3)
    envelope = rms_around(signal - np.mean(signal), width)
    return 0 if _falls_from_the_start(envelope, width) else int(np.flatnonzero(envelope >= _LOUD * envelope.max())[-1])


def _behind_clipping(signal: np.ndarray) -> int:
    """The row (n,) behind the last one in which a waveform seems to be clipped, 0 where it is not."""
    rows = clipped_rows(signal)
    return int(rows[-1]) + 1 if len(rows) else 0


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
