"""The centrifugal force."""

from jaxtyping import Array

from .base import ForceEffect, Moment, Scalar, strength


class Centrifugal(ForceEffect):
    """F = +s·m·Ω²·q, s a pure number. Zero: left out, as in the base model; physics says one, and a fit
    stays within 0 and 2.

    Shows as a resonance that falls by s·Ω²/(2·ω0²) relative to itself: below 1e-6 for a gyro of 20 kHz at any rate of
    a rate table.

    Goldstein, Classical Mechanics, section 4.10.
    """

    name, unit, law = "centrifugal", "1", "F = +s·m·Ω²·q; physics says 1"
    reference = "Goldstein, Classical Mechanics, section 4.10"
    strength: Scalar = strength(sign=+1, high=2.0)

    def force(self, now: Moment) -> Array:
        return self.strength * now.rate**2 / now.device.mobility * now.displacement
