"""White noise of the channels of a record: one for all where they are alike, else each its own."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import special


_BY_CHANCE = 1e-3  # that two channels of the same noise are told apart
_APART = 1.1  # times the noise of the other: estimates beside a signal are not better than that


class ToldNoise(NamedTuple):
    """Noise as the rows of a record tell it.

    Args:
        level: standard deviation of each real reading, root mean square over the channels where they differ; `None`
            where rows do not tell.
        freedom: degrees of freedom of it, of the channel that is known least where they differ.
        levels: of each recorded channel, where they differ by more than chance; empty where one holds for all.
    """

    level: float | None
    freedom: float
    levels: tuple[float, ...] = ()


def told_by_channels(
    told_by: Callable[[Sequence[int]], tuple[float | None, float]], channels: Sequence[int], each: bool = True
) -> ToldNoise:
    """Noise of some channels, of which `told_by` tells the noise of any as if it were one, and its degrees of freedom;
    one for all where not `each` tells its own.

    Squares of two estimates of the same noise have Fisher's distribution. Where that leaves them alike they are one
    noise, which all channels tell together.
    """
    together = ToldNoise(*told_by(channels))
    if len(channels) < 2 or not together.level or not each:
        return together
    alone = [told_by([channel]) for channel in channels]
    levels = tuple(level for level, _ in alone if level)
    if len(levels) < len(channels) or not np.isfinite(levels).all():
        return together
    low, high = min(alone, key=lambda one: one[0] or 0.0), max(alone, key=lambda one: one[0] or 0.0)
    ratio = float(max(levels) / min(levels))
    if ratio < _APART or 2.0 * special.fdtrc(high[1], low[1], ratio**2) > _BY_CHANCE:
        return together
    return ToldNoise(float(np.sqrt(np.mean(np.square(levels)))), min(freedom for _, freedom in alone), levels)


def spoken_levels(record: Any, unit: str) -> str:
    """The estimated noise of each channel of a record, with a unit; empty where one holds for all."""
    told = zip(record.channels, record.told_noise.levels, strict=False)
    return ", ".join(f"{'xy'[channel]} {level:.2g}{unit}" for channel, level in told)
