"""A Kalman filter that takes a block of samples by its projections: the cheap observer of recorded voltages.

Within a block it only follows the motion m that it expects of the forces f held, at the coefficients of the block's
start, and adds up projections on b_n, 1 and the sine and cosine of both modes and of the tones:

    m_n = F m_{n-1} + G f_n,        Σ b_n (volts_n - C m_n - offset),    Σ b_n m_n,    Σ b_n f_n

At the block's end the first are what `advance` takes: whitened, so many scalar measurements of the block's start. How a
coefficient turns the motion follows from the signals it acts through, s_n = Φ b_n, which the other sums tell; with K
the kick of an acceleration in the middle of a sample, and c for the axes of it,

    δm_m = Σ_j D_m[j] c_j,    D_2m[j] = F_m D_m[j] + R_m D_m[j],    S_2m = S_m + R_m (O_m D_m + S_m R_mᵀ)

where c_j is what the coefficient makes of the signals' share of b_j, and O and S are the sums of b_n with what the
read-out shows of F^n and of D_n. For what moves as an undamped oscillation in the block that is exact; a decay within
it bends the gains, not what is expected.
"""

from functools import partial
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from memsgyro_jax.base.arguments import arrays, check_kind
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import AbstractGyro, Dynamics, MotionModel, Pair, Scalar, check_positive
from memsgyro_jax.device.propagate import State4

from ..observers.base import AbstractObserver, Believed, Clock, Estimate
from ..observers.ekf import ExtendedKalmanFilter
from ..readout import AbstractReadout
from . import basis
from .advance import corrected, covariance_later
from .algebra import multiplied, over_lanes
from .basis import Turn
from .length import ONE_MASS, Blocks, pace_of


class BlockUnderWay(NamedTuple):
    """Of a block that is under way: F and G of a sample, ω [rad per sample] of what swings, b where it is, and the sums
    of b with what was not expected [V], with the positions [m] and with the forces [N].
    """

    full: Float[Array, "4 4 *lanes"]
    push: Float[Array, "4 2 *lanes"]
    angles: Float[Array, "frequencies *lanes"]
    turn: Turn
    now: Float[Array, "k *lanes"]
    unexpected: Float[Array, "k 2 *lanes"]
    places: Float[Array, "k 2 *lanes"]
    forces: Float[Array, "k 2 *lanes"]


class BlockState(NamedTuple):
    """What the filter believed at the start of the block, the motion that it expects now, and the block under way."""

    held: Any
    motion: State4
    course: BlockUnderWay


class BlockFilter(AbstractObserver[BlockState]):
    """Takes recorded or running samples in blocks of `length`, a power of two, after `start` samples that `filter`
    takes one by one: a tenth of its operations. Make one with `for_device`.

    `tones` [Hz] are the frequencies of auxiliary signals that the
    motion holds beside its modes; one left out costs what it would have told. Its gains leave out what decays within a
    block: where a free mode loses much of its swing in one (of 3 kHz and a Q of 200, four tenths in 10 ms) it is out of
    its range and nothing tells; take shorter blocks. In a block the coefficients stand still,
    and the innovation is that of the block before: the root of the mean of the squares of its statistics.
    """

    filter: ExtendedKalmanFilter
    tones: tuple[Scalar, ...] = arrays("Hz", default=())
    length: int = eqx.field(static=True, default=1024)
    start: int = eqx.field(static=True, default=ONE_MASS.start)
    usually_tuned: ClassVar[tuple[str, ...]] = ("filter.noise_density",)

    def __check_init__(self):
        check_kind("filter", self.filter, ExtendedKalmanFilter, "an ExtendedKalmanFilter")
        Blocks(self.length, self.start)
        for tone in self.tones:
            check_positive("tones", tone)
        if self.filter.hindrance:
            raise InputError(f"A filter in blocks must be a plain one, but {self.filter.hindrance}.")

    @classmethod
    def for_device(
        cls,
        gyro: AbstractGyro,
        readout: AbstractReadout | None = None,
        *,
        tones: tuple[Scalar, ...] = (),
        length: int = 1024,
        start: int | None = None,
        **settings: Any,
    ) -> "BlockFilter":
        """A filter that expects `gyro` behind `readout`, with the `settings` of `ExtendedKalmanFilter.for_device`.

        A `start` of None is that of `Blocks`. Raises `InputError` for a length that is no power of two, a frequency
        that is not positive, and settings that a block cannot hold.
        """
        made = ExtendedKalmanFilter.for_device(gyro, readout, **settings)
        return cls(made, tones, length, pace_of(gyro).start if start is None else start)

    @property
    def model(self) -> MotionModel:
        return self.filter.model

    @property
    def statistics(self) -> int:
        """How many a block has of each channel."""
        return 1 + 2 * (2 + len(self.tones))

    def init(self) -> BlockState:
        return self.begun(self.filter.init(), 1.0)

    def begun(self, held: Any, period: Scalar) -> BlockState:
        """A block that begins with a state of `filter`."""
        lanes = jnp.broadcast_shapes(*map(jnp.shape, self.filter.estimate(held).theta))
        nothing = jnp.zeros((self.statistics, 2, *lanes))
        return BlockState(held, held.motion, self._course(held, period, nothing))

    def estimate(self, state: BlockState) -> Estimate:
        found = self.filter.estimate(state.held)
        return Estimate(state.motion, found.theta, found.offset, found.model, found.rate_variance, found.innovation)

    def bounds(self, path: str, duration: float) -> tuple[float, float] | None:
        return self.filter.bounds(path.removeprefix("filter."), duration)

    def update(self, state: BlockState, measured: Pair, force: Pair, clock: Clock) -> BlockState:
        """One by one at the start, then adding up, with what a block tells at its end."""
        given = measured, force, clock
        alone, within = lambda: self._alone(state, *given), lambda: self._followed(state, *given)
        new = jax.lax.cond(clock.sample <= self.start, alone, within)
        at_end = (clock.sample >= self.start) & ((clock.sample - self.start) % self.length == 0)
        return jax.lax.cond(at_end, lambda: self._next(new, clock), lambda: new)

    def taken(
        self, state: BlockState, volts: Float[Array, "length 2"], force: Float[Array, "length 2"], clock: Clock
    ) -> BlockState:
        """The state a whole block later, which ends at `clock`: as sample by sample, at once."""
        course, signals = state.course, jnp.array(self.filter.signals)

        def follow(motion: Array, held: Array) -> tuple[Array, Array]:
            motion = course.full @ motion + course.push @ held
            return motion, motion

        motion, path = jax.lax.scan(follow, jnp.stack(state.motion), force)
        at = basis.along(course.angles, self.length)
        left = volts - jnp.stack(self.filter.scale) * path[:, signals]
        course = course._replace(unexpected=at @ left, places=at @ path[:, :2], forces=at @ force)
        return self._next(BlockState(state.held, tuple(motion), course), clock)

    def _alone(self, state: BlockState, measured: Pair, force: Pair, clock: Clock) -> BlockState:
        held = self.filter.update(state.held, measured, force, clock)
        return _like(state, BlockState(held, held.motion, state.course))

    def _next(self, state: BlockState, clock: Clock) -> BlockState:
        """The block that begins, once what the one before told is believed; before the first there is none."""
        told = lambda: _like(state.held, self._ended(state, clock))  # noqa: E731
        # Not `where`: before the first block nothing was unexpected, and the root of nothing has no derivative.
        held = jax.lax.cond(clock.sample > self.start, told, lambda: state.held)
        return _like(state, self.begun(held, clock.period))

    def _followed(self, state: BlockState, measured: Pair, force: Pair, clock: Clock) -> BlockState:
        """A sample further in a block."""
        course, alone = state.course, self.filter
        row = course.now.shape[1:]
        lanes, volts, held = row or (1,), over_lanes(measured, row), over_lanes(force, row)
        flat = lambda part: part.reshape(*part.shape[: part.ndim - len(row)], *lanes)  # noqa: E731
        motion = multiplied(flat(course.full), flat(jnp.stack(state.motion)))
        motion = (motion + multiplied(flat(course.push), flat(held))).reshape(4, *row)
        now = basis.rotated(course.now, course.turn)
        expected = [scale * motion[signal] for signal, scale in zip(alone.signals, alone.scale, strict=True)]
        left = volts - jnp.stack(expected)
        add = lambda sums, value: sums + now[:, None] * value[None]  # noqa: E731
        further = course._replace(
            now=now,
            unexpected=add(course.unexpected, left),
            places=add(course.places, motion[:2]),
            forces=add(course.forces, held),
        )
        return _like(state, BlockState(state.held, tuple(motion), further))

    def _course(self, held: Any, period: Scalar, nothing: Array) -> BlockUnderWay:
        """That of a block that begins with `held` believed."""
        lanes = nothing.shape[2:]
        dynamics = self.filter.estimate(held).dynamics
        sample = self.filter.discretisation.transition(dynamics.stiffness, dynamics.velocity, period)
        gained = [[entry * gain for entry, gain in zip(row, dynamics.gain, strict=True)] for row in sample.push]
        (a, b), (c, d) = over_lanes(dynamics.stiffness, lanes)
        mean, half = 0.5 * (a + d), jnp.sqrt(jnp.maximum(0.25 * (a - d) ** 2 + b * c, 0.0))
        modes = [jnp.sqrt(jnp.maximum(square, 0.0)) for square in (mean - half, mean + half)]
        tones = [2.0 * jnp.pi * over_lanes(tone, lanes) for tone in self.tones]
        # No derivative: any frequencies give consistent statistics, these the fullest.
        angles = jax.lax.stop_gradient(jnp.stack([*modes, *tones])) * period
        turn, now = Turn(jnp.cos(angles), jnp.sin(angles)), basis.at(jnp.zeros_like(angles))
        return BlockUnderWay(
            over_lanes(sample.full, lanes), over_lanes(gained, lanes), angles, turn, now, nothing, nothing, nothing
        )

    def _ended(self, state: BlockState, clock: Clock) -> Any:
        """What is believed at the end of a block."""
        single = state.course.now.ndim == 1
        rows = lambda tree: jax.tree.map(lambda leaf: leaf[..., None], tree) if single else tree  # noqa: E731
        believed, course, motion = rows((self.filter.believed(state.held), state.course, jnp.stack(state.motion)))
        across = self._across(course, self.filter.estimate(state.held).dynamics, clock.period)
        whiten = basis.whitening(across.gram)
        told = self._told(course, across, whiten, believed.mean, clock.period)
        elapsed = self.length * clock.period
        middle = Clock(clock.time - 0.5 * elapsed, clock.sample, clock.period)
        lanes = motion.shape[1:]
        variance = over_lanes(self.filter.variance(middle), lanes)
        shift, covariance, read = corrected(told.rows, told.innovation, variance, believed.covariance)
        motion = motion + multiplied(across.free, shift[:4])
        if count := told.turned.shape[1]:
            motion = motion + multiplied(told.turned, shift[-count:])
        walk = over_lanes(self.filter.walk()[4:], lanes) * elapsed
        after = Believed(
            jnp.concatenate([motion, believed.mean[4:] + shift[4:]]),
            covariance_later(covariance, across.free, across.walked, told.turned, walk),
        )
        after, read = jax.tree.map(lambda leaf: leaf[..., 0] if single else leaf, (after, read))
        return self.filter.believing(state.held, after, read)

    def _told(self, course: BlockUnderWay, across: "_Across", whiten: Array, mean: Array, period: Scalar) -> "_Told":
        """The block's statistics, and what the errors of its start and of the coefficients make of them."""
        white = partial(multiplied, whiten)
        ones = white(across.gram[:, 0])
        offset = mean[4:6] if self.filter.with_offsets else over_lanes(self.filter.prior.offset, mean.shape[1:])
        acting, lanes = self._acting(course, whiten, period), mean.shape[1:]
        shown, pushed = jnp.moveaxis(across.seen_pushed, 1, 2), jnp.moveaxis(across.pushed, 0, 1)
        seen = multiplied(shown.reshape(*shown.shape[:2], -1, *lanes), acting)
        turned = multiplied(pushed.reshape(4, -1, *lanes), acting)
        parts = [white(across.seen_free), white(seen)]
        if self.filter.with_offsets:
            parts.insert(1, ones[:, None, None] * jnp.eye(2)[..., None])
        left = white(course.unexpected) - ones[:, None] * offset
        return _Told(jnp.concatenate(parts, axis=2), left, turned)

    def _acting(self, course: BlockUnderWay, whiten: Array, period: Scalar) -> Float[Array, "2k p lanes"]:
        """What a unit of each coefficient accelerates each axis by, as shares of each b."""
        fitted = lambda sums: multiplied(jnp.swapaxes(whiten, 0, 1), multiplied(whiten, sums))  # noqa: E731
        count = len(course.angles)
        half = Turn(jnp.cos(0.5 * course.angles), jnp.sin(0.5 * course.angles))
        places = basis.rotated(fitted(course.places), half)  # those of the middle of a sample, where they act
        pulsation = (course.angles / period)[:, None]
        cosine, sine = pulsation * places[1 + count :], -pulsation * places[1 : 1 + count]
        speeds = jnp.concatenate([jnp.zeros_like(places[:1]), cosine, sine])
        signals = jnp.concatenate([places, speeds, fitted(course.forces)], axis=1)  # (k, 6)
        made = []
        for index in self.filter.estimated:
            axes = [jnp.zeros_like(course.now)] * 2  # (k, lanes)
            for axis, signal, factor in self.filter.model.coefficients[index].terms:
                axes[axis] = axes[axis] + factor * signals[:, signal]
            made.append(jnp.stack(axes, axis=1).reshape(-1, *course.now.shape[1:]))
        return jnp.stack(made, axis=1) if made else jnp.zeros((2 * len(course.now), 0, *course.now.shape[1:]))

    def _across(self, course: BlockUnderWay, dynamics: Dynamics, period: Scalar) -> "_Across":
        """The block's maps, at the coefficients of its start."""
        alone, lanes = self.filter, course.now.shape[1:]
        half = alone.discretisation.transition(dynamics.stiffness, dynamics.velocity, 0.5 * period)
        kick = period * over_lanes([row[2:] for row in half.full], lanes)
        pairs = zip(alone.signals, alone.scale, strict=True)
        shown = over_lanes([[s if i == signal else 0.0 for i in range(4)] for signal, s in pairs], lanes)
        one = basis.at(course.angles)
        both = one[:, None] * one[None]
        start = _Across(
            course.turn,
            both,
            course.full,
            jnp.eye(4)[..., None] * over_lanes(alone.walk()[:4], lanes) * period,
            one[:, None, None] * kick,
            one[:, None, None] * multiplied(shown, course.full),
            both[:, :, None, None] * multiplied(shown, kick),
        )

        return jax.lax.scan(lambda half, _: (_doubled(half), None), start, length=self.length.bit_length() - 1)[0]


class _Told(NamedTuple):
    """Of a block: h of every statistic, what they told that was not expected, and by how much a unit of each
    coefficient turns the end of the motion.
    """

    rows: Float[Array, "k 2 states lanes"]
    innovation: Float[Array, "k 2 lanes"]
    turned: Float[Array, "4 p lanes"]


class _Across(NamedTuple):
    """Over m samples: b_m and G_m; F, the covariance that a walk of the motion gathers, and D, what accelerations as
    b_j push; and what the read-out shows of F and of D in b_i.
    """

    turn: Turn
    gram: Float[Array, "k k lanes"]
    free: Float[Array, "4 4 lanes"]
    walked: Float[Array, "4 4 lanes"]
    pushed: Float[Array, "k 4 2 lanes"]
    seen_free: Float[Array, "k 2 4 lanes"]
    seen_pushed: Float[Array, "k k 2 2 lanes"]


def _doubled(half: _Across) -> _Across:
    """Over 2m samples from over m."""
    turn, later = half.turn, jnp.swapaxes(half.seen_pushed, 0, 1)
    pushed = jnp.swapaxes(half.pushed, 0, 1)
    through = jnp.swapaxes(multiplied(half.seen_free, pushed), 1, 2)
    later = through + jnp.swapaxes(basis.rotated(later, turn), 0, 1)
    return _Across(
        turn.twice,
        basis.gram_twice(half.gram, turn),
        multiplied(half.free, half.free),
        half.walked + multiplied(multiplied(half.free, half.walked), jnp.swapaxes(half.free, 0, 1)),
        jnp.swapaxes(multiplied(half.free, pushed), 0, 1) + basis.rotated(half.pushed, turn),
        half.seen_free + basis.rotated(multiplied(half.seen_free, half.free), turn),
        half.seen_pushed + basis.rotated(later, turn),
    )


def _like(like: Any, state: Any) -> Any:
    """With the shapes and types of `like`."""
    return jax.tree.map(lambda new, old: jnp.broadcast_to(new, old.shape).astype(old.dtype), state, like)
