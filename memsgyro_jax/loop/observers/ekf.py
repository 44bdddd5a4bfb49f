"""Extended Kalman filter over motion, read-out offsets and coefficients (thesis 4.1.3.2 and 4.1.3.3).

The state of thesis (4.1) is 4 dynamic entries beside constants, and the Jacobian of a sample is the identity but for 4
rows. The filter keeps the covariance in three blocks (motion, cross, constants), takes the two measurements one after
the other, and so needs neither a 14x14 product nor an inverse. Equations, with F the exact transition of the motion:

    predict   motion' = F motion + push (gain force),  P_mm' = W J^T,  P_mc' = W_c,  with W = J P over the 4 rows of J
    J         [F, kick * signals(middle of the sample)], the coefficient columns of the Jacobian
    update    v = P h,  S = h v + R,  K = v/S,  P <- P - K v^T, once per axis

The coefficient columns place a coefficient's effect at the middle of the sample and propagate it exactly from there:
what accumulates at the resonances is then right at any sample rate, the remainder only ripples.
"""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import AbstractGyro, MotionModel, Pair, Scalar, X, Y, check_positive
from memsgyro_jax.device.propagate import AbstractDiscretisation, Exact, State4, Transition, advance, dot, fence

from ..readout import AbstractReadout, ChargeAmplifier
from .base import MOTION, OFFSETS, AbstractCovarianceObserver, Clock, Estimate, Innovation
from .covariance import (
    Columns,
    Covariance,
    Gain,
    Kick,
    Predicted,
    Prediction,
    add_diagonal,
    beside,
    correct_mean,
    downdate,
    entries,
    gathered,
    motion_block,
    rows,
    square,
)
from .fading import AbstractFading
from .settings import Annealing, Prior, ProcessNoise, design_prior


class KalmanState(NamedTuple):
    """Mean, covariance, what the fading law remembers, and the last innovation."""

    motion: State4
    constants: Float[Array, "constants *lanes"]
    covariance: Covariance
    fading: object
    innovation: Innovation

    @property
    def nis(self) -> Scalar:
        """The last normalised innovation squared."""
        return sum(self.innovation.squared)


class ExtendedKalmanFilter(AbstractCovarianceObserver[KalmanState]):
    """The observer of thesis (4.13)-(4.16). Make one with `for_device`.

    `estimated` holds the indices of the coefficients that are states, `with_offsets` whether the two read-out offsets
    are; the rest keeps its prior mean. `scale` in V per unit of `signals`, `noise_density` in V/√Hz one-sided.
    """

    prior: Prior
    scale: Pair
    noise_density: Pair
    process_noise: ProcessNoise
    fading: AbstractFading | None
    annealing: Annealing | None
    discretisation: AbstractDiscretisation
    model: MotionModel = eqx.field(static=True)
    signals: tuple[int, int] = eqx.field(static=True)
    estimated: tuple[int, ...] = eqx.field(static=True)
    with_offsets: bool = eqx.field(static=True)
    iterations: int = eqx.field(static=True)
    usually_tuned: ClassVar[tuple[str, ...]] = ("noise_density", "process_noise.rate")

    def __check_init__(self):
        for density in self.noise_density:
            check_positive("noise_density", density)
        if any(c.delays is not None for c in self.model.coefficients) and (
            self.signals != (X, Y) or self.iterations > 1 or self.fading is not None
        ):
            raise InputError(
                "A filter that estimates delays must have a displacement read-out, one iteration and no fading memory."
            )
        count = len(self.model.names)
        sizes = {
            "prior": (len(self.prior.theta), len(self.prior.theta_std)),
            "process_noise": (len(self.process_noise.theta),),
        }
        for name, found in sizes.items():
            if set(found) != {count}:
                raise InputError(
                    f"Argument `{name}` of the filter must hold one number for each of the {count} coefficients "
                    f"{', '.join(self.model.names)}, but {' and '.join(map(str, found))} were given."
                )

    @classmethod
    def for_device(
        cls,
        gyro: AbstractGyro,
        readout: AbstractReadout | None = None,
        *,
        known: tuple[str, ...] = (),
        with_offsets: bool = True,
        prior: Prior | None = None,
        process_noise: ProcessNoise | None = None,
        fading: AbstractFading | None = None,
        annealing: Annealing | None = None,
        discretisation: AbstractDiscretisation | None = None,
        iterations: int = 1,
    ) -> "ExtendedKalmanFilter":
        """A filter that expects a device like `gyro` (its design values) behind `readout` (default: thesis Table 5.3).

        `known` names coefficients taken as known: `("sigma",)` is the thesis' "mass known". `with_offsets=False` is its
        "ideal circuit". `iterations` above 1 relinearises each sample about its smoothed start (iterated
        filter-smoother).
        """
        readout = readout if readout is not None else ChargeAmplifier.chi2010()
        if iterations < 1:
            raise InputError(f"Argument `iterations` must be at least 1, but {iterations} was given.")
        fixed = {gyro.model.index(name) for name in known}
        return cls(
            prior=prior if prior is not None else design_prior(gyro),
            scale=readout.scale,
            noise_density=readout.noise_density,
            process_noise=process_noise if process_noise is not None else ProcessNoise.none(gyro.model),
            fading=fading,
            annealing=annealing,
            discretisation=discretisation if discretisation is not None else Exact(),
            model=gyro.model,
            signals=readout.signals,
            estimated=tuple(i for i in range(len(gyro.model.names)) if i not in fixed),
            with_offsets=with_offsets,
            iterations=iterations,
        )

    def init(self) -> KalmanState:
        """The prior."""
        mean, std = (
            self._constants(self.prior.offset, self.prior.theta),
            self._constants(self.prior.offset_std, self.prior.theta_std),
        )
        zero = 0.0 * self.prior.motion[0]
        upper = tuple(self.prior.motion_std[i] ** 2 if i == j else zero for i in range(4) for j in range(i, 4))
        cross = tuple(0.0 * mean for _ in range(4))
        spread = jnp.eye(len(mean)).reshape((len(mean),) * 2 + (1,) * (std.ndim - 1)) * std[None] ** 2
        nothing = Innovation((zero, zero), (zero + 1.0, zero + 1.0))
        return KalmanState(
            self.prior.motion,
            mean,
            Covariance(upper, cross, spread),
            self.fading.init() if self.fading else (),
            nothing,
        )

    def update(self, state: KalmanState, measured: Pair, force: Pair, clock: Clock) -> KalmanState:
        """Predict over the last sample and correct with both channels."""
        about = state.motion, state.constants
        for _ in range(self.iterations):
            predicted = self._predict(state, about, force, clock)
            corrected = self._correct(state, predicted, measured, clock)
            about = corrected.smoothed
        return corrected.state

    def estimate(self, state: KalmanState) -> Estimate:
        """Mean, rate variance and the last innovation."""
        rate = self.model.index("rate")
        variance = None
        if rate in self.estimated:
            position = self._first + self.estimated.index(rate)
            variance = state.covariance.constants[position, position]
        theta, offset = self._theta(state.constants), self._offset(state.constants)
        return Estimate(state.motion, theta, offset, self.model, variance, state.innovation)

    @property
    def states(self) -> tuple[str, ...]:
        """The motion, the offsets (unless the circuit is ideal) and the estimated coefficients."""
        return (*MOTION, *self._chosen(OFFSETS, self.model.names))

    def covariance(self, state: KalmanState) -> Float[Array, "states states *lanes"]:
        motion, cross, constants = state.covariance
        top = jnp.concatenate([jnp.stack([jnp.stack(row) for row in square(motion)]), jnp.stack(cross)], axis=1)
        bottom = jnp.concatenate([jnp.moveaxis(jnp.stack(cross), 0, 1), constants], axis=1)
        return jnp.concatenate([top, bottom], axis=0)

    @property
    def _first(self) -> int:
        return 2 if self.with_offsets else 0

    def _constants(self, offset: Pair, theta: tuple[Scalar, ...]) -> Float[Array, "constants *lanes"]:
        return jnp.stack(jnp.broadcast_arrays(*map(jnp.asarray, self._chosen(offset, theta))))

    def _chosen(self, offset: Pair, theta: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
        """Of all offsets and coefficients those that are states."""
        return (*(offset if self.with_offsets else ()), *(theta[i] for i in self.estimated))

    def _theta(self, constants: Array) -> tuple[Scalar, ...]:
        place = {index: self._first + order for order, index in enumerate(self.estimated)}
        known = entries(constants)
        return tuple(known[place[i]] if i in place else self.prior.theta[i] for i in range(len(self.model.names)))

    def _offset(self, constants: Array) -> Pair:
        return entries(constants)[:2] if self.with_offsets else self.prior.offset

    def _predict(self, state: KalmanState, about: tuple, force: Pair, clock: Clock) -> Predicted:
        """Mean and the rows of J P, linearised about the motion and constants in `about`."""
        theta = self._theta(about[1])
        dynamics = self.model.assemble(theta)
        acceleration = tuple(g * f for g, f in zip(dynamics.gain, force, strict=True))
        step = self.discretisation.transition(dynamics.stiffness, dynamics.velocity, clock.period)
        inside = tuple(advance(about[0], acceleration, node.reach, node.push) for node in step.nodes)
        mean = advance(about[0], acceleration, step.full, step.push)
        step, inside, mean = fence(clock.time, (step, inside, mean))
        kicks = tuple(
            (node.kick, self._columns((*motion, *force))) for node, motion in zip(step.nodes, inside, strict=True)
        )
        mean = self._shift(mean, state, about, step, kicks)
        return Predicted(mean, fence(clock.time, rows(state.covariance, step.full, kicks)), step.full, kicks)

    def _columns(self, signals: tuple[Scalar, ...]) -> Columns:
        """Per axis: which constant accelerates it by `factor * signal`, as (position among the constants, factor,
        signal).
        """
        columns: tuple[list, list] = ([], [])
        for order, index in enumerate(self.estimated):
            for axis, signal, factor in self.model.coefficients[index].terms:
                columns[axis].append((self._first + order, factor, signals[signal]))
        return tuple(map(tuple, columns))

    def _shift(
        self, mean: State4, state: KalmanState, about: tuple, step: Transition, kicks: tuple[Kick, ...]
    ) -> State4:
        """Carry a mean linearised elsewhere back to the filtered start; nothing to do in the first iteration."""
        if about[0] is state.motion:
            return mean
        motion = tuple(a - b for a, b in zip(state.motion, about[0], strict=True))
        constants = entries(state.constants - about[1])
        moved = [m + dot(row, motion) for m, row in zip(mean, step.full, strict=True)]
        for kick, columns in kicks:
            gained = tuple(gathered(column, constants) for column in columns)
            moved = [m + dot(k, gained) for m, k in zip(moved, kick, strict=True)]
        return tuple(moved)

    def _variance(self, clock: Clock) -> Pair:
        factor = 0.5 / clock.period
        if self.annealing is not None:
            factor = factor * self.annealing.factor(clock.time)
        return tuple(density**2 * factor for density in self.noise_density)

    def _correct(self, state: KalmanState, predicted: Predicted, measured: Pair, clock: Clock) -> "_Corrected":
        """Fading, process noise, and the two scalar measurements in turn."""
        variance = self._variance(clock)
        innovation = tuple(
            z - (s * predicted.mean[signal] + o)
            for z, s, signal, o in zip(measured, self.scale, self.signals, self._offset(state.constants), strict=True)
        )
        lags = self._lags(predicted.mean, state.constants)
        innovation = tuple(z if lag is None else z - lag.volts for z, lag in zip(innovation, lags, strict=True))
        motion, cross = motion_block(predicted), predicted.rows.constants
        faded, remembered = 1.0, ()
        if self.fading is not None:
            spread = self._output_spread(motion, cross, state)
            faded, remembered = self.fading.factor(state.fading, spread, innovation, variance, clock.period)
            motion, cross = tuple(faded * p for p in motion), tuple(faded * row for row in cross)
        motion = add_diagonal(motion, self.process_noise.motion, clock.period)
        prior = Prediction(motion, cross, state.covariance.constants, faded, self._walk(clock.period))
        first = self._gain(prior, 0, variance[0], None, lags)
        second = self._gain(prior, 1, variance[1], first, lags)
        first, second, innovation = fence(clock.time, (first, second, innovation))
        shared = self._output(first.motion_gain, first.constant_gain, 1, lags[1])
        weights = innovation[0], innovation[1] - shared * innovation[0]
        mean, constants = correct_mean(predicted.mean, state.constants, first, second, weights)
        seen = Innovation(weights, (first.spread, second.spread))
        new = KalmanState(mean, constants, downdate(prior, first, second), remembered, seen)
        return _Corrected(new, self._smoothed(state, predicted, weights, first, second, new, faded))

    def _output(self, motion: tuple[Scalar, ...], constants: Array, axis: int, lag: "_Lag | None" = None) -> Scalar:
        """The measured combination of a column: scale * signal + offset, less what a delay takes away."""
        value = self.scale[axis] * motion[self.signals[axis]]
        if lag is not None:
            value = value + lag.by_velocity * motion[self.signals[axis] + 2] + lag.by_delay * constants[lag.place]
        return value + entries(constants)[axis] if self.with_offsets else value

    def _lags(self, motion: State4, constants: Array) -> tuple["_Lag | None", "_Lag | None"]:
        """What the estimated delays do to the outputs: to first order, volts = scale * (x - delay * vx)."""
        lags: list[_Lag | None] = [None, None]
        for order, index in enumerate(self.estimated):
            axis = self.model.coefficients[index].delays
            if axis is not None:
                place = self._first + order
                by_velocity, by_delay = -self.scale[axis] * constants[place], -self.scale[axis] * motion[2 + axis]
                lags[axis] = _Lag(by_velocity * motion[2 + axis], by_velocity, by_delay, place)
        return lags[0], lags[1]

    def _output_spread(self, motion: tuple[Scalar, ...], cross: tuple[Array, ...], state: KalmanState) -> Pair:
        """Predicted variance of the two outputs before fading, noise and measurement noise."""
        block = square(motion)
        spread = []
        for axis, signal in enumerate(self.signals):
            value = self.scale[axis] ** 2 * block[signal][signal]
            if self.with_offsets:
                value = value + 2.0 * self.scale[axis] * cross[signal][axis] + state.covariance.constants[axis, axis]
            spread.append(value)
        return tuple(spread)

    def _walk(self, period: Scalar) -> Array:
        return self._constants(self.process_noise.offset, self.process_noise.theta) * period

    def _gain(self, prior: Prediction, axis: int, variance: Scalar, earlier: Gain | None, lags: tuple) -> Gain:
        """Covariance with the output of `axis`, given that output `earlier` has been taken."""
        lag = lags[axis]
        signal, scale = self.signals[axis], self.scale[axis]
        block = square(prior.motion)
        motion = tuple(scale * block[signal][i] for i in range(4))
        constants = scale * prior.cross[signal]
        if self.with_offsets:
            motion = tuple(v + entries(prior.cross[i])[axis] for i, v in enumerate(motion))
            constants = constants + prior.row(axis)
        if lag is not None:
            velocity, delay = block[signal + 2], [prior.cross[i][lag.place] for i in range(4)]
            motion = tuple(
                v + lag.by_velocity * p + lag.by_delay * c for v, p, c in zip(motion, velocity, delay, strict=True)
            )
            constants = constants + lag.by_velocity * prior.cross[signal + 2] + lag.by_delay * prior.row(lag.place)
        if earlier is not None:
            shared = self._output(earlier.motion, earlier.constants, axis, lag)
            motion = tuple(v - k * shared for v, k in zip(motion, earlier.motion_gain, strict=True))
            constants = constants - earlier.constant_gain * beside(shared, constants)
        spread = self._output(motion, constants, axis, lag) + variance
        inverse = 1.0 / spread
        return Gain(
            motion, constants, tuple(v * inverse for v in motion), constants * beside(inverse, constants), spread
        )

    def _smoothed(self, state, predicted, weights, first, second, new, faded) -> tuple:
        """Start of the sample given its end: the point about which an iterated filter linearises again."""
        if self.iterations == 1:
            return new.motion, new.constants
        # Cov(start, output) = (rows of J P) transposed, through the measurement; only the motion entries are needed.
        # Fading stands for a wider covariance of the start.
        offsets = state.covariance.cross if self.with_offsets else None
        start = []
        for i in range(4):
            seen = [self.scale[a] * predicted.rows.motion[self.signals[a]][i] for a in (0, 1)]
            if offsets is not None:
                seen = [value + offsets[i][a] for a, value in enumerate(seen)]
            seen = [faded * value for value in seen]
            second_seen = seen[1] - self._output(first.motion_gain, first.constant_gain, 1) * seen[0]
            start.append(
                state.motion[i] + seen[0] * weights[0] / first.spread + second_seen * weights[1] / second.spread
            )
        return tuple(start), new.constants


class _Lag(NamedTuple):
    """Of a delayed channel: its volts, their derivatives by velocity and by delay, and the delay's place."""

    volts: Scalar
    by_velocity: Scalar
    by_delay: Scalar
    place: int


class _Corrected(NamedTuple):
    state: KalmanState
    smoothed: tuple
