"""Open-loop drive."""

from memsgyro_jax.device.gyro import Pair

from ..observers.base import Clock, Estimate
from .base import AbstractLinearController, GivenTones, tone_values, tones_field


class OpenLoop(AbstractLinearController):
    """Forces that ignore the estimate: `tones` per axis, in N; without tones the device swings down freely."""

    tones: GivenTones = tones_field()

    def command(self, state: tuple[()], estimate: Estimate, clock: Clock) -> tuple[Pair, tuple[()]]:
        """The tones in the middle of the coming sample, over which they are held."""
        middle = clock.time + 0.5 * clock.period
        return tuple(tone + 0.0 * estimate.motion[0] for tone in tone_values(self.tones, middle)), state
