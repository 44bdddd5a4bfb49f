"""Drag that grows with the square of the speed."""

import jax.numpy as jnp
from jaxtyping import Array

from .axes import on_axis
from .base import ForceEffect, Moment, Scalar, strength


class QuadraticDamping(ForceEffect):
    """Drag, F = −s·|v|·v with s in N·s²/m². Zero: drag is viscous only. Positive takes energy.

    Shows as a peak that grows less than the drive, by an equivalent damping of 8·s·ω·a/(3π), linear in the amplitude.

    Nayfeh and Mook, Nonlinear Oscillations, Wiley 1979, chapter 3.
    """

    name, unit, law = "quadratic_damping", "N·s²/m²", "F = −s·|v|·v"
    reference = "Nayfeh and Mook, Nonlinear Oscillations, 1979, chapter 3"
    axis: int | str = on_axis()
    strength: Scalar = strength(sign=+1)

    def force(self, now: Moment) -> Array:
        v = now.velocity[self.axis]
        return self.along(now, -self.strength * jnp.abs(v) * v)
