"""A pick-off that is more sensitive to one side."""

from jaxtyping import Array

from .axes import on_axis
from .base import Moment, ReadoutEffect, Scalar, strength


class PickoffNonlinearity(ReadoutEffect):
    """q → q + s·q² in one channel, with s in 1/m. Zero: the pick-off is linear. A single plate at a gap g has s = 1/g.

    Shows as a mean and a second harmonic in raw records; a lock-in does not see it.

    Trusov and Shkel, "Capacitive detection in resonant MEMS with arbitrary amplitude of motion", J. Micromech.
    Microeng. 17 (2007) 1583.
    """

    name, unit, law = "pickoff_nonlinearity", "1/m", "q → q + s·q²"
    reference = "Trusov and Shkel, J. Micromech. Microeng. 17 (2007) 1583"
    curve = True
    axis: int | str = on_axis()
    strength: Scalar = strength()

    def signal(self, volts: Array, now: Moment) -> Array:
        return volts + now.scale * self.along(now, self.strength * now.seen[self.axis] ** 2)
