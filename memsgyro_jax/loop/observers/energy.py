"""The Lyapunov observer with energy state (thesis 4.2.2, (4.22) to (4.24))."""

from typing import ClassVar

import jax.numpy as jnp

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import MotionModel, Pair, Scalar, check_not_negative, check_positive, number
from memsgyro_jax.device.small import Vector

from .adaptation import adapted
from .base import AbstractObserver, Clock, Estimate
from .lyapunov import LyapunovObserver, LyapunovState
from .settings import arrays


class EnergyObserver(AbstractObserver[LyapunovState]):
    """Beside the velocity error, what energy is missing drives the coefficients: `inner` with L_E of (4.24).

    The energy E is ½ Σ (v² + ω² q²) of the measured velocity, ω = 2π·`frequency` (x, y) [Hz] being that at which the
    axes swing under energy control, E0 that of `amplitude` (x, y) [m]. A coefficient is driven by E - E0 times the
    velocity as by a velocity error, with the unit gain of the thesis times `gain`; zero leaves `inner` alone.

    (4.24) follows from V + ½ (E0 - E)² where E changes by the wrong coefficients' work. That holds for 1/mass too, for
    which the thesis has zero; the work of tones and of the motion's own error stays, of either sign, so that V need not
    fall (`studies/thesis_5_4_3.py`). (4.22) measures displacement and velocity; here the displacement is estimated.
    """

    inner: LyapunovObserver
    frequency: Pair = arrays("Hz")
    amplitude: Pair = arrays("m", metadata={"unit": "m"})
    gain: Scalar = number(default=1.0)
    usually_tuned: ClassVar[tuple[str, ...]] = ("inner.gain", "gain")

    def __check_init__(self):
        check_swing(self.frequency, self.amplitude)
        check_not_negative("gain", self.gain)

    @property
    def model(self) -> MotionModel:
        """That of the inner observer."""
        return self.inner.model

    @property
    def scale(self) -> Pair:
        """That of the inner observer."""
        return self.inner.scale

    def init(self) -> LyapunovState:
        """That of the inner observer."""
        return self.inner.init()

    def update(self, state: LyapunovState, measured: Pair, force: Pair, clock: Clock) -> LyapunovState:
        """The inner observer's, then the coefficients' move by the energy error, held over the sample."""
        inner = self.inner
        new = inner.update(state, measured, force, clock)
        speed = inner.length * inner.frequency
        velocity = (Vector(measured) - inner.offset) / inner.scale
        level = swing_energy(self.frequency, self.amplitude, (0.0, 0.0))
        excess = (swing_energy(self.frequency, new.motion[:2], velocity) - level) / speed**2
        pushed = self.gain * inner.haste(clock.time) * excess
        driven = (pushed * inner.frequency * clock.period) * (Vector(new.motion[2:]) / speed)
        return LyapunovState(new.motion, adapted(inner, new.theta, (*new.motion, *force), driven))

    def estimate(self, state: LyapunovState) -> Estimate:
        """That of the inner observer."""
        return self.inner.estimate(state)


def swing_energy(frequency: Pair, displacement: Pair, velocity: Pair) -> Scalar:
    """(4.21) per mass [m²/s²], for axes that swing at `frequency` [Hz]."""
    return 0.5 * sum(
        v**2 + (2.0 * jnp.pi * f * q) ** 2 for f, q, v in zip(frequency, displacement, velocity, strict=True)
    )


def check_swing(frequency: Pair, amplitude: Pair) -> None:
    """Raise `InputError` unless these are two frequencies [Hz] and two amplitudes [m] with an energy."""
    for name, pair in (("frequency", frequency), ("amplitude", amplitude)):
        if len(pair) != 2:
            raise InputError(f"Argument `{name}` must be a pair (x, y), but has {len(pair)} entries.")
    for value in frequency:
        check_positive("frequency", value)
    for value in amplitude:
        check_not_negative("amplitude", value)
    check_positive("sum of `amplitude`", amplitude[0] + amplitude[1])
