"""How a Kalman filter follows a small sine of the rate: sample by sample by what it expects to walk and the variance it
claims, in blocks by what the loop itself makes of a ramp.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import ArrayLike, Complex, Float
from scipy.linalg import solve_discrete_are
from scipy.optimize import brentq

from .observers.base import AbstractBlockObserver
from .scenario import Constant, Sine


if TYPE_CHECKING:
    from .trace_result import Trace


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
    trace: "Trace", run: Callable[..., "Trace"], frequency: Float[ArrayLike, "..."]
) -> Complex[np.ndarray, "..."]:
    """The same of the loop of a trace in blocks, `run` once more without and once with a sine of each frequency: what
    that adds to the estimates in the second half of the run, over the sine.

    A filter that takes the rate as constant in a block weighs the early part of it more, as what the rate has moved
    since shows for longer, and by how much changes from block to block: no formula in the claims tells it.
    """
    settings, blocks = trace.settings, trace.loop.blocks

    def ran(size: float, hertz: float) -> tuple[np.ndarray, np.ndarray]:
        found = run(
            trace.loop, Constant(float(trace.rate_true[-1])) + Sine(size, hertz), sample_rate=settings.sample_rate,
            duration=settings.duration, seed=settings.seed or 0, decimation=blocks.length,  # type: ignore[union-attr]
        )  # fmt: skip
        late = np.asarray(found.time) > 0.5 * settings.duration
        return np.asarray(found.time)[late], np.asarray(found.rate_unfiltered)[late]

    def followed(hertz: float) -> complex:
        time, moving = ran(_SIZE, hertz)
        phase = 2.0 * np.pi * hertz * time
        parts = np.stack([np.sin(phase), np.cos(phase)], axis=1)
        return complex(*np.linalg.lstsq(parts, (moving - plain) / _SIZE, rcond=None)[0])

    plain = ran(0.0, 1.0)[1]
    every = [followed(float(hertz)) for hertz in np.ravel(np.asarray(frequency, float))]
    return np.reshape(np.array(every), np.shape(frequency))


_SIZE = 1e-3  # rad/s
