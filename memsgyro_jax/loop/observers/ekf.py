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

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from memsgyro_jax.base.arguments import arrays
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.carried import Effects, each_die
from memsgyro_jax.device.gyro import AbstractGyro, MotionModel, Pair, Scalar, X, Y, check_positive
from memsgyro_jax.device.propagate import AbstractDiscretisation, Exact, State4, Transition, fence
from memsgyro_jax.device.small import Vector
from memsgyro_jax.effects.base import ReadoutEffect

from ..readout import AbstractReadout, ChargeAmplifier
from .base import MOTION, OFFSETS, AbstractBlockObserver, Believed, Clock, Estimate, Innovation
from .channel import Channel
from .covariance import (
    Columns,
    Covariance,
    Kick,
    Predicted,
    Prediction,
    blocks_of,
    correct_mean,
    downdate,
    entries,
    gathered,
    matrix_of,
    motion_block,
    rows,
)
from .fading import AbstractFading
from .pickoff import check_curves, curved
from .settings import Annealing, Prior, ProcessNoise, check_lengths, check_told, design_prior, rounding_of


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


class ExtendedKalmanFilter(AbstractBlockObserver[KalmanState]):
    """The observer of thesis (4.13)-(4.16). Make one with `for_device`.

    `estimated` holds the indices of the coefficients that are states, `with_offsets` whether the two read-out offsets
    are; the rest keeps its prior mean. `scale` in V per unit of `signals`, `noise_density` in V/√Hz one-sided.
    `pickoff` are read-out effects that it knows: curves of the pick-off, followed to first order about the estimate.
    `rounding` is the standard deviation in V that a converter adds to each sample; empty without one.
    """

    prior: Prior
    scale: Pair = arrays()
    noise_density: Pair = arrays("V/sqrt(Hz)")
    process_noise: ProcessNoise
    fading: AbstractFading | None
    annealing: Annealing | None
    discretisation: AbstractDiscretisation
    model: MotionModel = eqx.field(static=True)
    signals: tuple[int, int] = eqx.field(static=True)
    estimated: tuple[int, ...] = eqx.field(static=True)
    with_offsets: bool = eqx.field(static=True)
    iterations: int = eqx.field(static=True)
    pickoff: tuple[Any, ...] = eqx.field(converter=Effects.of, default=())
    rounding: Pair = arrays("V", default=())
    usually_tuned: ClassVar[tuple[str, ...]] = ("noise_density", "process_noise.rate")

    def __check_init__(self):
        check_told(self.prior, self.process_noise, self.model)
        check_lengths(self, scale=2, noise_density=2, **({"rounding": 2} if self.rounding else {}))
        for density in self.noise_density:
            check_positive("noise_density", density)
        if any(self.model.coefficients[i].delays is not None for i in self.estimated) and (
            self.signals != (X, Y) or self.iterations > 1 or self.fading is not None
        ):
            raise InputError(
                "A filter that estimates delays must have a displacement read-out, one iteration and no fading memory."
            )
        check_curves(self.pickoff, self.signals)

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
        pickoff: tuple[ReadoutEffect, ...] = (),
    ) -> "ExtendedKalmanFilter":
        """A filter that expects a device like `gyro` (its design values) behind `readout` (default: thesis Table 5.3).

        `known` names coefficients taken as known: `("sigma",)` is the thesis' "mass known". `with_offsets=False` is its
        "ideal circuit". `iterations` above 1 relinearises each sample about its smoothed start (iterated
        filter-smoother). `pickoff` are effects of the read-out that are known: `curves_of(gyro)`, say. The Brownian
        force of a gyro that knows its temperature is expected.
        """
        readout = readout if readout is not None else ChargeAmplifier.chi2010()
        if iterations < 1:
            raise InputError(f"Argument `iterations` must be at least 1, but {iterations} was given.")
        fixed = {gyro.model.index(name) for name in known}
        return cls(
            prior=prior if prior is not None else design_prior(gyro),
            scale=readout.scale,
            noise_density=readout.noise_density,
            process_noise=(process_noise or ProcessNoise.none(gyro.model)).shaken_as(gyro),
            fading=fading,
            annealing=annealing,
            discretisation=discretisation if discretisation is not None else Exact(),
            model=gyro.model,
            signals=readout.signals,
            estimated=tuple(i for i in range(len(gyro.model.names)) if i not in fixed),
            with_offsets=with_offsets,
            iterations=iterations,
            pickoff=pickoff,
            rounding=rounding_of(readout),
        )

    def init(self) -> KalmanState:
        """The prior."""
        mean = self._constants(self.prior.offset, self.prior.theta)
        std = self._constants(self.prior.offset_std, self.prior.theta_std)
        zero = 0.0 * self.prior.motion[0]
        upper = tuple(self.prior.motion_std[i] ** 2 if i == j else zero for i in range(4) for j in range(i, 4))
        cross = tuple(0.0 * mean for _ in range(4))
        spread = jnp.eye(len(mean)).reshape((len(mean),) * 2 + (1,) * (std.ndim - 1)) * std[None] ** 2
        nothing = Innovation((zero, zero), (zero + 1.0, zero + 1.0))
        remembered = self.fading.init() if self.fading else ()
        return KalmanState(self.prior.motion, mean, Covariance(upper, cross, spread), remembered, nothing)

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
        return matrix_of(state.covariance)

    @property
    def hindrance(self) -> str | None:
        """Whatever is not a plain extended Kalman filter."""
        parts = any(
            (c := self.model.coefficients[i]).delays is not None or c.scales is not None for i in self.estimated
        )
        found = {
            "the filter's fading memory weighs samples": self.fading is not None,
            "the filter iterates every sample": self.iterations > 1,
            "the filter follows curves of the pick-off": bool(self.pickoff),
            "the filter estimates delays or scales": parts,
            "the filter expects a Brownian force": self.process_noise.acceleration is not None,
        }
        return next((words for words, holds in found.items() if holds), None)

    def believed(self, state: KalmanState) -> Believed:
        return Believed(jnp.concatenate([jnp.stack(state.motion), state.constants]), self.covariance(state))

    def believing(self, state: KalmanState, believed: Believed, innovation: Innovation) -> KalmanState:
        mean = believed.mean
        return KalmanState(tuple(mean[:4]), mean[4:], blocks_of(believed.covariance), state.fading, innovation)

    def walk(self) -> tuple[Scalar, ...]:
        noise = self.process_noise
        return (*noise.motion, *self._chosen(noise.offset, noise.theta))

    @property
    def _first(self) -> int:
        return 2 if self.with_offsets else 0

    def _constants(self, offset: Pair, theta: tuple[Scalar, ...]) -> Float[Array, "constants *lanes"]:
        chosen = self._chosen(offset, theta)
        return jnp.stack(jnp.broadcast_arrays(*map(jnp.asarray, chosen))) if chosen else jnp.zeros(0)

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
        push = dynamics.gain * Vector(force)
        step = self.discretisation.transition(dynamics.stiffness, dynamics.velocity, clock.period)
        inside = tuple(node.reach @ about[0] + node.push @ push for node in step.nodes)
        mean = step.full @ about[0] + step.push @ push
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
        self, mean: Vector, state: KalmanState, about: tuple, step: Transition, kicks: tuple[Kick, ...]
    ) -> Vector:
        """Carry a mean linearised elsewhere back to the filtered start; nothing to do in the first iteration."""
        if about[0] is state.motion:
            return mean
        mean = mean + step.full @ (Vector(state.motion) - about[0])
        constants = entries(state.constants - about[1])
        for kick, columns in kicks:
            mean = mean + kick @ gathered(columns, constants)
        return mean

    def _channels(self, motion: Vector, constants: Array) -> tuple[Channel, Channel]:
        """Both measurements, linearised about a mean."""
        slopes = self.scale
        volts = tuple(scale * motion[signal] for signal, scale in zip(self.signals, slopes, strict=True))
        if self.pickoff:
            volts, slopes = each_die(curved, self.pickoff, self.scale, tuple(motion[:2]))
        channels = [
            Channel(self.signals[axis], slopes[axis], axis if self.with_offsets else None, volts[axis])
            for axis in range(2)
        ]
        for order, index in enumerate(self.estimated):
            place, coefficient = self._first + order, self.model.coefficients[index]
            if (axis := coefficient.delays) is not None:
                channels[axis] = channels[axis].with_delay(motion[2 + axis], constants, place)
            if (axis := coefficient.scales) is not None:
                channels[axis] = channels[axis].with_share(constants, place)
        return channels[0], channels[1]

    def variance(self, clock: Clock) -> Pair:
        """The density over the band of a sample and the rounding, raised while it anneals."""
        factor = 1.0 if self.annealing is None else self.annealing.factor(clock.time)
        white = tuple(density**2 * (0.5 / clock.period * factor) for density in self.noise_density)
        return tuple(w + s**2 * factor for w, s in zip(white, self.rounding, strict=True)) if self.rounding else white

    def _correct(self, state: KalmanState, predicted: Predicted, measured: Pair, clock: Clock) -> "_Corrected":
        """Fading, process noise, and the two scalar measurements in turn."""
        variance, channels = self.variance(clock), self._channels(predicted.mean, state.constants)
        innovation = self._innovation(measured, state.constants, channels)
        motion, cross = motion_block(predicted), predicted.rows.constants
        faded, remembered = 1.0, ()
        if self.fading is not None:
            spread = tuple(channel.spread(motion, cross, state.covariance.constants) for channel in channels)
            faded, remembered = self.fading.factor(state.fading, spread, innovation, variance, clock.period)
            motion, cross = faded * motion, faded * cross
        expected = self.model.assemble(self.prior.theta)
        motion = motion + self.process_noise.gathered(expected, self.discretisation, clock.period)
        walk = self._constants(self.process_noise.offset, self.process_noise.theta) * clock.period
        prior = Prediction(motion, cross, state.covariance.constants, faded, walk)
        first = channels[0].gain(prior, variance[0])
        second = channels[1].gain(prior, variance[1], first)
        first, second, innovation = fence(clock.time, (first, second, innovation))
        shared = channels[1].of(first.motion_gain, first.constant_gain)
        weights = innovation[0], innovation[1] - shared * innovation[0]
        mean, constants = correct_mean(predicted.mean, state.constants, first, second, weights)
        seen = Innovation(weights, (first.spread, second.spread))
        new = KalmanState(mean, constants, downdate(prior, first, second), remembered, seen)
        return _Corrected(new, self._smoothed(state, predicted, weights, first, second, new, faded))

    def _innovation(self, measured: Pair, constants: Array, channels: tuple[Channel, Channel]) -> Pair:
        """What was measured less what was expected."""
        parts = zip(measured, channels, self._offset(constants), strict=True)
        return tuple(channel.without_parts(z - (channel.volts + offset)) for z, channel, offset in parts)

    def _smoothed(self, state, predicted, weights, first, second, new, faded) -> tuple:
        """Start of the sample given its end: the point about which an iterated filter linearises again."""
        if self.iterations == 1:
            return new.motion, new.constants
        # Cov(start, output) = (rows of J P) transposed, through the measurement; only the motion entries are needed.
        # Fading stands for a wider covariance of the start.
        channels = self._channels(predicted.mean, state.constants)
        seen = [channel.scale * predicted.rows.motion[channel.signal] for channel in channels]
        if self.with_offsets:
            seen = [s + Vector(row[axis] for row in state.covariance.cross) for axis, s in enumerate(seen)]
        seen = [faded * s for s in seen]
        second_seen = seen[1] - channels[1].of(first.motion_gain, first.constant_gain) * seen[0]
        start = state.motion + seen[0] * weights[0] / first.spread + second_seen * weights[1] / second.spread
        return tuple(start), new.constants


class _Corrected(NamedTuple):
    state: KalmanState
    smoothed: tuple
