"""A prescribed motion, by forces computed from the estimate."""

import jax.numpy as jnp

from memsgyro_jax.device.gyro import Pair, Scalar, check_not_negative, number
from memsgyro_jax.device.small import Vector

from ..observers.base import Clock, Estimate
from .base import AbstractLinearController, GivenTones, Tone, swing, tones_field


class DesignedMotion(AbstractLinearController):
    """Keeps the displacement r of each axis a sum of `tones`, in m: `force = (r'' + C r' + K r + s (r' - v)) / gain`.

    Stiffness K, damping with Coriolis C, gain and velocity v are the estimate's, r is the design. `settling` s [1/s]
    lets what else the mass does die away as exp(-s t/2); zero feeds nothing of the motion back and leaves that to the
    damping of the device. Forces are held over samples; each tone is raised by the (ωh/2)/sin(ωh/2) that holding takes
    away.
    """

    tones: GivenTones = tones_field()
    settling: Scalar = number(default=1000.0)

    def __check_init__(self):
        check_not_negative("settling", self.settling)

    def command(self, state: tuple[()], estimate: Estimate, clock: Clock) -> tuple[Pair, tuple[()]]:
        """The force in the middle of the coming sample, over which it is held."""
        time, dynamics = clock.time + 0.5 * clock.period, estimate.dynamics
        parts = [[_held(tone, time, clock.period) for tone in axis] for axis in self.tones]
        place, speed, push = (tuple(sum((p[i] for p in axis), 0.0) for axis in parts) for i in range(3))
        now = Vector(swing(self.tones, clock.time)[1])
        behind = self.settling * (now - estimate.motion[2:])
        return tuple((dynamics.stiffness @ place + dynamics.velocity @ speed + push + behind) / dynamics.gain), state


def _held(tone: Tone, time: Scalar, period: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Displacement, velocity and acceleration of a tone, as holding needs them."""
    omega = 2.0 * jnp.pi * tone.frequency
    angle, half = omega * time + tone.phase, 0.5 * omega * period
    size = tone.amplitude * half / jnp.sin(half)
    place = size * jnp.sin(angle)
    return place, size * omega * jnp.cos(angle), -(omega**2) * place
