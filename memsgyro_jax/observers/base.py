"""The observer port."""

import abc
from typing import Generic, NamedTuple, TypeVar

import equinox as eqx

from ..device import Dynamics, MotionModel, Pair, Scalar
from ..propagate import State4


State = TypeVar("State")


class Clock(NamedTuple):
    """The time of a sample in s, its number, and the sample period in s."""

    time: Scalar
    sample: Scalar
    period: Scalar


class Estimate(eqx.Module):
    """What an observer believes at a sample.

    `motion` is (x, y, vx, vy) in m and m/s, `theta` the coefficients of `model` in order (known ones at their known
    values), `offset` the read-out offsets in V. Observers with a covariance also give the variance of the rate in
    (rad/s)² and the normalised innovation squared of the last sample (2 on average when the filter is consistent);
    others leave None.
    """

    motion: State4
    theta: tuple[Scalar, ...]
    offset: Pair
    model: MotionModel = eqx.field(static=True)
    rate_variance: Scalar | None = None
    nis: Scalar | None = None

    @property
    def rate(self) -> Scalar:
        """Estimated angular rate in rad/s."""
        return self.theta[self.model.index("rate")]

    @property
    def dynamics(self) -> Dynamics:
        """The estimated equations of motion."""
        return self.model.assemble(self.theta)


class AbstractObserver(eqx.Module, Generic[State]):
    """Estimates motion and coefficients from measurements and its own last command; it never sees the true state."""

    model: eqx.AbstractVar[MotionModel]

    @abc.abstractmethod
    def init(self) -> State:
        """The state before the first sample."""

    @abc.abstractmethod
    def update(self, state: State, measured: Pair, force: Pair, clock: Clock) -> State:
        """The state after a sample `measured` [V], with `force` [N] held since the sample before."""

    @abc.abstractmethod
    def estimate(self, state: State) -> Estimate:
        """What the state says."""
