"""Quantiles of more numbers than are kept."""

import numpy as np
from jaxtyping import Float

from .merit import Percentiles, percentiles, percentiles_of


EXACT = 65536  # sizes that are kept as they are
_DROPPED = 40  # of the 52 digits of a number: what is left tells it to one part in 8192


class Sketch:
    """Sizes of numbers, for quantiles: `EXACT` of them as they are, beyond that counts in bins.

    A bin holds the numbers that agree in all but their last 40 binary digits. Its middle is within 1 part in 8192 of
    each of them, which is the error of a quantile; how many lie below a bin is counted exactly. The counts of two
    sketches add up, in any order to the same.
    """

    def __init__(self) -> None:
        self._kept: list[np.ndarray] = []
        self._bins, self._counts = np.empty(0, np.uint64), np.empty(0, np.int64)
        self._waiting, self.count, self.squares = 0, 0, 0.0

    def add(self, numbers: Float[np.ndarray, " n"]) -> None:
        """Take numbers in; what is none is left out, and infinity counts as the largest."""
        size = np.abs(numbers[~np.isnan(numbers)])
        self._kept.append(size)
        self.count, self._waiting = self.count + size.size, self._waiting + size.size
        with np.errstate(over="ignore"):  # infinity is what it then is
            self.squares += float(np.sum(size**2))
        if self._waiting > EXACT:
            self._bin()

    def quantile(self, *shares: float) -> list[float]:
        """Each the least size that so large a share of the numbers does not exceed; exact ones are interpolated."""
        if self.count == 0:
            return [float("nan")] * len(shares)
        if not self._bins.size:
            return [_interpolated(np.sort(self._sizes()), share) for share in shares]
        self._bin()
        ranks = np.clip(np.ceil(np.asarray(shares) * self.count), 1, self.count)
        found = self._bins[np.searchsorted(np.cumsum(self._counts), ranks)]
        low, high = ((found + np.uint64(k) << np.uint64(_DROPPED)).view(np.float64) for k in (0, 1))
        finite = np.isfinite(high)
        return [float(value) for value in np.where(finite, 0.5 * (low + np.where(finite, high, low)), low)]

    @property
    def rms(self) -> float:
        """Root mean square, exactly."""
        return float(np.sqrt(self.squares / self.count)) if self.count else float("nan")

    @property
    def percentiles(self) -> Percentiles:
        """What is printed of errors."""
        return percentiles_of(self.rms, self.count, self.quantile) if self._bins.size else percentiles(self._sizes())

    def _sizes(self) -> np.ndarray:
        return np.concatenate([*self._kept, np.empty(0)])

    def _bin(self) -> None:
        found = self._sizes().view(np.uint64) >> np.uint64(_DROPPED)
        self._bins, place = np.unique(np.concatenate([self._bins, found]), return_inverse=True)
        counts = np.concatenate([self._counts, np.ones(found.size, np.int64)])
        self._counts = np.bincount(place, counts).astype(np.int64)
        self._kept, self._waiting = [], 0


def _interpolated(ordered: Float[np.ndarray, " n"], share: float) -> float:
    """As `numpy.quantile`, which does not bear infinite numbers."""
    place = share * (len(ordered) - 1)
    low, high = ordered[int(place)], ordered[int(np.ceil(place))]
    return float(low if high == low else low + (place - int(place)) * (high - low))
