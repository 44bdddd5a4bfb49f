"""Whether the waveform of a record ends at a value that it cannot exceed, as where a converter's range ends."""

import numpy as np


_FEWEST = 8  # rows at an end
_AS_OFTEN = 4.0  # times any other value: the top step of a sine is taken 2.4 times as often as the next, at most
_ALIKE = 1e-6  # of the span: values that are the same
_OUTER = 0.25  # of the span: how far from an end values are held beside it, where a decay dwells at its middle
_FLAT = 1 / 6  # of the rows at an end, which stand between two others there: half of them, in tops of three rows


def clipped(file: str, name: str, values: np.ndarray, unit: str) -> list[str]:
    """A sentence for each end at which a waveform (n,) seems to be clipped.

    Args:
        file, name: of the record, and of the channel.
        values: (n,) real.
        unit: of the values, empty for none.
    """
    found = []
    for word, rows in zip(("largest", "smallest"), _flat_ends(values), strict=True):
        if len(rows):
            value = float(values[rows[0]])
            found.append(
                f"{file}: {name} has its {word} value, {value:.4g}{unit}, in {len(rows)} rows, more than "
                f"{_AS_OFTEN:g} times as often as any other near it: it seems to be clipped there, as where a "
                "converter's range ends."
            )
    return found


def clipped_rows(values: np.ndarray) -> np.ndarray:
    """Numbers of the rows in which a waveform (n,) seems to be clipped, rising; none where it is not."""
    return np.sort(np.concatenate(_flat_ends(values)))


def _flat_ends(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows at the largest and at the smallest value of a waveform (n,), each empty unless they are eight or more, and
    four times as many as those of any value between; where they follow each other as a flat top does, of any value
    in the outer quarter, so that what else a record holds, like the end of a decay, does not hide it.

    Noise leaves no such ends, nor do a sine of few rows in a period, whose other values come back as often, and the
    steps of a converter within its range.
    """
    none = np.zeros(0, int)
    span = float(np.ptp(values))
    if not span > 0:
        return none, none
    places = np.round((values - values.max()) / (_ALIKE * span))
    steps, counts = np.unique(places, return_counts=True)
    found = []
    for end in (-1, 0):
        rows, others, away = np.flatnonzero(places == steps[end]), counts[1:-1], np.abs(steps[1:-1] - steps[end])
        if np.sum(rows[2:] - rows[:-2] == 2) >= _FLAT * len(rows):
            others = others[away <= _OUTER / _ALIKE]
        told = len(others) > 0 and len(rows) >= max(_FEWEST, _AS_OFTEN * np.max(others))
        found.append(rows if told else none)
    return found[0], found[1]
