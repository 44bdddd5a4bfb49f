"""Spectral lines of a record and of its derivatives, none of which leaks into the equation of motion of another."""

import numpy as np


def derivatives(
    signals: np.ndarray, omega: np.ndarray, period: float, late: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Spectral lines at `omega` of signals (n, channels) under a Hann window, and those of their first and second
    derivative under the same, by parts: as window and slope vanish at both ends, no line leaks into another's equation
    of motion (modulating functions: Shinbrot, Trans. ASME 79 (1957) 547).

    The samples are `late` by a part of the period.
    """
    pace, turn = 2 * np.pi / ((len(signals) - 1) * period), 1j * omega[:, None]
    phase = pace * period * (np.arange(len(signals)) + late)[:, None]
    windows = (1 - np.cos(phase)) / 2, pace * np.sin(phase) / 2, pace**2 * np.cos(phase) / 2
    begun, first, second = (np.fft.rfft(signals * w, axis=0) * np.exp(-turn * late * period) for w in windows)
    return begun, turn * begun - first, turn**2 * begun - 2 * turn * first + second
