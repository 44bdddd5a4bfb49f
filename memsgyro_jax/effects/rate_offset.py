"""A rate that the table does not report."""

from jaxtyping import Array

from .axes import Planar, coriolis
from .base import ForceEffect, Moment, Scalar, strength


class RateOffset(Planar, ForceEffect):
    """Ω → Ω + s with s in rad/s, in every record whose rate reference is not calibrated. Zero: the table tells the
    truth.

    Shows as a response of the undriven axis at zero rate, in phase with the velocity of the driven one. Without a
    calibrated record it cannot be told from unequal cross damping.

    IEEE Std 1431-2004, Coriolis vibratory gyros, bias.
    """

    name, unit, law = "rate_offset", "rad/s", "Ω → Ω + s where the rate is not calibrated"
    reference = "IEEE Std 1431-2004, bias"
    strength: Scalar = strength()

    def force(self, now: Moment) -> Array:
        return coriolis(now, self.strength * (1.0 - now.rate_trusted))
