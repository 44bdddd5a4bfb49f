"""The observer port."""

import abc
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.fields import AbstractVar
from memsgyro_jax.device.gyro import Dynamics, MotionModel, Pair, Scalar
from memsgyro_jax.device.propagate import AbstractDiscretisation, State4

from ..die_by_die import from_outside
from .settings import Prior


State = TypeVar("State")

MOTION = ("x", "y", "vx", "vy")
OFFSETS = ("offset_x", "offset_y")


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

    @property
    def nats(self) -> Scalar:
        """Negative log-likelihood of both, but for ln 2π: ½ Σ (ln S + e²/S)."""
        return 0.5 * sum(s + jnp.log(v) for s, v in zip(self.squared, self.variance, strict=True))


class LockReadings(NamedTuple):
    """What electronics that lock to the drive axis read beside the rate: `quadrature` as the rate [rad/s] whose force
    has the size of a displacement's, `frequency` [Hz] of the lock, `amplitude` [m] along the drive axis and the `force`
    [N] that holds it.
    """

    quadrature: Scalar
    frequency: Scalar
    amplitude: Scalar
    force: Scalar


class Estimate(Displayed):
    """What an observer believes at a sample.

    `motion` is (x, y, vx, vy) in m and m/s, `theta` the coefficients of `model` in order (known ones at their known
    values), `offset` the read-out offsets in V. Observers with a covariance also give the variance of the rate in
    (rad/s)² and the innovation of the last sample; others leave None. `readings` are those of a controller that
    measures.
    """

    motion: State4
    theta: tuple[Scalar, ...]
    offset: Pair
    model: MotionModel = eqx.field(static=True)
    rate_variance: Scalar | None = None
    innovation: Innovation | None = None
    readings: LockReadings | None = None

    @property
    def nis(self) -> Scalar | None:
        """Normalised innovation squared of the last sample, 2 on average when the filter is consistent."""
        return None if self.innovation is None else sum(self.innovation.squared)

    @property
    def rate(self) -> Scalar:
        """Estimated angular rate in rad/s."""
        return self.theta[self.model.index("rate")]

    def read(self, rate: Scalar, readings: LockReadings) -> "Estimate":
        """The same with a measured rate [rad/s] in place of its own."""
        place = self.model.index("rate")
        theta = (*self.theta[:place], rate, *self.theta[place + 1 :])
        return Estimate(self.motion, theta, self.offset, self.model, self.rate_variance, self.innovation, readings)

    @property
    def dynamics(self) -> Dynamics:
        """The estimated equations of motion."""
        return self.model.assemble(self.theta)


class AbstractObserver(Displayed, Generic[State]):
    """Estimates motion and coefficients from measurements and its own last command; it never sees the true state.

    `usually_tuned` names the fields that tuning frees when nothing else is asked for. One that `learns` nothing from
    its measurements leaves the rate to a controller that measures.
    """

    if TYPE_CHECKING:  # a member's field may stand in the place of a property, not of a class variable

        @property
        def model(self) -> MotionModel: ...

    else:
        model: AbstractVar[MotionModel]
    usually_tuned: ClassVar[tuple[str, ...]] = ()
    learns: ClassVar[bool] = True

    @abc.abstractmethod
    def init(self) -> State:
        """The state before the first sample."""

    @abc.abstractmethod
    def update(self, state: State, measured: Pair, force: Pair, clock: Clock) -> State:
        """The state after a sample `measured` [V], with `force` [N] held since the sample before."""

    @abc.abstractmethod
    def estimate(self, state: State) -> Estimate:
        """What the state says."""

    def bounds(self, path: str, duration: float) -> tuple[float, float] | None:
        """Least and greatest sensible value of the own number at `path` for tuning on runs of `duration` [s]; None
        where nothing but its present value tells.
        """
        return None

    @property
    def claims_innovation(self) -> bool:
        """Whether estimates hold innovations with their variances, so that their likelihood is known."""
        return jax.eval_shape(lambda: self.estimate(self.init())).innovation is not None


_WALKS = (1e-7, 10.0)  # of what the prior leaves open, as much as a quantity may walk during a run


class AbstractCovarianceObserver(AbstractObserver[State]):
    """An observer that claims a covariance: sweeps then give the NEES and the ratio to the information bound, and
    tuning knows how far what it believes may walk.

    `prior` is its belief at the start. Numbers of a field `process_noise`, a `ProcessNoise`, are bounded by it.
    """

    if TYPE_CHECKING:  # a member's field may stand in the place of a property, not of a class variable

        @property
        def prior(self) -> Prior: ...

    else:
        prior: AbstractVar[Prior]

    @property
    @abc.abstractmethod
    def states(self) -> tuple[str, ...]:
        """Names of what is estimated, among x, y, vx, vy, offset_x, offset_y and the model's coefficients."""

    @abc.abstractmethod
    def covariance(self, state: State) -> Float[Array, "states states *lanes"]:
        """The covariance of the quantities in `states`, in their order."""

    @property
    def known(self) -> tuple[str, ...]:
        """Names of what is taken as known."""
        estimated = self.states
        return tuple(name for name in (*MOTION, *self.model.names, *OFFSETS) if name not in estimated)

    def error(
        self, state: State, motion: State4, offset: Pair, theta: tuple[Scalar, ...]
    ) -> Float[Array, "states *lanes"]:
        """Estimate minus truth in the order of `states`."""
        names, found = (*MOTION, *OFFSETS, *self.model.names), self.estimate(state)
        pairs = zip((*found.motion, *found.offset, *found.theta), (*motion, *offset, *theta), strict=True)
        errors = {name: estimate - truth for name, (estimate, truth) in zip(names, pairs, strict=True)}
        return jnp.stack([errors[name] for name in self.states])

    def bounds(self, path: str, duration: float) -> tuple[float, float] | None:
        """Of the process noise: a walk during a run from nearly nothing to some times what the prior leaves open."""
        if not path.startswith("process_noise."):
            return None
        kind, index = path.split(".")[-2:]
        prior = getattr(self.prior, f"{kind}_std", None)
        if prior is None:
            return None
        std = float(prior[int(index)])
        least, most = _WALKS
        return ((least * std) ** 2 / duration, (most * std) ** 2 / duration) if std > 0.0 else None


def check_claims(observer: AbstractObserver[Any]) -> None:
    """Raise `InputError` where the covariance of an observer from outside the package has another shape than its
    `states` say; it is not run.
    """
    if not (isinstance(observer, AbstractCovarianceObserver) and from_outside(observer)):
        return
    found = jax.eval_shape(lambda: jnp.asarray(observer.covariance(observer.init()))).shape
    count = len(observer.states)
    if found[:2] != (count, count):
        raise InputError(
            f"The covariance of {type(observer).__name__} must have the shape ({count}, {count}), a row and a column "
            f"for each of its `states` {', '.join(observer.states)}, but has {found}."
        )


class Believed(NamedTuple):
    """Mean and covariance of the quantities in `states`, in their order; dies trail."""

    mean: Float[Array, "states *lanes"]
    covariance: Float[Array, "states states *lanes"]


class AbstractBlockObserver(AbstractCovarianceObserver[State]):
    """A Kalman filter that can take a block of samples at a time: four entries of motion in `states`, then constants
    that walk at most: both offsets if `with_offsets`, then the model's coefficients numbered `estimated`.
    `discretisation` is its idea of a sample, `scale` [V per unit] that of the `signals`.

    It may carry constants beside its `states`, behind them, of which it says nothing to the loop; one of them, by
    `moves`, may move others.
    """

    if TYPE_CHECKING:  # a member's field may stand in the place of a property, not of a class variable

        @property
        def scale(self) -> Pair: ...

        @property
        def signals(self) -> tuple[int, int]: ...

        @property
        def discretisation(self) -> AbstractDiscretisation: ...

        @property
        def estimated(self) -> tuple[int, ...]: ...

        @property
        def with_offsets(self) -> bool: ...

    else:
        scale: AbstractVar[Pair]
        signals: AbstractVar[tuple[int, int]]
        discretisation: AbstractVar[AbstractDiscretisation]
        estimated: AbstractVar[tuple[int, ...]]
        with_offsets: AbstractVar[bool]

    @property
    @abc.abstractmethod
    def hindrance(self) -> str | None:
        """What of its settings a block cannot hold, in words; None for nothing."""

    @abc.abstractmethod
    def believed(self, state: State) -> Believed:
        """What the state says of `states`, and of what it carries beside them."""

    @abc.abstractmethod
    def believing(self, state: State, believed: Believed, innovation: Innovation) -> State:
        """`state` with another belief, and the innovation that led to it."""

    @abc.abstractmethod
    def variance(self, clock: Clock) -> Pair:
        """The variance in V² that it expects of a sample's noise."""

    @abc.abstractmethod
    def walk(self) -> tuple[Scalar, ...]:
        """Intensity of the random walk of each of these, in unit²/s."""

    def moves(self) -> Float[Array, "constants constants *lanes"] | None:
        """By how much each constant (a row) moves in a second under a unit of another, which itself stands still; None,
        as by default, where all do.
        """
        return None
