"""Rows that stand alone among their neighbours, as a mistyped digit leaves them."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view


_SIGMAS = 12.0  # beyond this a row is reported
_FLAT = 0.25  # share of the jump that the neighbours may still disagree by once the row is replaced
_AROUND = 12  # rows on each side from which the usual misfit is told


def interpolation_misfit(place: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(n, ...) difference of each row from the cubic through its four neighbours, per its standard deviation for white
    noise of 1; zero for the two rows at each end.

    Args:
        place: (n,) strictly monotonic abscissa.
        values: (n, ...) real or complex.
    """
    misfit = np.zeros_like(values)
    weights = _weights(place)
    shape = (-1, *(1,) * (values.ndim - 1))
    inner = values[2:-2].copy()
    for step, weight in zip((0, 1, 3, 4), weights, strict=True):
        inner -= weight.reshape(shape) * values[step : len(values) - 4 + step]
    misfit[2:-2] = inner / np.sqrt(1 + np.sum(weights**2, axis=0)).reshape(shape)
    return misfit


def _weights(place: np.ndarray) -> np.ndarray:
    """(4, n - 4) Lagrange weights of the neighbours two and one before, one and two after."""
    nodes = np.stack([place[step : len(place) - 4 + step] - place[2:-2] for step in (0, 1, 3, 4)])
    weights = np.ones_like(nodes)
    for own in range(4):
        for other in range(4):
            if other != own:
                weights[own] *= -nodes[other] / (nodes[own] - nodes[other])
    return weights


def lone_rows(place: np.ndarray, values: np.ndarray, noise: float) -> list[tuple[int, float]]:
    """Rows that a cubic through their neighbours misses by more than 12 standard deviations, and by how many.

    What counts as a standard deviation is the declared noise, or the usual misfit around the row where that is larger:
    at a resonance the curve itself bends. A step, after which the new level stays, is none; nor is the first row of a
    new course, which those on one side of it continue.

    Args:
        place: (n,) strictly monotonic abscissa.
        values: (n,) real or complex.
        noise: standard deviation of each real reading; zero takes the usual misfit alone.
    """
    if len(values) < 9:
        return []
    misfit = np.abs(interpolation_misfit(place, values))
    scale = np.maximum(noise, _usual(misfit))
    high = misfit > _SIGMAS * np.maximum(scale, 1e-12 * float(np.max(np.abs(values))))
    high &= misfit == np.max(sliding_window_view(np.pad(misfit, 2), 5), axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        sigmas = misfit / scale
    rows = [int(row) for row in np.flatnonzero(high)]
    return [
        (row, float(sigmas[row]))
        for row in rows
        if _mends(place, values, row, misfit[row]) and not _continues(place, values, row, misfit[row])
    ]


def _usual(misfit: np.ndarray) -> np.ndarray:
    """Upper quartile of the misfit around each row, without the rows that it touches itself."""
    usual = np.full(len(misfit), np.inf)
    offsets = np.r_[-_AROUND:-2, 3 : _AROUND + 1]
    whole = np.arange(2 + _AROUND, len(misfit) - 2 - _AROUND)
    if whole.size:
        windows = sliding_window_view(misfit, 2 * _AROUND + 1)[2 : 2 + whole.size]
        usual[whole] = np.quantile(windows[:, offsets + _AROUND], 0.75, axis=1)
    for row in set(range(2, len(misfit) - 2)) - set(whole.tolist()):
        around = row + offsets
        around = around[(around >= 2) & (around < len(misfit) - 2)]
        if around.size:
            usual[row] = np.quantile(misfit[around], 0.75)
    return usual


def _mends(place: np.ndarray, values: np.ndarray, row: int, jump: float) -> bool:
    """Whether the neighbours agree among themselves once the row is replaced by what they say."""
    piece = slice(max(row - 4, 0), row + 5)
    mended = values[piece].copy()
    centre = row - piece.start
    weights = _weights(place[row - 2 : row + 3])[:, 0]
    mended[centre] = np.sum(weights * mended[[centre - 2, centre - 1, centre + 1, centre + 2]])
    return bool(np.max(np.abs(interpolation_misfit(place[piece], mended))) < _FLAT * jump)


def _continues(place: np.ndarray, values: np.ndarray, row: int, jump: float) -> bool:
    """Whether a row lies on the parabola through the three rows before it, or the three after it."""
    for side in (np.arange(row - 3, row), np.arange(row + 3, row, -1)):
        if side.min() >= 0 and side.max() < len(place):
            nodes = place[side]
            weights = [np.prod([(place[row] - b) / (a - b) for b in nodes if b != a]) for a in nodes]
            if abs(values[row] - np.sum(weights * values[side])) < _FLAT * jump:
                return True
    return False
