"""Where a vibration that dies out falls below the steps of the converter that read it."""

import numpy as np


_ALIKE = 0.1  # of a step: distances between values that are whole numbers of it, as far as they are printed
_FEW = 0.25  # of the rows: so many values at most have steps
_LEAST = 4.0  # steps: a smaller amplitude is read too large or too small by what rounding makes of it
_STILL = 0.5  # steps: noise of so much (rms) carries a vibration across them, and nothing is lost
_WINDOW = 1 / 50  # of the rows, over which an amplitude is told
_KEPT = 0.97  # of the rows: an end behind them changes nothing


def step_of(values: np.ndarray) -> float:
    """The step in which a waveform (n,) was read, in its unit; zero where there is none."""
    known = np.unique(values)
    if len(known) < 3 or len(known) > _FEW * len(values):
        return 0.0
    apart = np.diff(known)
    step = float(np.median(apart))
    return step if np.all(np.abs(apart / step - np.round(apart / step)) < _ALIKE * (apart / step)) else 0.0


def lost_in_steps(values: np.ndarray) -> tuple[int, float]:
    """The row from which on a waveform (n,) is smaller than four steps of its converter, which hides what noise does
    not carry across them, and that step; the number of rows where there is no such end.
    """
    rows, step = len(values), step_of(values)
    width = max(int(_WINDOW * rows), 3)
    if not step > 0.0 or rows < 4 * width:
        return rows, step
    size = rms_around(values - values[-width:].mean(), width)
    above = np.flatnonzero(np.sqrt(2.0) * size > _LEAST * step)
    end = int(above[-1]) + 1 if above.size else rows
    return (end, step) if end < _KEPT * rows and size[end:].min() < _STILL * step else (rows, step)


def rms_around(values: np.ndarray, width: int) -> np.ndarray:
    """Root mean square over so many rows around each."""
    every = np.ones(width)
    return np.sqrt(np.convolve(values**2, every, mode="same") / np.convolve(np.ones(len(values)), every, mode="same"))
