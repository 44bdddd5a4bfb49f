"""Where a model fails, as statistical tests on whitened residuals.

If model and noise are right, every whitened residual is an independent standard normal number. Three kinds of test ask
for it, each exact or nearly so for any number of rows:

- **variance**: Σr² of a part of a record (a drive level, a band, a segment of time) against χ²;
- **whiteness**: correlation of neighbouring rows within each sweep or record (Ljung and Box, Biometrika 65 (1978) 297);
- **dependence**: whether the mean of the residual differs between bins of a variable (one-way analysis of variance).

The last two do not depend on the level of the noise. A comparison makes hundreds of tests; Holm's procedure (Scand. J.
Stat. 6 (1979) 65) keeps the probability of any false alarm among all of them below the stated level.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import special

from memsgyro_jax.measurement.experiments.deviation import Band, Series


LEVEL = 0.01  # probability that a comparison of a perfect model raises any alarm
LAGS, PER_LAG, FEWEST_LAGS = 10, 5, 3  # rows over which whiteness is judged; readings that each needs; at least
BINS = 8  # of a variable, with about as many rows in each
FEW = 6  # rows below which a part is not judged on its own
Kind = Literal["variance", "whiteness", "dependence"]


@dataclass(frozen=True)
class Check:
    """One test of a comparison.

    Args:
        record: name of the record.
        channel: name of the channel.
        kind: of test.
        heading: what was looked at, e.g. "drive", "displacement"; empty for the record as a whole.
        label: value of it, e.g. "150 nN"; empty where the heading says all.
        statistic: χ²/N, Ljung and Box's Q, or F.
        count: real readings in it.
        p_value: probability of a statistic as large from noise alone.
        threshold: the p-value below which it counts as failed, Holm's, given all other tests.
    """

    record: str
    channel: str
    kind: Kind
    heading: str
    label: str
    statistic: float
    count: int
    p_value: float
    threshold: float = 0.0

    @property
    def failed(self) -> bool:
        """Whether noise alone is ruled out."""
        return self.p_value <= self.threshold

    @property
    def name(self) -> str:
        """What was tested, for people."""
        return " ".join(word for word in (self.kind, self.heading, self.label) if word)


def check_all(series: Sequence[Series], level: float = LEVEL) -> tuple[Check, ...]:
    """Every test of every record; with probability 1 − `level` none fails where the model is right."""
    checks = [check for one in series for check in _checks(one)]
    thresholds = holm(np.array([check.p_value for check in checks]), level)
    return tuple(replace(check, threshold=float(t)) for check, t in zip(checks, thresholds, strict=True))


def holm(p_values: np.ndarray, level: float) -> np.ndarray:
    """Threshold of each p-value (n,): level/n for the smallest, level/(n − 1) for the next, up to the first that is not
    met; from there on no test can fail, and the threshold is that first one's if it is below the p-value.
    """
    order = np.argsort(p_values, kind="stable")
    steps = level / np.arange(len(order), 0, -1)
    unmet = np.flatnonzero(p_values[order] > steps)
    if unmet.size:
        steps[unmet[0] :] = steps[unmet[0]]
    out = np.empty(len(order))
    out[order] = steps
    return out


def _checks(series: Series) -> Iterator[Check]:
    for number, channel in enumerate(series.channels):
        white, turned = series.white[:, number], series.turned[:, number]

        def made(kind: Kind, heading: str, label: str, found: tuple[float, int, float], channel=channel) -> Check:
            return Check(series.record, channel, kind, heading, label, *found)

        yield made("variance", "", "", variance(white))
        for part in series.parts:
            if np.isfinite(white[part.rows]).sum() >= FEW:
                yield made("variance", part.heading, part.label, variance(white[part.rows]))
        for band in series.bands:
            yield from (made("variance", "frequency", band.label, f) for f in in_band(white[:, 0], band))
        yield from (made("whiteness", "", "", f) for f in whiteness(white, series.pieces))
        for variable in series.variables:
            yield from (made("dependence", variable.name, "", f) for f in dependence(turned, variable.values))


def variance(white: np.ndarray) -> tuple[float, int, float]:
    """χ²/N of all numbers that are compared, how many, and the probability of more from noise alone."""
    values = white[np.isfinite(white)]
    chi2 = float(values @ values)
    return chi2 / values.size, values.size, float(special.chdtrc(values.size, chi2))


def in_band(white: np.ndarray, band: Band) -> list[tuple[float, int, float]]:
    """χ²/N of the spectral lines of (n,) within a band: a weak tone stands out there long before it does in time."""
    values = white[np.isfinite(white)]
    lines = np.arange(1, (values.size - 1) // 2 + 1)  # without mean and Nyquist, which are one number, not two
    inside = lines[(lines > band.low * values.size) & (lines < band.high * values.size)]
    if inside.size < FEW:
        return []
    # Normalised to unit variance of every real and imaginary part.
    power = 2.0 / values.size * np.abs(np.fft.rfft(values)[inside]) ** 2
    count, chi2 = 2 * inside.size, float(power.sum())
    return [(chi2 / count, count, float(special.chdtrc(count, chi2)))]


def whiteness(white: np.ndarray, pieces: Sequence[slice], lags: int = LAGS) -> list[tuple[float, int, float]]:
    """Q of (n, parts), correlations pooled over pieces and parts; their variance is exact for normal numbers."""
    runs = [run for piece in pieces for part in white[piece].T if (run := part[np.isfinite(part)]).size]
    total = sum(run.size for run in runs)
    square = sum(float(run @ run) for run in runs)
    lags = min(lags, total // PER_LAG)
    q, used = 0.0, 0
    for lag in range(1, lags + 1):
        pairs = sum(max(run.size - lag, 0) for run in runs)
        if pairs < 0.5 * total:  # short sweeps: what few pairs are left is far from normal
            break
        product = sum(float(run[lag:] @ run[:-lag]) for run in runs)
        q += (product / square) ** 2 * total * (total + 2) / pairs if square > 0 else 0.0
        used += 1
    return [(q, total, float(special.chdtrc(used, q)))] if used >= FEWEST_LAGS else []


def dependence(values: np.ndarray, variable: np.ndarray, bins: int = BINS) -> list[tuple[float, int, float]]:
    """F of (n, parts) between bins of a variable (n,); empty where the variable does not vary."""
    compared = np.isfinite(values).all(axis=1) & np.isfinite(variable)
    values, place = values[compared], _binned(variable[compared], bins)
    sizes = np.bincount(place)
    if sizes.size < 2 or sizes.min() < 2 or len(values) < 4 * sizes.size:
        return []
    sums = np.stack([np.bincount(place, weights=part) for part in values.T], axis=1)
    within = float(np.sum(values**2) - np.sum(sums**2 / sizes[:, None]))
    between = float(np.sum(sums**2 / sizes[:, None]) - np.sum(values.sum(axis=0) ** 2) / len(values))
    parts = values.shape[1]
    free, left = parts * (sizes.size - 1), parts * (len(values) - sizes.size)
    if within <= 0:
        return []
    f = max(between, 0.0) / free / (within / left)
    return [(f, values.size, float(special.fdtrc(free, left, f)))]


def _binned(variable: np.ndarray, bins: int) -> np.ndarray:
    """Number of the bin of each value: one per setting where there are few, else quantiles."""
    if variable.size == 0 or np.ptp(variable) <= 1e-9 * np.max(np.abs(variable)):
        return np.zeros(variable.size, int)
    settings, place = np.unique(variable, return_inverse=True)
    if settings.size > 2 * bins:
        edges = np.unique(np.quantile(variable, np.linspace(0, 1, bins + 1)[1:-1]))
        place = np.unique(np.searchsorted(edges, variable, side="right"), return_inverse=True)[1]
    return place
