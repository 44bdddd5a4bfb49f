"""Whole-angle control: the mass vibrates freely and the frame turns beneath it (thesis 6.1.1)."""

from typing import Any

import jax.numpy as jnp

from memsgyro_jax.device.gyro import Pair, Scalar, check_positive, number
from memsgyro_jax.device.propagate import State4, once
from memsgyro_jax.device.small import Matrix, Vector, identity

from ..observers.base import Clock, Estimate
from .base import AbstractController, GivenTones, Tone, tone_values, tones_field


class WholeAngle(AbstractController[tuple[()]]):
    """Makes both axes oscillators of one `frequency` [Hz] without damping and leaves the Coriolis force alone, (6.1)
    and, with y's velocity multiplying d_yy, (6.2): `force = (K q + D v - ω² q + η) / gain`.

    The vibration then stays in inertial space and its angle is that of the frame (`vibration_angle`). `tones` are the
    auxiliary accelerations η in m/s²; without them a gyro at rest tells little of its coefficients.

    `rocking`, in rad, turns the vibration to and fro by a known angle, through the forces of a frame that turns so:
    what the estimated damping and stiffness are off then acts in turn along and across the motion. At an amplitude of
    1.2024 rad, half the first zero of J₀, its mean effect on the angle vanishes, and no motion keeps a wrong cross
    damping and a rate alike. None, and an amplitude of zero, leave the vibration alone.

    The force is held over a sample. It is computed for the middle of the sample, for as much more as a held sine is
    weaker, and for velocities that the ripple of a held stiffness has displaced at the samples: what is left at 100 kHz
    of a stiffness a third off is 0.01 rad/s of detuning and 0.003 1/s of damping.
    """

    frequency: Scalar = number("Hz")
    tones: GivenTones = tones_field()
    rocking: Tone | None = None

    def __check_init__(self):
        check_positive("frequency", self.frequency)

    def init(self) -> tuple[()]:
        """Nothing to remember."""
        return ()

    def command(self, state: tuple[()], estimate: Estimate, clock: Clock) -> tuple[Pair, tuple[()]]:
        """Cancel estimated stiffness and damping, put the one stiffness in their place, and rock."""
        dynamics, omega, period = estimate.dynamics, 2.0 * jnp.pi * self.frequency, clock.period
        middle, half = clock.time + 0.5 * period, 0.5 * omega * period
        excess = dynamics.stiffness + Matrix(identity(2)) * (-(omega**2))
        motion, velocity = estimate.motion, Vector(estimate.motion[2:])
        rippled = velocity + (period**2 / 12.0) * (excess @ velocity)
        motion = (*motion[:2], *rippled)
        rocking: Any = once(middle, self._rocked(middle))
        _, rate, spin = rocking
        turning = estimate.rate + rate
        x, y, vx, vy = in_turned_frame(motion, 0.0, -turning)
        c, s = jnp.cos(half), jnp.sin(half)
        ahead = (c * x + s * vx / omega, c * y + s * vy / omega, c * vx - s * omega * x, c * vy - s * omega * y)
        x, y, vx, vy = in_turned_frame(ahead, 0.5 * turning * period, turning)
        rocked = Vector((2.0 * rate * vy + spin * y + rate**2 * x, -2.0 * rate * vx - spin * x + rate**2 * y))
        wanted = excess @ (x, y) + dynamics.damping @ (vx, vy) + rocked
        force = (half / s) * wanted + tone_values(self.tones, middle)
        return tuple(force / dynamics.gain), state

    def unrocked(self, motion: State4, time: Scalar) -> State4:
        """The motion (x, y, vx, vy) at `time` [s] as it would be without `rocking`."""
        angle, rate, _ = self._rocked(time)
        return in_turned_frame(motion, -angle, -rate)

    def _rocked(self, time: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """Angle, rate and angular acceleration of the frame that the rocking imitates."""
        if self.rocking is None:
            return 0.0, 0.0, 0.0
        tone = self.rocking
        omega, phase = 2.0 * jnp.pi * tone.frequency, 2.0 * jnp.pi * tone.frequency * time + tone.phase
        angle = tone.amplitude * jnp.sin(phase)
        return angle, omega * tone.amplitude * jnp.cos(phase), -(omega**2) * angle


def in_turned_frame(motion: State4, angle: Scalar, rate: Scalar) -> State4:
    """A motion (x, y, vx, vy) as seen from a frame turned by `angle` [rad] that turns at `rate` [rad/s]."""
    x, y, vx, vy = motion
    u, v, c, s = vx + rate * y, vy - rate * x, jnp.cos(angle), jnp.sin(angle)
    return c * x + s * y, c * y - s * x, c * u + s * v, c * v - s * u
