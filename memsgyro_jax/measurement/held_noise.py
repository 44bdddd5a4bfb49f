"""How much white noise a record has whose device is turned in steps, told by the rows while the setting is held."""

import numpy as np
from scipy import special

from .noise import freedom_over_time, noise_over_time


_RUN = 64  # rows at least into which a long stretch is divided, and at most that are left to its transient
_FEWEST = 12  # rows of a stretch below which a model would explain anything
_AWAY = 0.25  # of a stretch whose transient is largest: it is left out
_MODES = 2  # transients that die out side by side
_ROUNDS = 4  # of weighting with the transients found before
_BENT = 3e-3  # chance that a run of which a parabola leaves noise alone asks for transients
_MEDIAN = 0.6  # degrees of freedom of a median over runs per one of theirs, as found by simulation
_APART = 3.0  # standard deviations beyond which two estimates disagree


def noise_beside_steps(values: np.ndarray, setting: np.ndarray, place: np.ndarray) -> tuple[float, float]:
    """Standard deviation of each real part of phasors (n, channels) under a setting (n,), and its degrees of freedom.

    While the setting is held, what it left behind dies out as modes of one common frequency and decay each in all
    channels, about a constant; after a step these may ring at any frequency, so neither neighbouring rows nor quiet
    parts of a spectrum tell the noise beside them. Where the setting hardly stands still, or all rows together show
    less noise, as they do of neighbours that a low pass has made alike, the estimate over time is kept.

    Args:
        values: complex readings.
        setting: known of each row.
        place: (n,) number of each row's block; lost ones end a stretch.
    """
    whole, usual = noise_over_time(values), freedom_over_time(values)
    alike: dict[int, list[np.ndarray]] = {}  # stretches of one length are worked out together
    for rows in _stretches(setting, place) if np.ptp(setting) > 0 else []:
        alike.setdefault(rows.stop - rows.start, []).append(values[rows])
    if not alike:
        return whole, usual
    runs = [_of_runs(np.stack(stretches)) for stretches in alike.values()]
    squares, spare = (np.concatenate(part) for part in zip(*runs, strict=True))
    held, freedom = float(np.sqrt(np.median(squares))), max(1.0, _MEDIAN * float(np.sum(spare)))
    if held <= 0.0 or whole <= 0.0:
        return whole, usual
    apart = 2.0 * np.log(whole / held) / np.sqrt(2.0 / usual + 2.0 / freedom)
    return (held, freedom) if apart > (_APART if freedom < usual / 2 else -_APART) else (whole, usual)


def _stretches(setting: np.ndarray, place: np.ndarray) -> list[slice]:
    """Rows over which the setting is held, without the first of them and the last."""
    ends = np.flatnonzero((np.diff(setting) != 0) | (np.diff(place) != 1)) + 1
    found = []
    for first, last in zip([0, *ends], [*ends, len(setting)], strict=True):
        begin = first + max(2, min(int(_AWAY * (last - first)), _RUN))
        if last - 1 - begin >= _FEWEST:  # the last may see the next step already
            found.append(slice(int(begin), int(last) - 1))
    return found


def _of_runs(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squares that the local model leaves in every run of stretches (stretches, rows, channels), over their median for
    a noise of 1, and their degrees of freedom: of a parabola where that leaves no more than by chance, else of
    transients.
    """
    stretches, rows, channels = values.shape
    count = max(1, rows // _RUN)
    width = rows // count
    runs = values[:, rows - count * width :].reshape(stretches * count, width, channels)
    plain, dying = _parabola_left(runs), _transients_left(runs)
    more, free = 2 * _MODES, 2 * channels * (width - 3)
    spare = 2 * (channels * (width - 1 - _MODES) - _MODES)
    straight = (plain - dying) / more <= special.fdtri(more, spare, 1.0 - _BENT) * dying / spare
    levels = np.where(straight, plain / special.chdtri(free, 0.5), dying / special.chdtri(spare, 0.5))
    return levels, np.full(len(runs), float(spare))


def _parabola_left(runs: np.ndarray) -> np.ndarray:
    """Squares that a parabola in each channel leaves of runs (runs, rows, channels)."""
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, runs.shape[1]), 3))
    return np.sum(np.abs(runs - basis @ (basis.T @ runs)) ** 2, axis=(1, 2))


def _transients_left(runs: np.ndarray) -> np.ndarray:
    """Squares that a constant and `_MODES` transients leave, found in rounds.

    Transients obey a recursion: each row is a sum of those before. The noise that it leaves is white again where it is
    weighted by the recursion found before (iterative quadratic maximum likelihood: Bresler and Macovski, IEEE Trans.
    ASSP 34 (1986) 1081).
    """
    count, width, _ = runs.shape
    rows = width - _MODES
    lags = np.stack([runs[:, _MODES - k : width - k] for k in range(_MODES + 1)], axis=-1).reshape(count, rows, -1)
    plain = weighted = np.concatenate([lags, np.ones((count, rows, 1))], axis=-1)
    for _ in range(_ROUNDS):
        seen = _beside_constant(weighted)
        found = -np.linalg.pinv(seen[..., 1:]) @ seen[..., :1]
        recursion = np.concatenate([np.ones((count, 1, 1)), found], axis=1)
        weighted = _whitened(plain, recursion[..., 0])
    return np.sum(np.abs(_beside_constant(weighted) @ recursion) ** 2, axis=(1, 2))


def _whitened(values: np.ndarray, recursion: np.ndarray) -> np.ndarray:
    """Rows (runs, rows, columns) weighted such that what a recursion (runs, lags) makes of white noise is white again.

    That is a division by the Cholesky factor of its covariance, row by row, as only the rows within the lags meet.
    """
    order = recursion.shape[1] - 1
    covariance = [np.sum(recursion[:, k:] * np.conj(recursion[:, : order + 1 - k]), axis=1) for k in range(order + 1)]
    factor: list[list[np.ndarray]] = []  # of each row: its diagonal, then what stands 1, 2, ... left of that
    white = np.empty(values.shape, complex)
    for row in range(values.shape[1]):
        line = [np.zeros(0)] * (order + 1)
        for k in range(min(order, row), 0, -1):
            met = sum(line[m] * np.conj(factor[row - k][m - k]) for m in range(k + 1, min(order, row) + 1))
            line[k] = (covariance[k] - met) / factor[row - k][0]
        line[0] = np.sqrt(covariance[0].real - sum(np.abs(part) ** 2 for part in line[1 : min(order, row) + 1]))
        rest = values[:, row] - sum(line[k][:, None] * white[:, row - k] for k in range(1, min(order, row) + 1))
        white[:, row] = rest / line[0][:, None]
        factor.append(line)
    return white


def _beside_constant(weighted: np.ndarray) -> np.ndarray:
    """Weighted rows of a recursion (runs, rows times channels, lags), without what a constant, the last column of
    `weighted`, explains of them.
    """
    seen, one = weighted[..., :-1], weighted[..., -1:]
    one = one / np.linalg.norm(one, axis=1, keepdims=True)
    seen = seen - one @ (np.conj(np.swapaxes(one, 1, 2)) @ seen)
    return seen.reshape(len(seen), -1, _MODES + 1)
