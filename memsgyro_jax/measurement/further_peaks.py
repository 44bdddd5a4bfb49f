"""Resonances that stand in the sweeps of one channel beside the one that a device of one axis has."""

from collections.abc import Sequence

import numpy as np
from scipy import signal

from memsgyro_jax.base.text import listed, spoken

from .case import Case
from .experiments.base import Phasors


_AWAY, _STEPS = 5.0, 2.0  # widths, or rows, from the resonance, within which a peak is its own
_RISES = 2.0  # times as high as the dips on both sides of it
_CLEAR = 10.0  # standard deviations above them
_ROWS = 5  # of a sweep at least
_MOST = 3  # peaks that are named


def further_peaks(rows: Sequence[Phasors], omega: float, width: float) -> list[tuple[float, float]]:
    """Frequency [Hz] and height, over that of the largest reading near the resonance, of peaks of the motion beside one
    resonance, the highest first; none of two axes.

    Args:
        rows: of records that drive it.
        omega, width: of the resonance [rad/s].
    """
    found: list[tuple[float, float]] = []
    for row in rows:
        if row.motion.shape[1] > 1 or row.slope is not None:
            continue
        place, inverse = np.unique(row.omega, return_inverse=True)
        count = np.bincount(inverse)
        height = np.bincount(inverse, np.abs(row.motion[:, 0] / row.force[:, 0])) / count
        noise = np.bincount(inverse, 1.0 / (row.weight * np.abs(row.force[:, 0]))) / count
        if len(place) < _ROWS:
            continue
        near = np.abs(place - omega) < max(_AWAY * width, _STEPS * float(np.median(np.diff(place))))
        if not near.any():
            continue
        peaks, _ = signal.find_peaks(np.log(np.maximum(height, 1e-300)), prominence=np.log(_RISES))
        _, left, right = signal.peak_prominences(height, peaks)
        dips = np.maximum(height[left], height[right]) if peaks.size else height[:0]
        clear = (height[peaks] - dips > _CLEAR * noise[peaks]) & ~near[peaks]
        found += [(float(place[k]) / (2 * np.pi), float(height[k] / height[near].max())) for k in peaks[clear]]
    return sorted(found, key=lambda one: -one[1])


def said_of_peaks(rows: Sequence[Phasors], omega: float, width: float, case: Case) -> list[str]:
    """A sentence on them; none where there are none."""
    found = further_peaks(rows, omega, width)
    apart = [one for k, one in enumerate(found) if all(abs(one[0] / other[0] - 1) > 0.01 for other in found[:k])]
    if not apart or case.device != "resonator":
        return []
    which = listed([f"{spoken(place, 'Hz')} ({high:.2g} times as high)" for place, high in apart[:_MOST]])
    peaks = "a further peak stands" if len(apart) == 1 else f"{len(apart)} further peaks stand, the highest"
    return [f"resonance: {peaks} at {which}; a device of one axis has none: keep the rows of the one that is meant."]
