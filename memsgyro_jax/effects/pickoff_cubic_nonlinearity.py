"""A pick-off whose sensitivity changes with the amplitude."""

from jaxtyping import Array

from .axes import on_axis
from .base import Moment, ReadoutEffect, Scalar, strength


class PickoffCubicNonlinearity(ReadoutEffect):
    """q → q + s·q³ in one channel, with s in 1/m². Zero: the pick-off is linear. A pair of opposite plates at a gap g
    has s = 1/g².

    Shows as an amplitude that is wrong by 3·s·a²/4 relative to itself while the resonance stays where it is: that tells
    it from a cubic stiffness.

    Trusov and Shkel, "Capacitive detection in resonant MEMS with arbitrary amplitude of motion", J. Micromech.
    Microeng. 17 (2007) 1583.
    """

    name, unit, law = "pickoff_cubic_nonlinearity", "1/m²", "q → q + s·q³"
    reference = "Trusov and Shkel, J. Micromech. Microeng. 17 (2007) 1583"
    curve = True
    axis: int | str = on_axis()
    strength: Scalar = strength()

    def signal(self, volts: Array, now: Moment) -> Array:
        return volts + now.scale * self.along(now, self.strength * now.seen[self.axis] ** 3)
