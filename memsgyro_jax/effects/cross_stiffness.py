"""A mode whose stiffness depends on the amplitude of the other."""

from jaxtyping import Array

from .axes import Planar
from .base import ForceEffect, Moment, Scalar, strength


class CrossStiffness(Planar, ForceEffect):
    """Dispersive coupling by the potential s·x²·y²/2: F_x = −s·x·y², F_y = −s·x²·y with s in N/m³. Zero: the modes do
    not tune each other.

    Shows as a resonance of one axis that moves with the amplitude of the other: in records where both move.

    Westra et al., "Nonlinear modal interactions in clamped-clamped mechanical resonators", Phys. Rev. Lett. 105 (2010)
    117205.
    """

    name, unit, law = "cross_stiffness", "N/m³", "F_x = −s·x·y², F_y = −s·x²·y"
    reference = "Westra et al., Phys. Rev. Lett. 105 (2010) 117205"
    strength: Scalar = strength()

    def force(self, now: Moment) -> Array:
        q = now.displacement
        return -self.strength * q * q[::-1] ** 2
