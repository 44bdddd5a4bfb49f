"""A pick-off that is more or less sensitive than declared."""

from jaxtyping import Array

from .axes import on_axis
from .base import Moment, ReadoutEffect, Scalar, strength


class PickoffScaleError(ReadoutEffect):
    """q → (1 + s)·q in one channel, s a pure number above −1: an inverted channel is a matter of
    conventions. Zero: the declared scale is right.

    Shows as an amplitude that is wrong by the same part everywhere. On one axis alone the mass takes it; two axes and a
    rate tell it apart.

    IEEE Std 1431-2004, Coriolis vibratory gyros.
    """

    name, unit, law = "pickoff_scale_error", "1", "q → (1 + s)·q"
    reference = "IEEE Std 1431-2004"
    curve = True
    axis: int | str = on_axis()
    strength: Scalar = strength(low=-1.0)

    def signal(self, volts: Array, now: Moment) -> Array:
        return volts + now.scale * self.along(now, self.strength * now.seen[self.axis])
