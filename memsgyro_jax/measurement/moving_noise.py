"""How much white noise the rows of a sweep have that never settles, told by the rows alone."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import special

from .noise import noise_over_frequency


_WINDOW = 15  # neighbouring rows that a local model explains
_ORDER = 4  # of the polynomial for what the drive adds from row to row
_EVEN = 0.05  # of the time between rows: what it may vary by, as what is left after it is one number then
_LOUD = 0.75  # of the windows: beyond that share of them the motion is large
_CLEARLY = 0.8  # of the noise that plain neighbours tell: less than that is motion that they take for noise
_FREEDOM = 0.75  # degrees of freedom per row and channel beyond a window, as found by simulation


def beside_motion(told: tuple[float | None, float], record: Any, channels: Sequence[int]) -> tuple[float | None, float]:
    """Noise of some channels of a sweep whose rows had not settled, and its degrees of freedom: as rows tell it of a
    motion that goes on from one to the next, where that is clearly less than was `told` without one.
    """
    if record.time is None or told[0] is None or not record.phase_known:
        return told
    every = list(record.channels)
    numbers = [every.index(channel) for channel in channels]
    moving = noise_of_moving(record.time, record.frequency, record.phasors[:, every], numbers, record.sweeps)
    return moving if moving[0] < _CLEARLY * told[0] else told


def as_settled(record: Any) -> float:
    """Noise of the rows of a sweep as a device has it that settled at each of them: of rows that had not, what
    neighbours tell, which takes the motion that goes on between them for noise.
    """
    if record.settled or not record.phase_known:
        return float(record.noise_level)
    plain = noise_over_frequency(record.frequency, record.readings[:, record.channels], record.sweeps, record.courses)
    return max(plain or 0.0, float(record.noise_level))


def noise_of_moving(
    time: np.ndarray, frequency: np.ndarray, phasors: np.ndarray, channels: Sequence[int], pieces: Sequence[slice]
) -> tuple[float, float]:
    """Standard deviation of each real part of some channels of phasors (n, every channel) that were read at times (n,)
    [s] under a drive whose frequency (n,) [rad/s] is stepped, and its degrees of freedom; infinite and zero where there
    are too few rows or the time between them varies.

    A row is what is left of the row before, in all channels, turned by as much as the drive has gone ahead of it, and
    what the drive has added since, which goes smoothly with its frequency. So in every window of 15 rows a matrix for
    the one and a polynomial for the other leave noise alone: that of a row beside what is predicted of it from the row
    before, as read, whose own is part of it. Where little dies out in between that is √2 times the noise of a reading.
    """
    found = []
    for piece in pieces:
        apart = np.diff(time[piece])
        if len(apart) >= _WINDOW - 1 and np.ptp(apart) <= _EVEN * np.median(apart):
            found.append(_windows(apart, frequency[piece], phasors[piece], channels))
    if not found:
        return np.inf, 0.0
    levels, brought, size = (np.concatenate(part) for part in zip(*found, strict=True))
    loud = size >= np.quantile(size, _LOUD)  # a faint motion hardly tells what is left of it from row to row
    left = min(1.0, float(np.median(brought[loud])))
    return float(np.sqrt(np.median(levels) * (1.0 + left))), max(1.0, _FREEDOM * levels.size)


def _windows(
    apart: np.ndarray, frequency: np.ndarray, phasors: np.ndarray, channels: Sequence[int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of every window (windows, channels): squares that the local model leaves, over their median for a noise of 1 in
    each reading; the share of the noise of the row before, squared, that it brings along; and the size of the readings
    before.
    """
    rows = np.arange(1, len(phasors) - _WINDOW + 2)[:, None] + np.arange(_WINDOW - 1)
    ahead = (frequency[rows] - frequency[rows].mean(axis=1, keepdims=True)) * apart[rows - 1]
    before = phasors[rows - 1] * np.exp(-1j * ahead)[..., None]  # (windows, rows, every channel)
    size = np.maximum(np.linalg.norm(before, axis=1, keepdims=True), 1e-300)
    smooth = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, _WINDOW - 1), _ORDER)
    columns = np.concatenate([np.broadcast_to(smooth + 0j, (len(rows), *smooth.shape)), before / size], axis=2)
    seen = phasors[rows][..., list(channels)]
    found = np.linalg.pinv(columns, rcond=1e-12) @ seen
    left = np.sum(np.abs(seen - columns @ found) ** 2, axis=1)
    brought = np.sum(np.abs(found[:, _ORDER + 1 :] / np.swapaxes(size, 1, 2)) ** 2, axis=1)
    spare = 2 * (_WINDOW - 1 - columns.shape[2])
    return left / (1.0 + brought) / special.chdtri(spare, 0.5), brought, size[:, 0, list(channels)]
