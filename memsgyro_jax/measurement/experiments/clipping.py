"""Whether the waveform of a record ends at a value that it cannot exceed, as where a converter's range ends."""

import numpy as np


_FEWEST = 8  # rows at an end
_AS_OFTEN = 4.0  # times any other value: the top step of a sine is taken 2.4 times as often as the next, at most
_ALIKE = 1e-6  # of the span: values that are the same


def clipped(file: str, name: str, values: np.ndarray, unit: str) -> list[str]:
    """A sentence for each end of a waveform (n,) that stands in eight rows or more, and four times as often as any
    value between the ends.

    Noise leaves no such ends, nor do a sine of few rows in a period, whose other values come back as often, and the
    steps of a converter within its range.

    Args:
        file, name: of the record, and of the channel.
        values: (n,) real.
        unit: of the values, empty for none.
    """
    span = float(np.ptp(values))
    if not span > 0:
        return []
    places = np.round((values - values.max()) / (_ALIKE * span))
    steps, counts = np.unique(places, return_counts=True)
    others = counts[1:-1]
    found = []
    for word, end in (("largest", -1), ("smallest", 0)):
        if len(others) and counts[end] >= max(_FEWEST, _AS_OFTEN * np.max(others)):
            value = float(values[places == steps[end]][0])
            found.append(
                f"{file}: {name} has its {word} value, {value:.4g}{unit}, in {counts[end]} rows, more than "
                f"{_AS_OFTEN:g} times as often as any other: it seems to be clipped there, as where a converter's "
                "range ends."
            )
    return found
