"""Adaptive sliding-mode control, the baseline of thesis 5.4.1."""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import (
    VX,
    AbstractGyro,
    MotionModel,
    Pair,
    Scalar,
    check_not_negative,
    check_positive,
    number,
)
from memsgyro_jax.device.propagate import State4, fence
from memsgyro_jax.device.small import Vector

from ..observers.adaptation import adaptation_units, adapted, first_guess
from ..observers.base import Clock, Estimate
from ..observers.settings import arrays
from ..readout import AbstractReadout
from .base import AbstractController, GivenTones, swing, tones_field


class SlidingState(NamedTuple):
    """Motion as measured, its error against the reference (displacement, velocity), the force held, coefficients."""

    motion: State4
    error: Pair
    slip: Pair
    force: Pair
    theta: tuple[Scalar, ...]


class SlidingMode(AbstractController[SlidingState]):
    """Holds each axis on a reference motion, the sum r of its `tones` in m, and adapts the coefficients while it does.

    With the error e of the measured motion and s = e' + λ e, λ being `slope`, the force makes

        q'' = r'' - λ e' - gain·sat(s/layer),    d(coefficient)/dt = adaptation · its signals · s,

    estimates in place of what it cancels, so that ½ (sᵀs + ρᵀρ) of s and the coefficients' errors ρ never rises (after
    Slotine and Li; the thesis prints no derivation). A thin `layer` holds the motion better and switches harder. As in
    `LyapunovObserver` the numbers have no units: motion in units of `length` [m], time in those of `1/frequency`
    [rad/s]. A force acts for a sample and is computed for its middle; the switching closes 1 - exp(-k h) of s in one,
    k = gain/layer, which no layer makes unstable.

    The read-out must be of velocity; its error integrates to that of displacement, which is forgotten at `forgetting`:
    without that the noise walks, and what has walked ripples on every coefficient. The rate is given out beside a
    `NoObserver`. Make one with `for_device`.
    """

    tones: GivenTones = tones_field()
    theta: tuple[Scalar, ...] = arrays(kw_only=True)
    layer: Scalar = number(default=0.1)
    gain: Scalar = number(default=1.0)
    slope: Scalar = number(default=1.0)
    forgetting: Scalar = number(default=0.25)
    adaptation: tuple[Scalar, ...] = arrays(kw_only=True)
    scale: Pair = arrays(kw_only=True)
    offset: Pair = arrays(kw_only=True)
    unit: tuple[Scalar, ...] = arrays(kw_only=True)
    length: Scalar = number(default=1e-6)
    frequency: Scalar = number(default=2.0 * np.pi * 3000.0)
    model: MotionModel = eqx.field(static=True, kw_only=True)
    usually_tuned: ClassVar[tuple[str, ...]] = ("layer", "gain", "slope", "adaptation")

    def __check_init__(self):
        for name in ("layer", "gain", "length", "frequency"):
            check_positive(name, getattr(self, name))
        for name in ("slope", "forgetting"):
            check_not_negative(name, getattr(self, name))

    @classmethod
    def for_device(
        cls, gyro: AbstractGyro, readout: AbstractReadout, tones: GivenTones, *, layer: float = 0.1, gain: float = 1.0,
        slope: float = 1.0, forgetting: float = 0.25, known: tuple[str, ...] = (), start: float = 1.0,
        length: float = 1e-6, frequency: float = 2.0 * np.pi * 3000.0,
    ) -> "SlidingMode":  # fmt: skip
        """A law whose coefficients start at `start` times those of `gyro` (thesis: 0.8), the rate at zero.

        `known` names coefficients that are not adapted: `("sigma",)` is the thesis' "mass known"; they start at the
        full value. Raises `InputError` for a displacement read-out, and for a `frequency` or `length` that is no
        quantity.
        """
        if readout.signals != (VX, VX + 1):
            raise InputError("Sliding-mode control needs a velocity read-out; use `DirectReadout.of_velocity`.")
        frequency, length = quantity("frequency", frequency, "rad/s"), quantity("length", length, "m")
        design = gyro.coefficients(0.0)
        theta, adaptation = first_guess(gyro.model, design, known, start)
        return cls(
            tones, layer=layer, gain=gain, slope=slope, forgetting=forgetting, theta=theta, adaptation=adaptation,
            scale=readout.scale, offset=readout.offset, unit=adaptation_units(gyro.model, design, frequency),
            length=length, frequency=frequency, model=gyro.model,
        )  # fmt: skip

    def init(self) -> SlidingState:
        """On the reference motion."""
        place, speed, _ = swing(self.tones, 0.0)
        still = (jnp.zeros(()), jnp.zeros(()))
        return SlidingState((*place, *speed), still, still, still, self.theta)

    def command(self, state: SlidingState, estimate: Estimate, clock: Clock) -> tuple[Pair, SlidingState]:
        """The force for the middle of the coming sample, over which it is held."""
        dynamics, half = self.model.assemble(state.theta), 0.5 * clock.period
        place, speed, push = swing(self.tones, clock.time + half)
        error, slip = Vector(state.error), Vector(state.slip)
        displacement, velocity = Vector(place) + error + half * slip, Vector(speed) + slip
        closed = -jnp.expm1(-self.gain / self.layer * self.frequency * clock.period) / clock.period
        within = Vector(jnp.clip(s, -self.layer, self.layer) for s in self._sliding(state.error, state.slip))
        wanted = Vector(push) - self.slope * self.frequency * slip - closed * self.length * self.frequency * within
        force = (wanted + dynamics.stiffness @ displacement + dynamics.velocity @ velocity) / dynamics.gain
        return tuple(force), state._replace(force=tuple(force))

    def measured(self, state: SlidingState, volts: Pair, clock: Clock) -> SlidingState:
        """Errors and coefficients after the sample that ends at `clock`."""
        h = clock.period
        place, speed, _ = swing(self.tones, clock.time)
        velocity = (Vector(volts) - self.offset) / self.scale
        slip, kept = velocity - speed, jnp.exp(-self.forgetting * self.frequency * h)
        error = kept * (Vector(state.error) + 0.5 * h * Vector(state.slip)) + 0.5 * h * slip
        motion = fence(clock.time, (*(Vector(place) + error), *velocity))
        driven = self._sliding(error, slip) * (self.frequency * h)
        theta = adapted(self, state.theta, (*motion, *state.force), driven)
        return SlidingState(motion, tuple(error), tuple(slip), state.force, theta)

    def output(self, state: SlidingState, estimate: Estimate) -> Estimate:
        """The motion as measured, and the coefficients."""
        return Estimate(state.motion, state.theta, self.offset, self.model)

    def _sliding(self, error: Pair, slip: Pair) -> Vector:
        """s without units."""
        return (Vector(slip) + self.slope * self.frequency * Vector(error)) / (self.length * self.frequency)
