"""The Euler force of a rate that changes."""

from jaxtyping import Array

from .axes import Planar, turned
from .base import ForceEffect, Moment, Scalar, strength


class AngularAcceleration(Planar, ForceEffect):
    """F_x = +s·m·Ω'·y, F_y = −s·m·Ω'·x, s a pure number. Zero: left out, as in the base model; physics says one, and a
    fit stays within 0 and 2.

    Shows in records with a fast changing rate, in phase with the displacement of the driven axis.

    Goldstein, Classical Mechanics, section 4.10.
    """

    name, unit, law = "angular_acceleration", "1", "F_x = +s·m·Ω'·y, F_y = −s·m·Ω'·x; physics says 1"
    reference = "Goldstein, Classical Mechanics, section 4.10"
    strength: Scalar = strength(sign=+1, high=2.0)

    def force(self, now: Moment) -> Array:
        return self.strength * now.angular_acceleration * now.device.mass(1) * turned(now.displacement)
