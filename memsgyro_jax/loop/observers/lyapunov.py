"""The thesis' own observer, with gains that make a Lyapunov function decrease (4.1.3.1, (4.11) and (4.12))."""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import VX, AbstractGyro, MotionModel, Pair, Scalar, check_positive, number
from memsgyro_jax.device.propagate import AbstractDiscretisation, Exact, State4, fence
from memsgyro_jax.device.small import Vector

from ..readout import AbstractReadout
from .adaptation import adaptation_units, adapted, first_guess
from .base import AbstractObserver, Clock, Estimate
from .settings import Annealing, arrays


class LyapunovState(NamedTuple):
    """Estimated motion and coefficients."""

    motion: State4
    theta: tuple[Scalar, ...]


class LyapunovObserver(AbstractObserver[LyapunovState]):
    """Velocity error drives the motion with a fixed gain and each coefficient with its own signal (4.11), (4.12).

    The gains of the thesis have no units: they hold for motion in units of `length` [m] and time in units of
    `1/frequency` [rad/s] (findings of its figures: 1 µm and 1/(2π·3 kHz)). `gain` is l of (4.11), one per axis;
    `adaptation` multiplies the unit gains of the coefficients, in the model's order, zero freezing one at its start.
    Corrections integrate the error, held over a sample, exactly. The read-out must be of velocity.

    With `annealing` every coefficient is adapted faster at first, by the factor that it gives; None is never. A control
    law acts by the coefficients, and pushes the mass by their noise, which grows with the gains by which they are
    adapted: fast ones at the start and slow ones later find the same values with less. The errors still fall: (4.31)
    with the motion's part times a factor that falls does, see `lyapunov_function`.
    """

    motion: State4 = arrays()
    theta: tuple[Scalar, ...] = arrays()
    gain: Pair = arrays()
    adaptation: tuple[Scalar, ...] = arrays()
    scale: Pair = arrays()
    offset: Pair = arrays()
    unit: tuple[Scalar, ...] = arrays()
    length: Scalar = number()
    frequency: Scalar = number()
    discretisation: AbstractDiscretisation
    model: MotionModel = eqx.field(static=True)
    annealing: Annealing | None = None
    usually_tuned: ClassVar[tuple[str, ...]] = ("gain",)

    def __check_init__(self):
        for value in self.gain:
            check_positive("gain", value)
        check_positive("length", self.length)
        check_positive("frequency", self.frequency)

    @classmethod
    def for_device(
        cls,
        gyro: AbstractGyro,
        readout: AbstractReadout,
        *,
        gain: float | Pair = 100.0,
        known: tuple[str, ...] = (),
        start: float = 1.0,
        motion: State4 = (1e-6, 0.0, 0.0, 0.0),
        length: float = 1e-6,
        frequency: float = 2.0 * np.pi * 3000.0,
        discretisation: AbstractDiscretisation | None = None,
        annealing: Annealing | None = None,
    ) -> "LyapunovObserver":
        """An observer whose coefficients start at `start` times those of `gyro` (thesis: 0.8), the rate at zero.

        `known` names coefficients that are not adapted: `("sigma",)` is the thesis' "mass known"; they start at the
        full value. Raises `InputError` for a displacement read-out, and for a `frequency` or `length` that is no
        quantity.
        """
        if readout.signals != (VX, VX + 1):
            raise InputError("The Lyapunov observer needs a velocity read-out; use `DirectReadout.of_velocity`.")
        frequency, length = quantity("frequency", frequency, "rad/s"), quantity("length", length, "m")
        design = gyro.coefficients(0.0)
        theta, adaptation = first_guess(gyro.model, design, known, start)
        return cls(
            motion=motion,
            theta=theta,
            gain=gain if isinstance(gain, tuple) else (gain, gain),
            adaptation=adaptation,
            scale=readout.scale,
            offset=readout.offset,
            unit=adaptation_units(gyro.model, design, frequency),
            length=length,
            frequency=frequency,
            discretisation=discretisation if discretisation is not None else Exact(),
            model=gyro.model,
            annealing=annealing,
        )

    def init(self) -> LyapunovState:
        """The start values."""
        return LyapunovState(self.motion, self.theta)

    def update(self, state: LyapunovState, measured: Pair, force: Pair, clock: Clock) -> LyapunovState:
        """Exact prediction with the present coefficients, then the correction by the velocity error."""
        dynamics = self.model.assemble(state.theta)
        motion = self.discretisation.advance(
            state.motion, dynamics.gain * Vector(force), dynamics.stiffness, dynamics.velocity, clock.period
        )
        motion = fence(clock.time, motion)
        speed = self.length * self.frequency
        error = ((Vector(measured) - self.offset) / self.scale - motion[2:]) / speed
        # A constant gain l closes 1 - exp(-l h) of the error in a sample of (scaled) length h; its integral is that
        # over l.
        closed = Vector(-jnp.expm1(-gain * self.frequency * clock.period) for gain in self.gain) * error
        velocity, driven = Vector(motion[2:]) + closed * speed, closed / self.gain
        theta = adapted(self, state.theta, (*motion, *force), self.haste(clock.time) * driven)
        return LyapunovState((*motion[:2], *velocity), theta)

    def haste(self, time: Scalar) -> Scalar:
        """By what all coefficients are adapted faster at `time` [s]: 1 without `annealing`."""
        return 1.0 if self.annealing is None else self.annealing.factor(time)

    def estimate(self, state: LyapunovState) -> Estimate:
        """Motion and coefficients; the read-out is taken as ideal, so the offsets are the declared ones."""
        return Estimate(state.motion, state.theta, self.offset, self.model)
