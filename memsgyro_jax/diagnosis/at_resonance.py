"""Whether what is left of frequency sweeps is larger where the device answers: noise, however slow, does not know where
that is, but what a model lacks does, and so do a device whose frequency jitters and a drive whose level does.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import special

from memsgyro_jax.measurement.case import AbstractRecord
from memsgyro_jax.measurement.experiments import Deviation

from .misfit import FEW, LEVEL


NEAR = 0.2  # of the largest squared response of a sweep: a resonance has it one width from its middle


def larger_at_resonance(left: Sequence[np.ndarray], near: Sequence[np.ndarray]) -> float:
    """Probability that rows (n, k) of records, white and of one size but for that, are by chance as much larger near a
    resonance (n, k) than elsewhere, all records together; one where there are too few of either.

    The fit takes away most of what chance leaves near the resonance, so that it is rather less.
    """
    square = np.concatenate([(rows**2 / np.mean(rows**2)).ravel() for rows in left]) if left else np.zeros(0)
    inside = np.concatenate([mine.ravel() for mine in near]) if near else np.zeros(0, bool)
    count, others = int(inside.sum()), int((~inside).sum())
    if min(count, others) < FEW:
        return 1.0
    return float(special.fdtrc(count, others, np.mean(square[inside]) / np.mean(square[~inside])))


def concentrated(records: Sequence[tuple[AbstractRecord, Deviation]]) -> bool:
    """Whether deviations, white but for that, are larger near the resonances of frequency sweeps than noise is."""
    swept = [pair for record, deviation in records if record.stepped for pair in _columns(record, deviation)]
    return larger_at_resonance([rows for rows, _ in swept], [near for _, near in swept]) <= LEVEL


def _columns(record: AbstractRecord, deviation: Deviation) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Of each channel what is compared of its deviations, and which of it is near the resonance of its single sweep."""
    power = np.abs(deviation.predicted) ** 2
    near = np.zeros(power.shape, bool)
    for piece in getattr(record, "sweeps", ()):
        near[piece] = power[piece] > NEAR * np.max(power[piece], axis=0)
    for channel in record.channels:
        rows = deviation.white[:, channel]
        seen = np.isfinite(rows).all(axis=1)
        if seen.any() and getattr(record, "sweeps", ()):
            yield rows[seen], np.repeat(near[seen, channel][:, None], rows.shape[1], axis=1)
