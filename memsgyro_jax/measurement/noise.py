"""How much white noise a record has, told by its rows alone: of responses, of signals, of what a fit leaves."""

from collections.abc import Sequence

import numpy as np
from scipy import special

from .outliers import interpolation_misfit


WINDOW = 11  # neighbouring rows that a local model explains
FEWEST = 7  # rows below which it would explain anything
ROUNDS = 3  # of weighting with the denominator found before
PARTS, PLAIN = 5, 3  # complex coefficients of the local model, and of its numerator alone
# Degrees of freedom per row and channel, as found by simulation: of local models (without 6 rows a piece), of waveforms
# and of phasors in time, and of the scatter among repeats per row that is one too many.
_LOCAL, _WAVE, _PHASOR, _REPEATED = (0.75, 6), 0.15, 0.5, 1.2
_SURE = 1e-3  # chance of a jitter where there is none
_BENT = 3e-3  # chance that a window of which a parabola leaves noise alone asks for a denominator
_RUN = 24  # rows over which a vibration keeps its frequency
_BAND = 64  # spectral lines at least in a band
_BANDS = 16  # at most
_QUIET = 0.2  # share of the bands that no signal reaches
_NORMAL = 1.4826  # median absolute value to standard deviation, of a normal variable
RAYLEIGH = 1.1774  # median of the modulus of a complex normal variable over the standard deviation of each part


def noise_over_frequency(
    frequency: np.ndarray, phasors: np.ndarray, pieces: Sequence[slice], repeats: Sequence[np.ndarray] = ()
) -> float | None:
    """Standard deviation of each real part of phasors (n, channels), or of real amplitudes, over a frequency (n,);
    `None` for few rows.

    Around every row a ratio of two quadratics in frequency is fitted to 11 rows and leaves noise alone: a resonance and
    what is smooth beside it are such a ratio (local rational method: McKelvey and Guérin, IFAC Proc. 45-16 (2012) 49),
    and so are the squares of amplitudes alone, while plain differences take a resonance of a few rows for noise. Away
    from a resonance a parabola does as well, and there it is taken, since a ratio finds a pole of its own beside some
    row of noise. The median over all rows does not mind a jump. Where frequencies are repeated, it is the scatter among
    their rows instead, which needs no model: among those of each of `repeats`, rows that ought to lie on one curve.
    """
    scatter = [_scatter(frequency[rows], phasors[rows]) for rows in repeats]
    levels = [level for level in scatter if level is not None]
    for piece in () if levels else pieces:
        width = min(WINDOW, piece.stop - piece.start)
        if width >= FEWEST:
            levels.append(_local_levels(frequency[piece], *_ratio(phasors[piece]), width).ravel())
    return float(np.sqrt(np.median(np.concatenate(levels)))) if levels else None


def told_over_frequency(
    frequency: np.ndarray, phasors: np.ndarray, pieces: Sequence[slice], repeats: Sequence[np.ndarray] = ()
) -> tuple[float | None, float]:
    """`noise_over_frequency` and `freedom_over_frequency`."""
    seen = frequency, phasors, pieces, repeats
    return noise_over_frequency(*seen), freedom_over_frequency(*seen)


def freedom_over_frequency(
    frequency: np.ndarray, phasors: np.ndarray, pieces: Sequence[slice], repeats: Sequence[np.ndarray] = ()
) -> float:
    """Degrees of freedom of `noise_over_frequency`: its square scatters like that of so many normal numbers."""
    numbers = phasors.shape[1] * _parts(phasors) / 2
    spare = [_spare(frequency[rows]) for rows in repeats]
    if any(spare):
        return _REPEATED * numbers * sum(spare)
    share, lost = _LOCAL
    rows = [piece.stop - piece.start for piece in pieces]
    return max(1.0, share * numbers * sum(count - lost for count in rows if count >= FEWEST))


def _parts(values: np.ndarray) -> int:
    """How many real numbers a reading has: two of a phasor, one of an amplitude."""
    return 2 if np.iscomplexobj(values) else 1


def _spare(place: np.ndarray) -> int:
    """Rows of frequencies that were read before; zero where these are hardly any."""
    spare = len(place) - len(np.unique(place))
    return spare if spare >= max(FEWEST, len(place) // 4) else 0


def jitter_noise(frequency: np.ndarray, phasors: np.ndarray, repeats: Sequence[np.ndarray]) -> np.ndarray | None:
    """Standard deviation (n, channels) that a jitter of the frequency adds to each real part; `None` where none shows.

    It grows with the slope of the response, along which alone it acts. It shows where repeated rows on the steepest
    quarter scatter more than those on the flatter half, and chance would make it so in one of a thousand records.
    """
    curves = [(rows, *_curve(frequency[rows], phasors[rows])) for rows in repeats if _spare(frequency[rows])]
    if not curves:
        return None
    sums, freedom, steep = (np.concatenate([one[k].ravel() for one in curves]) for k in (2, 3, 4))
    flat, most = steep <= np.quantile(steep, 0.5), steep >= np.quantile(steep, 0.75)
    white = sums[flat].sum() / freedom[flat].sum()
    over = sums[most].sum() / freedom[most].sum() / white
    if special.fdtrc(freedom[most].sum(), freedom[flat].sum(), over) > _SURE:
        return None
    # Of the parts of a reading, which scatter alike, one along the slope takes all of it.
    square = _parts(phasors) * (over - 1.0) * white * freedom[most].sum() / (freedom[most] @ steep[most] ** 2)
    out = np.zeros(phasors.shape)
    for rows, group, _, _, slope in curves:
        out[rows] = np.sqrt(square) * slope[group]
    return out


def _curve(place: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The number of each row's frequency, and per frequency and channel: squares about the mean of the repeats, their
    degrees of freedom, and the modulus of the slope.
    """
    known, group, count = np.unique(place, return_inverse=True, return_counts=True)
    each = (np.arange(known.size)[:, None] == group).astype(float)
    mean = each @ values / count[:, None]
    squares = each @ np.abs(values - mean[group]) ** 2
    freedom = np.repeat(float(_parts(values)) * (count - 1)[:, None], values.shape[1], axis=1)
    return group, squares, freedom, np.abs(np.gradient(mean, known, axis=0))


def _scatter(place: np.ndarray, values: np.ndarray) -> np.ndarray | None:
    """Squared standard deviation of each real part among rows of the same frequency, over its median for that many;
    `None` where hardly any frequency is repeated.
    """
    if not _spare(place):
        return None
    _, group, count = np.unique(place, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(group, part) for part in (*values.real.T, *values.imag.T)], axis=1) / count[:, None]
    off = np.abs(values - (means[:, : values.shape[1]] + 1j * means[:, values.shape[1] :])[group]) ** 2
    sums = np.stack([np.bincount(group, part) for part in off.T], axis=1)[count > 1]
    return (sums / special.chdtri(_parts(values) * (count[count > 1] - 1), 0.5)[:, None]).ravel()


def _ratio(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What of phasors, or of amplitudes, is a ratio of quadratics over frequency, and its noise for a noise of 1."""
    if np.iscomplexobj(values):
        return values, np.ones(values.shape)
    return values**2, 2.0 * np.maximum(np.abs(values), 1e-9 * np.max(np.abs(values), initial=1e-300))


def _local_levels(place: np.ndarray, values: np.ndarray, noise: np.ndarray, width: int) -> np.ndarray:
    """Squares that the local model leaves in every window (windows, channels), over their median for a noise of 1,
    where the noise (n, channels) is known but for its size: of a parabola where that leaves no more than by chance,
    else of the ratio.
    """
    rows = np.arange(len(place) - width + 1)[:, None] + np.arange(width)
    near = place[rows] - place[rows].mean(axis=1, keepdims=True)
    near = near / np.max(np.abs(near), axis=1, keepdims=True)
    powers = np.stack([near**0, near, near**2], axis=-1)[:, None]  # (windows, 1, width, 3)
    seen, usual = (
        np.moveaxis(part[rows], -1, 1)[..., None] for part in (values, noise)
    )  # (windows, channels, width, 1)
    parabola, ratio = _squares_left(powers, seen, usual), _of_ratio(powers, seen, usual)
    parts = _parts(values)
    more, spare, free = parts * (PARTS - PLAIN), parts * (width - PARTS), parts * (width - PLAIN)
    straight = (parabola - ratio) / more <= special.fdtri(more, spare, 1.0 - _BENT) * ratio / spare
    return np.where(straight, parabola / special.chdtri(free, 0.5), ratio / special.chdtri(spare, 0.5))


def _of_ratio(powers: np.ndarray, seen: np.ndarray, usual: np.ndarray) -> np.ndarray:
    """Squares that a ratio of quadratics leaves in every window, its denominator found in rounds."""
    columns = np.concatenate([powers + 0 * seen, -seen * powers[..., 1:]], axis=-1)
    denominator = np.ones_like(seen)
    for _ in range(ROUNDS):
        weight = denominator * usual
        found = np.linalg.pinv(columns / weight, rcond=1e-12) @ (seen / weight)
        denominator = 1 + powers[..., 1:] @ found[..., 3:, :]
    left = (columns @ found - seen) / (denominator * usual)
    return np.sum(np.abs(left[..., 0]) ** 2, axis=-1)


def _squares_left(columns: np.ndarray, seen: np.ndarray, usual: np.ndarray) -> np.ndarray:
    """Squares that least squares by `columns` leave in every window."""
    columns, seen = columns / usual, seen / usual
    left = seen - columns @ (np.linalg.pinv(columns, rcond=1e-12) @ seen)
    return np.sum(np.abs(left[..., 0]) ** 2, axis=-1)


def noise_beside_tone(time: np.ndarray, values: np.ndarray, omega: float | np.ndarray) -> float:
    """Standard deviation of each real reading of waveforms (n, channels), or of phasors, at times (n,) [s] that vibrate
    at about ω [rad/s], of each row (n,) where it changes, for phasors beside their reference.

    In every run of 24 rows a constant and a tone whose two amplitudes are quadratic in time explain the wave; infinite
    where there are fewer rows. It needs no even clock, and no long record beside a large wave.
    """
    runs = len(time) // _RUN
    if runs == 0:
        return float("inf")
    t, at = (np.broadcast_to(v, time.shape)[: runs * _RUN].reshape(runs, _RUN) for v in (time, omega))
    seen = values[: runs * _RUN].reshape(runs, _RUN, -1)
    away = t - t.mean(axis=1, keepdims=True)
    near = away / np.max(np.abs(away), axis=1, keepdims=True)
    waves = np.exp(1j * at.mean(axis=1, keepdims=True) * away)
    real = not np.iscomplexobj(values)
    parts = (waves.real, waves.imag) if real else (waves,)
    columns = [*([np.ones_like(near)] if real else []), *(part * near**k for k in range(3) for part in parts)]
    basis = np.stack(columns, axis=-1)
    left = seen - basis @ (np.linalg.pinv(basis) @ seen)
    freedom = (_RUN - basis.shape[-1]) * (1 if real else 2)
    return float(np.sqrt(np.median(np.sum(np.abs(left) ** 2, axis=1)) / special.chdtri(freedom, 0.5)))


def noise_over_time(values: np.ndarray) -> float:
    """Standard deviation of each real reading of evenly spaced signals or phasors (n, channels).

    Signals only add to what the quiet part of the spectrum and the misfit of neighbours show: the lesser is believed.
    """
    misfit = interpolation_misfit(np.arange(len(values), dtype=float), values)[2:-2]
    near = np.median(np.abs(misfit), axis=0) if len(misfit) else np.full(values.shape[1], np.inf)
    near = near / RAYLEIGH if np.iscomplexobj(misfit) else near * _NORMAL
    return float(np.median(np.minimum(near, [_quiet_level(channel) for channel in values.T])))


def freedom_over_time(values: np.ndarray) -> float:
    """Degrees of freedom of `noise_over_time`."""
    return (_PHASOR if np.iscomplexobj(values) else _WAVE) * values.size


def _quiet_level(channel: np.ndarray) -> float:
    """White noise below a signal that leaves part of the spectrum free: the level of the quiet bands."""
    rows = len(channel)
    window = np.hanning(rows + 2)[1:-1]
    values = (channel - channel.mean()) * window
    spectrum = np.fft.fft(values) if np.iscomplexobj(channel) else np.fft.rfft(values)
    power = np.abs(spectrum) ** 2 / np.sum(window**2)
    bands = np.array_split(power, max(1, min(_BANDS, len(power) // _BAND)))
    # The median of m exponential variables scatters by 1/√m over its mean times ln 2, and a low quantile lies below.
    scatter = 1.0 / np.log(2) / np.sqrt(len(power) / len(bands))
    levels = np.array([np.median(band) / np.log(2) for band in bands])
    level = np.quantile(levels, _QUIET) / (1 + special.ndtri(_QUIET) * scatter * (len(bands) > 1))
    quiet_bands = [band for band, at in zip(bands, levels, strict=True) if at <= level * (1 + 3 * scatter)]
    quiet = float(np.sqrt(np.median(np.concatenate(quiet_bands)) / np.log(2)))
    return quiet / np.sqrt(2) if np.iscomplexobj(channel) else quiet


def noise_beside_misfit(residual: np.ndarray) -> np.ndarray:
    """Standard deviation of each part of a fit's residual (n, ...), blind to a misfit that is smooth from row to row.

    Second differences, root mean square: right for noise of any distribution.
    """
    bend = residual[1:-1] - 0.5 * (residual[:-2] + residual[2:])
    return np.sqrt(np.mean(bend**2, axis=0) / 1.5)
