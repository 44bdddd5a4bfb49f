"""The observer port."""

import abc
from typing import Generic, NamedTuple, TypeVar

import equinox as eqx

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.fields import AbstractVar
from memsgyro_jax.device.gyro import Dynamics, MotionModel, Pair, Scalar
from memsgyro_jax.device.propagate import State4


State = TypeVar("State")


class Clock(NamedTuple):
    """The time of a sample in s, its number, and the sample period in s."""

    time: Scalar
    sample: Scalar
    period: Scalar


class Innovation(NamedTuple):
    """What the last sample told that was not expected: `error` in V of the two channels and the `variance` in V² that
    the filter claims for them, the second given the first, so that the two are independent.
    """

    error: Pair
    variance: Pair

    @property
    def squared(self) -> Pair:
        """Squared error over variance of each channel; 1 on average when the filter is consistent."""
        return tuple(e**2 / v for e, v in zip(self.error, self.variance, strict=True))


class Estimate(eqx.Module):
    """What an observer believes at a sample.

    `motion` is (x, y, vx, vy) in m and m/s, `theta` the coefficients of `model` in order (known ones at their known
    values), `offset` the read-out offsets in V. Observers with a covariance also give the variance of the rate in
    (rad/s)² and the innovation of the last sample; others leave None.
    """

    motion: State4
    theta: tuple[Scalar, ...]
    offset: Pair
    model: MotionModel = eqx.field(static=True)
    rate_variance: Scalar | None = None
    innovation: Innovation | None = None

    @property
    def nis(self) -> Scalar | None:
        """Normalised innovation squared of the last sample, 2 on average when the filter is consistent."""
        return None if self.innovation is None else sum(self.innovation.squared)

    @property
    def rate(self) -> Scalar:
        """Estimated angular rate in rad/s."""
        return self.theta[self.model.index("rate")]

    @property
    def dynamics(self) -> Dynamics:
        """The estimated equations of motion."""
        return self.model.assemble(self.theta)


class AbstractObserver(Displayed, Generic[State]):
    """Estimates motion and coefficients from measurements and its own last command; it never sees the true state."""

    model: AbstractVar[MotionModel]

    @abc.abstractmethod
    def init(self) -> State:
        """The state before the first sample."""

    @abc.abstractmethod
    def update(self, state: State, measured: Pair, force: Pair, clock: Clock) -> State:
        """The state after a sample `measured` [V], with `force` [N] held since the sample before."""

    @abc.abstractmethod
    def estimate(self, state: State) -> Estimate:
        """What the state says."""
