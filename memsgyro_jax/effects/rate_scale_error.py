"""A rate that is proportional to what the table reports, but not equal."""

from jaxtyping import Array

from .axes import Planar, coriolis
from .base import ForceEffect, Moment, Scalar, strength


class RateScaleError(Planar, ForceEffect):
    """Ω → Ω·(1 + s), s a pure number above −1. Zero: the table's scale is right. Also an angular gain of the device
    below or above one.

    Shows as a response to rate that is too large or too small by the same part at every rate.

    IEEE Std 1431-2004, Coriolis vibratory gyros, scale factor error.
    """

    name, unit, law = "rate_scale_error", "1", "Ω → Ω·(1 + s)"
    reference = "IEEE Std 1431-2004, scale factor error"
    strength: Scalar = strength(low=-1.0)

    def force(self, now: Moment) -> Array:
        return coriolis(now, self.strength * now.rate)
