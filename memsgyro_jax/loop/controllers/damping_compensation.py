"""Damping compensation (thesis 4.2.3)."""

from memsgyro_jax.device.gyro import Pair

from ..observers.base import Clock, Estimate
from .base import AbstractLinearController, GivenTones, tone_values, tones_field


class DampingCompensation(AbstractLinearController):
    """Cancels the estimated damping, so that the mass swings on freely: `force = (D v + η) / gain`, (4.27) and (4.28).

    `tones` are the auxiliary signals η, accelerations in m/s²; they are what makes the mass observable. The 53.95 of
    the thesis, printed as volts, is an acceleration.
    """

    tones: GivenTones = tones_field()

    def command(self, state: tuple[()], estimate: Estimate, clock: Clock) -> tuple[Pair, tuple[()]]:
        """The force at the present estimate."""
        dynamics, velocity = estimate.dynamics, estimate.motion[2:]
        force = (dynamics.damping @ velocity + tone_values(self.tones, clock.time)) / dynamics.gain
        return tuple(force), state
