"""How a Kalman filter follows a small sine of the rate: sample by sample by what it expects to walk and the variance it
claims, in blocks by what the loop itself makes of one.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import ArrayLike, Complex, Float
from scipy.linalg import solve_discrete_are
from scipy.optimize import brentq

from .observers.base import AbstractBlockObserver
from .scenario import AbstractProfile, Constant, Sine


def by_samples(
    observer: AbstractBlockObserver, std: float, period: float, frequency: Float[ArrayLike, "..."]
) -> Complex[np.ndarray, "..."]:
    """Complex ratio of the estimate to the rate at each `frequency` [Hz], of a filter that claims `std` [rad/s] and
    reads the rate of the middle of each sample of `period` [s].
    """
    place = observer.states.index("rate")
    walked = period * float(observer.walk()[place])
    back = np.exp(-1j * np.pi * np.asarray(frequency) * period)  # by half a sample
    moves = observer.moves()
    if moves is None:
        share = walked / (std**2 + walked)  # what is claimed has been read since the walk
        return np.asarray(share * back / (1.0 - (1.0 - share) * back**2))
    later = np.array([[1.0, float(np.max(moves[place - 4])) * period], [0.0, 1.0]])
    gain = _gain(later, np.diag([walked, period * float(observer.walk()[-1])]), std)
    closed, shape = (np.eye(2) - gain @ _READS) @ later, (*np.shape(back), 1, 1)
    found = np.linalg.solve(np.eye(2) - closed * np.reshape(back, shape) ** 2, gain * np.reshape(back, shape))
    return np.asarray(found[..., 0, 0])


def _gain(later: np.ndarray, noise: np.ndarray, std: float) -> np.ndarray:
    """The gain (2, 1) that a filter of rate and slope settles to, whose readings have the variance with which it claims
    `std`.
    """

    def settled(size: float) -> tuple[np.ndarray, float]:
        variance = np.exp(size) * std**2
        before = solve_discrete_are(later.T, _READS.T, noise, np.array([[variance]]))
        gain = before @ _READS.T / (before[0, 0] + variance)
        return gain, float(before[0, 0] * variance / (before[0, 0] + variance))

    return settled(float(brentq(lambda size: np.log(settled(size)[1] / std**2), *_SIZES)))[0]


_READS = np.array([[1.0, 0.0]])
_SIZES = (1e-9, 25.0)  # of the logarithm of a reading's variance over that claimed


def by_blocks(
    run: Callable[[AbstractProfile], tuple[np.ndarray, np.ndarray]], level: float, frequency: Float[ArrayLike, "..."]
) -> Complex[np.ndarray, "..."]:
    """The same of a loop in blocks, by what a sine of each frequency adds to the estimates, over the sine.

    A filter that takes the rate as constant in a block weighs the early part of it more, as what the rate has moved
    since shows for longer, and by how much changes from block to block: no formula in the claims tells it.

    Args:
        run: times of a settled part of a run, and the estimates there, under a rate that is given.
        level: the rate [rad/s] that it is around.
        frequency: of each sine [Hz].
    """
    plain = run(Constant(level) + Sine(0.0, 1.0))[1]

    def followed(hertz: float) -> complex:
        time, moving = run(Constant(level) + Sine(_SIZE, hertz))
        phase = 2.0 * np.pi * hertz * time
        parts = np.stack([np.sin(phase), np.cos(phase)], axis=1)
        return complex(*np.linalg.lstsq(parts, (moving - plain) / _SIZE, rcond=None)[0])

    every = [followed(float(hertz)) for hertz in np.ravel(np.asarray(frequency, float))]
    return np.reshape(np.array(every), np.shape(frequency))


_SIZE = 1e-3  # rad/s
