"""A sweep that does not wait."""

from jaxtyping import Array

from .base import Scalar, SweepEffect, strength


class FiniteSweepRate(SweepEffect):
    """The drive frequency moves at s rad/s per second, the way its rows go, while it is recorded. Zero: every point is
    settled.

    Shows as a peak that is late, lower and followed by a beat, and that lies on the other side when the sweep is run
    backwards.

    Lewis, "Vibration during acceleration through a critical speed", Trans. ASME 54 (1932) 253.
    """

    name, unit, law = "finite_sweep_rate", "rad/s²", "dω/dt = s while a sweep is recorded"
    reference = "Lewis, Trans. ASME 54 (1932) 253"
    strength: Scalar = strength(sign=+1)

    def speed(self) -> Array:
        return self.strength
