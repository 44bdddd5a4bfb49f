"""Damping that grows as a gap closes."""

from jaxtyping import Array

from .axes import on_axis
from .base import ForceEffect, Moment, Scalar, strength


class SqueezeFilmDamping(ForceEffect):
    """F = −s·q²·v with s in N·s/m³. Zero: damping does not depend on the place. Positive takes energy.

    The lowest even term of a squeezed film between plates, d·(1 − q²/g²)^(−3/2), where s = 3·d/(2·g²). Shows as a peak
    that grows less than the drive, by an equivalent damping of s·a²/4, quadratic in the amplitude.

    Zaitsev et al., "Nonlinear damping in a micromechanical oscillator", Nonlinear Dynamics 67 (2012) 859; Bao and Yang,
    "Squeeze film air damping in MEMS", Sensors and Actuators A 136 (2007) 3.
    """

    name, unit, law = "squeeze_film_damping", "N·s/m³", "F = −s·q²·v"
    reference = "Zaitsev et al., Nonlinear Dynamics 67 (2012) 859; Bao and Yang, Sens. Actuators A 136 (2007) 3"
    axis: int | str = on_axis()
    strength: Scalar = strength(sign=+1)

    def force(self, now: Moment) -> Array:
        q, v = now.displacement[self.axis], now.velocity[self.axis]
        return self.along(now, -self.strength * q**2 * v)
