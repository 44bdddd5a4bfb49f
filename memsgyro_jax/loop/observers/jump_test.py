"""A filter that notices when a coefficient has jumped, and looks for it again."""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from memsgyro_jax.base.arguments import check_kind
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import MotionModel, Pair, Scalar, check_not_negative, check_positive, number
from memsgyro_jax.device.propagate import AbstractDiscretisation

from .base import (
    MOTION,
    OFFSETS,
    AbstractBlockObserver,
    AbstractCovarianceObserver,
    Believed,
    Clock,
    Estimate,
    Innovation,
)
from .settings import Prior, arrays


class JumpState(NamedTuple):
    """The filter's state; the mean normalised innovation squared of the window, the sum of its weights and of their
    squares; when it opened last [s].
    """

    inner: Any
    mean: Scalar
    weight: Scalar
    squares: Scalar
    opened: Scalar


class JumpTest(AbstractCovarianceObserver[JumpState]):
    """Re-opens what `inner` believes of some coefficients when its innovations are larger than it expects.

    The test is of the mean normalised innovation squared over an exponential `window` [s], see `window_excess`; where a
    consistent filter's is beyond `level` as often as a normal variable is beyond as many standard deviations, the
    variance of each coefficient grows by the square of `reopened`, in the model's order, zero leaving one as it is. The
    next test waits for four windows. A coefficient that moves slowly is a matter of process noise; a rate that jumps by
    more than the filter expects opens them too, and they close again.
    """

    inner: AbstractBlockObserver
    reopened: tuple[Scalar, ...] = arrays()
    window: Scalar = number("s", default=1e-3)
    level: Scalar = number(default=5.0)
    usually_tuned: ClassVar[tuple[str, ...]] = ("inner.noise_density", "inner.process_noise.rate")

    def __check_init__(self):
        check_kind("inner", self.inner, AbstractBlockObserver, "a Kalman filter")
        check_positive("window", self.window)
        check_positive("level", self.level)
        names = self.inner.model.names
        if len(self.reopened) != len(names):
            raise InputError(
                f"Argument `reopened` must have one entry for each of {', '.join(names)}, but has {len(self.reopened)}."
            )
        for value in self.reopened:
            check_not_negative("reopened", value)

    @classmethod
    def of_damping(cls, inner: AbstractBlockObserver, std: Scalar, **options: Scalar) -> "JumpTest":
        """A test that re-opens the damping coefficients by `std` [1/s], those that the filter estimates."""
        named = [name.startswith("d") for name in inner.model.names]
        return cls(inner, tuple(std if damping else 0.0 for damping in named), **options)

    @property
    def model(self) -> MotionModel:
        """The filter's."""
        return self.inner.model

    @property
    def prior(self) -> Prior:
        """The filter's."""
        return self.inner.prior

    @property
    def signals(self) -> tuple[int, int]:
        """What the filter measures."""
        return self.inner.signals

    @property
    def scale(self) -> Pair:
        """The read-out's scale in the filter's eyes."""
        return self.inner.scale

    @property
    def discretisation(self) -> AbstractDiscretisation:
        """The filter's idea of a sample."""
        return self.inner.discretisation

    @property
    def process_noise(self) -> Any:
        """What the filter expects to walk, where it says so."""
        return getattr(self.inner, "process_noise", None)

    @property
    def noise_density(self) -> Any:
        """What the filter was told of the read-out's noise, where it says so."""
        return getattr(self.inner, "noise_density", None)

    @property
    def states(self) -> tuple[str, ...]:
        """The filter's."""
        return self.inner.states

    def covariance(self, state: JumpState) -> Float[Array, "states states *lanes"]:
        return self.inner.covariance(state.inner)

    def estimate(self, state: JumpState) -> Estimate:
        """What the filter says."""
        return self.inner.estimate(state.inner)

    def bounds(self, path: str, duration: float) -> tuple[float, float] | None:
        """The filter's for its own numbers."""
        return self.inner.bounds(path.removeprefix("inner."), duration)

    def init(self) -> JumpState:
        """The filter's start; nothing gathered, and no opening so far."""
        inner = self.inner.init()
        zero = 0.0 * self.inner.estimate(inner).rate
        return JumpState(inner, zero, zero, zero, zero)

    def update(self, state: JumpState, measured: Pair, force: Pair, clock: Clock) -> JumpState:
        """The filter's update, then the test."""
        inner = self.inner.update(state.inner, measured, force, clock)
        innovation = self._innovation(inner)
        keep = jnp.exp(-clock.period / self.window)
        new = 1.0 - keep
        mean = keep * state.mean + new * sum(innovation.squared)
        weight, squares = keep * state.weight + new, keep**2 * state.squares + new**2
        beyond = window_excess(mean / weight, weight**2 / squares) > self.level
        jumped = beyond & (clock.time - state.opened > 4.0 * self.window)
        believed = self.inner.believed(inner)
        wider = believed.covariance + jnp.where(jumped, 1.0, 0.0) * self._widening(believed.covariance)
        inner = self.inner.believing(inner, Believed(believed.mean, wider), innovation)
        forget = lambda value: jnp.where(jumped, 0.0, value)  # noqa: E731
        opened = jnp.where(jumped, clock.time, state.opened)
        return JumpState(inner, forget(mean), forget(weight), forget(squares), opened)

    def _innovation(self, inner: Any) -> Innovation:
        found = self.inner.estimate(inner).innovation
        if found is None:
            raise InputError(
                f"A jump test needs a filter that gives its innovation; {type(self.inner).__name__} does not."
            )
        return found

    def _widening(self, like: Array) -> Array:
        """What an opening adds to the covariance, shaped so that dies trail."""
        named = dict(zip(self.model.names, self.reopened, strict=True))
        zero = 0.0 * like[0, 0]
        rows = [zero if name in (*MOTION, *OFFSETS) else zero + named[name] ** 2 for name in self.states]
        rows += [zero] * (len(like) - len(rows))  # of what the filter carries beside its states
        count = len(rows)
        return jnp.eye(count).reshape((count, count) + (1,) * (like.ndim - 2)) * jnp.stack(rows)[None]


def window_excess(mean: Scalar, samples: Scalar) -> Scalar:
    """By how many standard deviations of a normal variable the weighted `mean` of normalised innovations squared of two
    channels is above 2; `samples` is the square of the sum of the weights over the sum of their squares.

    Exponential weights make it more skewed than a mean of as many equal ones: it is taken for a shifted χ² variable of
    the same three moments, of 9/8 degrees of freedom for each of `samples`, and that by its cube root.
    """
    share = 2.0 / (9.0 * 1.125 * samples)
    return (jnp.cbrt(1.0 + (0.5 * mean - 1.0) * 4.0 / 3.0) - (1.0 - share)) / jnp.sqrt(share)
