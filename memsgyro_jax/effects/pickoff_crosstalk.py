"""A channel that also sees the other axis."""

from jaxtyping import Array

from .axes import Coupling, on_axis
from .base import Moment, ReadoutEffect, Scalar, strength


class PickoffCrosstalk(Coupling, ReadoutEffect):
    """V_target → V_target + s·scale_target·q_source, s a pure number (the tangent of an angle up to 45°). Zero:
    channels see their own axis only.

    Shows as the resonance of the driven axis in the other channel, also during a ring-down.

    Weinberg and Kourepenis, "Error sources in in-plane silicon tuning-fork MEMS gyroscopes", J. Microelectromech. Syst.
    15 (2006) 479.
    """

    name, unit, law = "pickoff_crosstalk", "1", "V_target → V_target + s·scale·q_source"
    reference = "Weinberg and Kourepenis, J. Microelectromech. Syst. 15 (2006) 479"
    source: int | str = on_axis("x")
    target: int | str = on_axis("y")
    strength: Scalar = strength(low=-1.0, high=1.0)

    def signal(self, volts: Array, now: Moment) -> Array:
        return volts + self.strength * now.scale * self.across(now, now.seen)
