"""How a Kalman filter follows a small sine of the rate: by what it expects to walk, and the variance it claims."""

import numpy as np
from jaxtyping import ArrayLike, Complex, Float
from scipy.linalg import solve_discrete_are
from scipy.optimize import brentq

from .observers.base import AbstractBlockObserver


def following_response(
    observer: AbstractBlockObserver, std: float, period: float, frequency: Float[ArrayLike, "..."], blocks: bool
) -> Complex[np.ndarray, "..."]:
    """Complex ratio of the estimate to the rate at each `frequency` [Hz], of a filter that claims `std` [rad/s] at the
    end of each `period` [s], a sample or one of `blocks`, each of which reads the rate of its middle.
    """
    place = observer.states.index("rate")
    walked = period * float(observer.walk()[place])
    back = np.exp(-1j * np.pi * np.asarray(frequency) * period)  # by half a period
    moves = observer.moves()
    if moves is None:
        # What a block's end claims holds the walk already, what a sample's claims has been read since.
        share = walked / (std**2 + (0.0 if blocks else walked))
        return np.asarray(share * back / (1.0 - (1.0 - share) * back**2))
    rise = float(np.max(moves[place - 4])) * period
    later = np.array([[1.0, rise], [0.0, 1.0]])
    noise = np.diag([walked, period * float(observer.walk()[-1])])
    reads = np.array([[1.0, 0.5 * rise if blocks else 0.0]])  # a block's middle, from its begin
    gain = _gain(later, noise, reads, std, blocks)
    closed, driven = (np.eye(2) - gain @ reads, gain)
    closed, driven = (later @ closed, later @ driven) if blocks else (closed @ later, driven)
    shape = (*np.shape(back), 1, 1)
    found = np.linalg.solve(np.eye(2) - closed * np.reshape(back, shape) ** 2, driven * np.reshape(back, shape))
    return np.asarray(found[..., 0, 0])


def _gain(later: np.ndarray, noise: np.ndarray, reads: np.ndarray, std: float, blocks: bool) -> np.ndarray:
    """The gain (2, 1) that a filter of rate and slope settles to, whose readings have the variance with which it claims
    `std`.
    """

    def settled(variance: float) -> tuple[np.ndarray, np.ndarray]:
        before = solve_discrete_are(later.T, reads.T, noise, np.array([[variance]]))
        gain = before @ reads.T / (reads @ before @ reads.T + variance)
        return gain, before if blocks else before - gain @ reads @ before

    excess = lambda size: np.log(settled(np.exp(size) * std**2)[1][0, 0] / std**2)  # noqa: E731
    return settled(float(np.exp(brentq(excess, *_SIZES))) * std**2)[0]


_SIZES = (-3.0, 25.0)  # of the logarithm of a reading's variance over that claimed
