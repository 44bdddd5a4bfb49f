"""What a sequence of plateaus can tell apart: columns of the response to the rate and of what else moves the output."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .plateau_noise import Means
from .rate_plateaus import RatePlateaus, levels


_REPEATED = 6  # plateaus beyond the rates, from which on each rate has a mean of its own
_DEGREE = 3  # of the response otherwise
_APART = 0.1  # share of a column that no other explains, from which on it is told apart
_SPARE = 3  # plateaus that must stay beyond the columns
_BOTH = 0.5  # share of rates that must be approached from both sides
_WARM = 0.5  # K between the coldest and the warmest plateau, below which temperature is none

TEMPERATURE, TEMPERATURE_RATE, TREND, DIRECTION = "temperature", "temperature, rate", "trend", "direction"
RUN, RUN_RATE = "run", "run, rate"


class Design(NamedTuple):
    """Plateaus as they are fitted.

    Args:
        means: output and columns.
        names: of the columns beside, in their order.
        left: those that the sequence does not tell apart from others.
        place: rate over the greatest, (n,); plateaus of one rate have the same.
        level: which rate each plateau has, (n,).
        since: time from the middle of the test over its length, (n,).
    """

    means: Means
    names: tuple[str, ...]
    left: tuple[str, ...]
    place: Float[np.ndarray, " n"]
    level: np.ndarray
    since: Float[np.ndarray, " n"]

    @property
    def by_temperature(self) -> bool:
        """Whether it is the temperature that a drift over time is not told apart from."""
        return TREND in self.left and TEMPERATURE in self.names and tells_apart(self.means.shape, self.since)


def design_of(read: RatePlateaus, *, with_trend: bool | None = None, with_runs: bool = True) -> Design:
    """The columns that the sequence tells apart; with `with_trend` a straight drift even where a bent one is not."""
    rates, level = levels(read.rate)
    full = float(np.max(np.abs(read.rate)))
    place = rates[level] / full
    slope = np.polyfit(read.rate, read.output, 1)[0]
    output = read.output - slope * (read.rate - rates[level])
    shape = _shape(place, level)
    span = max(float(np.ptp(read.time)), np.finfo(float).tiny)
    since = (read.time - np.mean(read.time)) / span
    names: list[str] = []
    left: list[str] = []
    columns: list[np.ndarray] = []

    def add(name: str, column: np.ndarray) -> None:
        told = tells_apart(np.column_stack([shape, *columns]), column)
        (columns if told else []).append(column - column.mean())
        (names if told else left).append(name)

    if read.temperature is not None and np.ptp(read.temperature) >= _WARM:
        warm = (read.temperature - np.mean(read.temperature)) / np.ptp(read.temperature)
        add(TEMPERATURE, warm)
        add(TEMPERATURE_RATE, warm * place)
    for number in range(1, read.run.max() + 1 if with_runs else 1):
        here = (read.run == number).astype(float) - np.mean(read.run == number)
        add(RUN, here)
        add(RUN_RATE, here * place)
    bent = tells_apart(np.column_stack([shape, *columns, since]), since**2)
    if with_trend or (with_trend is None and bent):
        add(TREND, since)
    else:
        left.append(TREND)
    if both_ways(read, level, rates):
        add(DIRECTION, 0.5 * read.direction)
    beside = np.column_stack(columns) if columns else np.zeros((len(place), 0))
    means = Means(output, shape, beside, read.within, _walk(read, span))
    return Design(means, tuple(names), tuple(left), place, level, since)


def both_ways(read: RatePlateaus, level: np.ndarray, rates: np.ndarray) -> bool:
    """Whether most rates but zero are approached from below and from above: else what differs by direction differs by
    the sign of the rate, and one would be paid for with the other.
    """
    turned = np.flatnonzero(rates)
    seen = [{*read.direction[level == number]} >= {-1, 1} for number in turned]
    return bool(np.mean(seen) > _BOTH)


def tells_apart(columns: np.ndarray, column: np.ndarray) -> bool:
    """Whether enough of a column is left by the others, and plateaus are left beyond them."""
    centred = column - np.mean(column)
    rest = centred - columns @ np.linalg.lstsq(columns, centred, rcond=None)[0]
    spare = len(column) - np.linalg.matrix_rank(columns) - 1
    return bool(spare >= _SPARE and rest @ rest > _APART * (centred @ centred) > 0.0)


def _shape(place: np.ndarray, level: np.ndarray) -> np.ndarray:
    """A mean for each rate where rates are repeated, or else a polynomial that leaves some plateaus over."""
    count, rates = len(place), int(level.max()) + 1
    if count - rates >= _REPEATED:
        return (level[:, None] == np.arange(rates)).astype(float)
    degree = min(_DEGREE, rates - 1)
    while degree > 1 and count - degree - 1 < 2:
        degree -= 1
    return np.vander(place, degree + 1, increasing=True)


def _walk(read: RatePlateaus, span: float) -> np.ndarray:
    """Covariance of a random walk that begins anew with each run."""
    begun = np.array([read.time[read.run == number].min() for number in read.run])
    since = (read.time - begun) / span
    return np.where(read.run[:, None] == read.run, np.minimum(since[:, None], since), 0.0)
