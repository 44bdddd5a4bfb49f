"""Whether a row far off its neighbours is the top of a resonance that is narrower than the steps of its sweep."""

import numpy as np


_SIDE = 3  # rows on each side, which show the flanks
_WITHIN = 1.0  # steps from the row, within which the pole, or the top, is
_AGREES = 0.3  # of a step, or of the reciprocal square beside the row: how far what the row says of it may lie off
_BETTER = 0.1  # of what a cubic through the neighbours leaves


def is_narrow_peak(place: np.ndarray, values: np.ndarray, row: int) -> bool:
    """Whether the flanks on both sides of a row are those of one resonance that puts it where it is, and no smooth
    curve; `False` fewer than three rows from an end.

    Args:
        place: (n,) strictly monotonic frequency.
        values: (n,) complex phasors, or real amplitudes.
        row: that stands alone.
    """
    if not _SIDE <= row < len(values) - _SIDE:
        return False
    near = np.delete(np.arange(row - _SIDE, row + _SIDE + 1), _SIDE)
    step = min(abs(place[row] - place[row - 1]), abs(place[row + 1] - place[row]))
    x, seen, top = (place[near] - place[row]) / step, values[near], values[row]
    if not np.all(np.isfinite(seen)) or not np.all(np.abs(seen) > 0):
        return False
    curve = np.vander(x, 4)
    smooth = float(np.sum(np.abs(seen - curve @ np.linalg.lstsq(curve, seen, rcond=None)[0]) ** 2))
    fits, peak = (_pole if np.iscomplexobj(values) else _parabola)(x, seen, top)
    return peak and fits < _BETTER**2 * smooth


def _pole(x: np.ndarray, seen: np.ndarray, top: complex) -> tuple[float, bool]:
    """What a pole and a constant beside it leave of phasors at `x` steps from a row, squared, and whether it is beside
    the row and the row's own phasor says the same: X·(x − p) = α + β·x.
    """
    columns = np.stack([seen, np.ones(len(x)), x], axis=1)
    weight = 1.0 / np.abs(x)
    pole, level, slope = np.linalg.lstsq(columns * weight[:, None], seen * x * weight, rcond=None)[0]
    left = seen - (level + slope * x) / (x - pole)
    own = -level / top
    return float(np.sum(np.abs(left) ** 2)), bool(abs(pole.real) < _WITHIN and abs(own - pole) < _AGREES)


def _parabola(x: np.ndarray, seen: np.ndarray, top: float) -> tuple[float, bool]:
    """The same of amplitudes, whose reciprocal square is a parabola."""
    weight, powers = seen**2, np.vander(x, 3)
    bend, slope, level = np.linalg.lstsq(powers * weight[:, None], np.ones(len(x)), rcond=None)[0]
    if bend <= 0 or top <= 0:
        return np.inf, False
    made = powers @ np.array([bend, slope, level])
    left = seen - 1.0 / np.sqrt(np.maximum(made, 1e-3 / seen**2))
    beside = float(np.min(1.0 / seen**2))
    agrees = abs(1.0 / top**2 - level) < _AGREES * beside
    return float(np.sum(left**2)), bool(abs(slope / (2 * bend)) < _WITHIN and agrees)
