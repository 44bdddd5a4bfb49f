"""Rows that stand alone among their neighbours, as a mistyped digit leaves them: in what was read, and in what a fit
leaves of it.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import special


_SIGMAS = 12.0  # beyond this a row is reported
_AS_FAR = 0.8  # of the largest misfit around: where rows stand unevenly, that of a wrong row's neighbour may be larger
_FLAT = 0.25  # share of the jump that the neighbours may still disagree by once the row is replaced
_AROUND = 12  # rows on each side from which the usual misfit is told
LEVEL = 1e-3  # share of records of normal noise in which `lone_residuals` finds a row
_NEAR = 6  # rows on each side that say what a residual should be
_FREEDOM = 0.3  # degrees of freedom per row of a robust standard deviation
_AGREE = 0.7  # share of a row's excess that its neighbours may have once it is mended
_MEDIAN, _QUARTILE = special.ndtri([0.75, 0.875])  # of the modulus of a standard normal variable


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
    new course, which those on one side of it continue. Of rows at the same place each is laid beside its neighbours
    elsewhere, one after the other.

    Args:
        place: (n,) monotonic abscissa.
        values: (n,) real or complex.
        noise: standard deviation of each real reading; zero takes the usual misfit alone.
    """
    found: dict[int, float] = {}
    for rows in _one_at_each(place):
        for row, sigmas in _lone_apart(place[rows], values[rows], noise):
            found[int(rows[row])] = max(sigmas, found.get(int(rows[row]), 0.0))
    return sorted(found.items())


def _one_at_each(place: np.ndarray) -> list[np.ndarray]:
    """Choices of rows with one at each place: the first there, the second, and so on, until each was chosen."""
    first = np.flatnonzero(np.diff(place, prepend=np.nan) != 0)
    last = np.append(first[1:], len(place)) - 1
    return [np.minimum(first + number, last) for number in range(int(np.max(last - first, initial=-1)) + 1)]


def _lone_apart(place: np.ndarray, values: np.ndarray, noise: float) -> list[tuple[int, float]]:
    """Those of rows at places that are all different."""
    misfit, scale, high = _misfit(place, values, noise)
    high &= misfit >= _AS_FAR * np.max(sliding_window_view(np.pad(misfit, 2), 5), axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        sigmas = misfit / scale
    rows = [
        int(row)
        for row in np.flatnonzero(high)
        if _mends(place, values, row, misfit[row]) and not _continues(place, values, row, misfit[row])
    ]
    return [
        (row, float(sigmas[row]))
        for row in rows
        if not any(misfit[other] > misfit[row] for other in rows if abs(other - row) <= 2)
    ]


def _misfit(place: np.ndarray, values: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) distance from the cubic, what counts as a standard deviation, and which rows are far; none of few rows."""
    if len(values) < 9:
        return np.zeros(len(values)), np.zeros(len(values)), np.zeros(len(values), bool)
    misfit = np.abs(interpolation_misfit(place, values))
    scale = np.maximum(noise, _usual(misfit))
    return misfit, scale, misfit > _SIGMAS * np.maximum(scale, 1e-12 * float(np.max(np.abs(values))))


def excursions(place: np.ndarray, values: np.ndarray, noise: float) -> np.ndarray:
    """Rows that lie as far off their neighbours as those of `lone_rows`, alone or not, as a few rows of a resonance do.

    Args:
        place, values, noise: as there.
    """
    far = [rows[_misfit(place[rows], values[rows], noise)[2]] for rows in _one_at_each(place)]
    return np.unique(np.concatenate([*far, np.zeros(0, int)]))


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


def lone_residuals(residual: np.ndarray, size: np.ndarray) -> list[tuple[int, int, float]]:
    """Rows of which a fit leaves more than noise does: (row, column, standard deviations), none beside another.

    Each is laid beside the parabola through its twelve neighbours, so that a misfit that is smooth from row to row
    names nobody. A standard deviation is that of all rows, or of those around where it is larger,
    from medians and quartiles, which a wrong row does not move. Of records of normal noise without a wrong row, at most
    one in a thousand has a row that is named; it counts as such whether the noise is the same in all rows or goes with
    the reading.

    Args:
        residual: (n, k) what the fit leaves of each reading, in order of the rows, over its standard deviation.
        size: (n, k) what turns a residual with the noise the same in all rows into one with the noise in proportion to
            the reading, or the reverse.
    """
    rows, columns = residual.shape
    if rows <= _NEAR + _AROUND:
        return []
    apart = np.abs(_apart(residual))
    excess = np.minimum(_excess(apart), _excess(apart * size))
    limit = -special.stdtrit(_FREEDOM * rows, LEVEL / (2 * rows * columns))
    worst = np.max(excess, axis=1)
    lone = (worst > limit) & (worst == np.max(sliding_window_view(np.pad(worst, 2), 5), axis=1))
    found = [(int(row), int(np.argmax(excess[row])), float(worst[row])) for row in np.flatnonzero(lone)]
    return [(row, column, far) for row, column, far in found if _stands_alone(residual[:, column], row)]


def _excess(apart: np.ndarray) -> np.ndarray:
    """(n, k) moduli over their usual value, that of all rows or that around where it is larger."""
    whole = np.median(apart, axis=0) / _MEDIAN
    reach = _NEAR + _AROUND
    around = sliding_window_view(np.pad(apart, ((reach, reach), (0, 0)), mode="reflect"), 2 * reach + 1, axis=0)
    others = np.r_[0:_AROUND, 2 * reach + 1 - _AROUND : 2 * reach + 1]  # without those that the row itself moves
    usual = np.maximum(whole, np.quantile(around[..., others], 0.75, axis=-1) / _QUARTILE)
    return apart / np.maximum(usual, np.finfo(float).tiny)


def _apart(residual: np.ndarray) -> np.ndarray:
    """(n, k) difference of each row from the parabola through twelve neighbours, with variance 1 for white noise."""
    rows = len(residual)
    width = min(2 * _NEAR + 1, rows)
    first = np.clip(np.arange(rows) - _NEAR, 0, rows - width)
    apart = np.empty_like(residual)
    for begin in np.unique(np.arange(rows) - first):  # place of the row within its window: the same but at the ends
        chosen = np.arange(rows) - first == begin
        offsets = np.delete(np.arange(width) - begin, begin)
        powers = np.vander(offsets, 3 if begin == _NEAR else 2)  # at an end a line, which a neighbour turns less
        curve = np.insert(np.linalg.pinv(powers)[-1], begin, -1.0)
        windows = sliding_window_view(residual, width, axis=0)[first[chosen]]
        apart[chosen] = -windows @ curve / np.linalg.norm(curve)
    return apart


def _stands_alone(residual: np.ndarray, row: int) -> bool:
    """Whether the rows around agree once this one is what they say: else it is the curve that bends there."""
    first, last = max(row - _NEAR, 0), min(row + _NEAR + 1, len(residual))
    piece, at = residual[first:last].copy(), row - first
    others = np.delete(np.arange(len(piece)), at)
    piece[at] = np.interp(at, others, piece[others])
    before, after = _apart(residual[first:last, None])[at, 0], _apart(piece[:, None])[:, 0]
    return bool(np.max(np.abs(after)) < _AGREE * abs(before))
