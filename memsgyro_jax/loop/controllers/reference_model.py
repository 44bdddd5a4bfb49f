"""Reference-model control (thesis 4.2.1)."""

import jax.numpy as jnp

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Pair, Scalar, check_positive
from memsgyro_jax.device.propagate import State4
from memsgyro_jax.device.small import Vector

from ..observers.base import Clock, Estimate
from ..observers.settings import arrays
from .base import AbstractLinearController, GivenTones, tone_values, tones_field


class ReferenceModel(AbstractLinearController):
    """Makes each axis an undamped oscillator of its own frequency, (4.17) and (4.18), with y's velocity multiplying
    d_yy.

    `frequency` [Hz] of x and y; they must differ for the coefficients to be observable. `tones` are auxiliary
    accelerations in m/s². The command acts for the coming sample, so it is computed for the motion half a sample ahead,
    where the reference model itself will have carried it: a stiffness fed back one sample late is unstable at 100 kHz.
    """

    frequency: Pair = arrays("Hz")
    tones: GivenTones = tones_field()

    def __check_init__(self):
        if len(self.frequency) != 2:
            raise InputError(
                f"Argument `frequency` must be a pair (x, y) in Hz, but has {len(self.frequency)} entries."
            )
        for value in self.frequency:
            check_positive("frequency", value)

    @property
    def frequencies(self) -> tuple[Scalar, ...]:
        """Those of the reference model."""
        return self.frequency

    def command(self, state: tuple[()], estimate: Estimate, clock: Clock) -> tuple[Pair, tuple[()]]:
        """Cancel estimated stiffness, damping and Coriolis forces, and put the reference stiffness in their place."""
        dynamics = estimate.dynamics
        omega = tuple(2.0 * jnp.pi * f for f in self.frequency)
        ahead = self._ahead(estimate.motion, omega, 0.5 * clock.period)
        displacement, velocity = ahead[:2], ahead[2:]
        added = tone_values(self.tones, clock.time + 0.5 * clock.period)
        cancelled = dynamics.stiffness @ displacement + dynamics.velocity @ velocity
        wanted = Vector(w**2 * q for w, q in zip(omega, displacement, strict=True))
        return tuple((cancelled - wanted + added) / dynamics.gain), state

    def _ahead(self, motion: State4, omega: Pair, lead: Scalar) -> State4:
        x, y, vx, vy = motion
        (wx, wy), (cx, cy), (sx, sy) = omega, *(tuple(f(w * lead) for w in omega) for f in (jnp.cos, jnp.sin))
        return x * cx + vx * sx / wx, y * cy + vy * sy / wy, vx * cx - x * wx * sx, vy * cy - y * wy * sy
