"""Plateaus of a raw log of a rate table: where the rate stands still, and how long the output takes to follow."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


_FEWEST = 10  # samples of a plateau
_TOLERANCE = 1e-3  # of the span of rates, within which a measured rate is the same
_EXACT = 1e-5  # of the span, within which a command is
_DIGITS, _FINE = 4, 1e-4  # last digits of a command, and share of the span below which its smallest step is one
_SIGMAS = 8.0
_MOVING = 0.05  # of the span, beyond which no noise of a table is
_TRAVEL = 0.3  # of the tolerance, that the rate of a plateau may move from its first third to its last
_SHORT = 0.1  # of the usual plateau, below which one is a halt on the way
_GROWTH = 1.3  # from one bin of the step response to the next
_SETTLED = 1e-6  # of a step, to which the output is to have settled
_NOISE = 3.0  # standard deviations within which a bin of the step response is noise
MOST = 0.7  # of the shortest plateau that settling may take
BATCHES = 10


class Settling(NamedTuple):
    """How long each plateau is left out [samples], and whether the output was seen to settle within that."""

    samples: int
    seen: bool


def plateaus(rate: Float[np.ndarray, " rows"]) -> list[slice]:
    """Stretches of rows in which the rate stands still, for rates as commanded and as measured."""
    tolerance = _tolerance(rate)
    if tolerance > _MOVING * float(np.ptp(rate)):  # the rate of nearly every row is another
        return []
    found, begin = [], 0
    while begin < len(rate):
        if abs(rate[begin] - np.median(rate[begin : begin + 5])) > tolerance:  # the last row of a ramp
            begin += 1
            continue
        end = _leaves(rate, begin, tolerance)
        part = rate[begin:end]
        third = len(part) // 3
        if len(part) >= _FEWEST and abs(np.mean(part[:third]) - np.mean(part[-third:])) <= _TRAVEL * tolerance:
            found.append(slice(begin, end))
        begin = end
    if not found:
        return []
    usual = float(np.median([one.stop - one.start for one in found]))
    return [one for one in found if one.stop - one.start >= _SHORT * usual]


def _tolerance(rate: np.ndarray) -> float:
    """Within which a rate is the same: a few digits of a command, more of a rate that is measured with noise."""
    steps, span = np.abs(np.diff(rate)), float(np.ptp(rate))
    if np.mean(steps == 0.0) > 0.5:
        digit = float(np.min(steps[steps > 0.0], initial=span))
        return max(_DIGITS * digit if digit < _FINE * span else 0.0, _EXACT * span)
    noise = 1.4826 * float(np.median(np.abs(np.diff(rate) - np.median(np.diff(rate))))) / np.sqrt(2.0)
    return max(_SIGMAS * noise, _TOLERANCE * span)


def _leaves(rate: np.ndarray, begin: int, tolerance: float) -> int:
    """The row at which the rate leaves the level that it has from `begin` on, for two rows at least."""
    level = float(np.median(rate[begin : begin + 5]))
    width = 64
    while True:
        away = np.abs(rate[begin : begin + width] - level) > tolerance
        twice = np.flatnonzero(away[:-1] & away[1:])
        if twice.size:
            return max(begin + int(twice[0]), begin + 1)
        if begin + width >= len(rate):
            return len(rate)
        width *= 4


def settling(output: np.ndarray, found: list[slice]) -> Settling:
    """What to leave out of each plateau: until a step has died away to a millionth of itself.

    Steps of all plateaus together give one step response, each laid beside what its plateau gives in its last quarter;
    what noise hides of its end is continued as an exponential.
    """
    shortest = min(one.stop - one.start for one in found)
    ends = np.array([np.mean(output[one.stop - (one.stop - one.start) // 4 : one.stop]) for one in found])
    steps = ends[:-1] - ends[1:]
    if len(found) < 2 or not np.any(steps):
        return Settling(0, True)
    each = np.stack([output[one.start : one.start + shortest] for one in found[1:]])
    answer = steps @ (each - ends[1:, None]) / float(steps @ steps)
    edges = _edges(shortest)
    late = answer[-(shortest // 4) :]
    bins = [(a, float(np.mean(answer[a:b])), _spread(late, b - a)) for a, b in pairwise(edges)]
    quiet = np.array([abs(value) <= _NOISE * spread + _SETTLED for _, value, spread in bins])
    most = min(int(MOST * shortest), max(shortest - BATCHES, 0))
    # A response that rings passes zero: only two bins of noise after each other are its end.
    ends_at = np.flatnonzero(quiet[:-1] & quiet[1:])
    if not ends_at.size or bins[ends_at[0]][0] >= most:
        return Settling(most, False)
    last = int(ends_at[0])
    if last == 0:
        return Settling(min(2, most), True)
    first, hidden = abs(bins[0][1]), _NOISE * bins[last][2] + _SETTLED
    reached = bins[last][0]
    decay = reached / max(np.log(max(first / hidden, 1.0)), 1.0)
    wanted = int(np.ceil(max(reached, decay * np.log(max(first, _SETTLED) / _SETTLED))))
    return Settling(min(wanted, most), wanted <= most)


def _edges(shortest: int) -> list[int]:
    edges = [0]
    while edges[-1] < shortest:
        edges.append(min(shortest, max(edges[-1] + 1, int(_GROWTH * edges[-1]))))
    return edges


def _spread(late: np.ndarray, width: int) -> float:
    """Standard deviation of means of `width` samples of what is noise, white where there is not enough of it."""
    width_there = max(1, min(width, len(late) // 4))
    count = len(late) // width_there
    means = late[: count * width_there].reshape(count, width_there).mean(axis=1)
    return float(np.std(means, ddof=1)) * np.sqrt(width_there / width)


def batch_means(samples: np.ndarray) -> np.ndarray:
    """(BATCHES,) means of equally long stretches, in which what is correlated within one is held."""
    width = len(samples) // BATCHES
    return samples[: width * BATCHES].reshape(BATCHES, width).mean(axis=1)
