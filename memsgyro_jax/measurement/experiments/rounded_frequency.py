"""Frequencies of a sweep that a file holds with too few digits: where the response is steep they look like noise, but
repeat in every sweep over the same rows.
"""

from collections.abc import Sequence

import numpy as np

from memsgyro_jax.base.text import spoken


FEWEST, SHARE = 3, 0.2  # rows, and of all rows, at which an even spacing must be off by the last digit
MATTERS = 0.5  # of the noise: what rounding adds to it less is not told
_EXACT = 1e-4  # of the last digit, that a decimal number may be off in binary
_FINEST = -9  # power of ten [Hz] beyond which no file has digits


def last_digit(hertz: np.ndarray, sweeps: Sequence[slice]) -> float:
    """The step [Hz] to which frequencies are rounded; zero where all of its multiples are even grids, as when set so.

    Of an even grid that is rounded the spacings differ by one last digit, here and there.
    """
    coarsest = int(np.floor(np.log10(max(np.max(np.abs(hertz)), 1e-9))))
    for power in range(coarsest, _FINEST - 1, -1):
        digits = hertz * 10.0**-power
        if np.all(np.abs(digits - np.round(digits)) < _EXACT):
            break
    else:
        return 0.0
    bends = np.concatenate([np.abs(np.diff(np.round(digits[rows]), 2)) for rows in sweeps])
    uneven = int(np.sum((bends > 0) & (bends <= 2)))
    return 10.0**power if uneven >= max(FEWEST, SHARE * hertz.size) else 0.0


def rounding_error(hertz: np.ndarray, phasors: np.ndarray, sweeps: Sequence[slice]) -> tuple[float, float]:
    """The step [Hz] to which frequencies are rounded, and by how much that moves readings (n, k) where they are
    steepest, root mean square, in their unit; zeros where they are not.
    """
    step = last_digit(hertz, sweeps)
    if not step:
        return 0.0, 0.0
    steepest = 0.0
    for rows in sweeps:
        apart, change = np.abs(np.diff(hertz[rows])), np.max(np.abs(np.diff(phasors[rows], axis=0)), axis=1)
        known = (apart > 0) & np.isfinite(change)
        steepest = max(steepest, float(np.max(change[known] / apart[known], initial=0.0)))
    return step, steepest * step / float(np.sqrt(12.0))


def rounded_frequencies(
    file: str, hertz: np.ndarray, phasors: np.ndarray, sweeps: Sequence[slice], noise: float | None, unit: str
) -> list[str]:
    """A warning where that is a good part of the noise."""
    step, error = rounding_error(hertz, phasors, sweeps)
    if not noise or error <= MATTERS * noise:
        return []
    moved = f"moves readings on the flanks by {spoken(error, unit, 3)}, {error / noise:.2g} times the noise"
    return [f"{file}: the frequencies are rounded to {spoken(step, 'Hz', 2)}, which {moved}; more digits tell more."]
