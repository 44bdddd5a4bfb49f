"""Friction that does not depend on the speed."""

import jax.numpy as jnp
from jaxtyping import Array

from memsgyro_jax.base.arguments import number

from .axes import on_axis
from .base import ForceEffect, Moment, Scalar, strength


class DryFriction(ForceEffect):
    """Coulomb friction, F = −s·sign(v) with s in N. Zero: none. Positive takes energy.

    The sign is smooth: v·R²/(R² + creep²)^(3/2) with R² = v² + (rounding·ω0·q)². The turning points are rounded by the
    part `rounding` of the swing whatever its size, so that some tens of samples of a period resolve them; 0.1 takes
    1.1 % off the work per cycle. Far below `creep` [m/s] the force vanishes, and with it its derivative at rest: the
    mass never sticks, and the linear part of the model stays that of the base device.

    Shows as a peak that grows more than the drive, by an equivalent damping of 4·s/(π·ω·a), and a ring-down that ends
    in finite time.

    Den Hartog, "Forced vibrations with combined Coulomb and viscous friction", Trans. ASME APM-53-9 (1931) 107.
    """

    name, unit, law = "dry_friction", "N", "F = −s·sign(v)"
    reference = "Den Hartog, Trans. ASME APM-53-9 (1931) 107"
    axis: int | str = on_axis()
    strength: Scalar = strength(sign=+1)
    creep: Scalar = number("m/s", default=1e-7)
    rounding: Scalar = number("1", default=0.1)

    def force(self, now: Moment) -> Array:
        q, v = now.displacement[self.axis], now.velocity[self.axis]
        stiffness = now.device.stiffness[self.axis]
        swing = v**2 + self.rounding**2 * stiffness * q**2
        size = swing + self.creep**2
        sign = v * swing / (size * jnp.sqrt(size))
        return self.along(now, -self.strength * sign)
