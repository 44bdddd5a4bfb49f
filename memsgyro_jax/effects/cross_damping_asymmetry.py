"""Cross damping that is not the same both ways."""

from jaxtyping import Array

from .axes import Planar, turned
from .base import ForceEffect, Moment, Scalar, strength


class CrossDampingAsymmetry(Planar, ForceEffect):
    """F_x = −s/2·y', F_y = +s/2·x' with s = d_xy − d_yx in N·s/m; the base model holds their mean. Zero: they are
    equal.

    Shows as a response of the undriven axis in phase with the velocity of the driven one. It does no work and looks
    exactly like a rate of −s/(4·m): only a calibrated rate reference tells it from `rate_offset`.

    IEEE Std 1431-2004, Coriolis vibratory gyros, annex B.
    """

    name, unit, law = "cross_damping_asymmetry", "N·s/m", "F_x = −s/2·y', F_y = +s/2·x'"
    reference = "IEEE Std 1431-2004"
    strength: Scalar = strength()

    def force(self, now: Moment) -> Array:
        return -0.5 * self.strength * turned(now.velocity)
