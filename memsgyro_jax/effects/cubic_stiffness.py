"""A spring that hardens or softens with the amplitude."""

from jaxtyping import Array

from .axes import on_axis
from .base import ForceEffect, Moment, Scalar, strength


class CubicStiffness(ForceEffect):
    """Duffing spring, F = −s·q³ with s in N/m³. Zero: the spring is linear. Positive hardens, negative softens.

    Shows as a resonance that moves with the square of the amplitude, by 3·s·a²/(8·k) relative to itself, leaning curves
    and, driven hard, jumps. Two drive levels separate it from the linear stiffness.

    Kaajakari et al., "Nonlinear limits for single-crystal silicon microresonators", J. Microelectromech. Syst. 13
    (2004) 715.
    """

    name, unit, law = "cubic_stiffness", "N/m³", "F = −s·q³"
    reference = "Kaajakari et al., J. Microelectromech. Syst. 13 (2004) 715"
    axis: int | str = on_axis()
    strength: Scalar = strength()

    def force(self, now: Moment) -> Array:
        return self.along(now, -self.strength * now.displacement[self.axis] ** 3)
