"""A spring that is stiffer to one side."""

from jaxtyping import Array

from .axes import on_axis
from .base import ForceEffect, Moment, Scalar, strength


class QuadraticStiffness(ForceEffect):
    """Asymmetric spring, F = −s·q² with s in N/m². Zero: equally stiff to both sides.

    Shows as a mean displacement and a second harmonic in raw records, and as a softening with the square of the
    amplitude, by −5·s²·a²/(12·k²), whatever its sign: a lock-in sees no first-order trace of it.

    Kaajakari et al., "Nonlinear limits for single-crystal silicon microresonators", J. Microelectromech. Syst. 13
    (2004) 715.
    """

    name, unit, law = "quadratic_stiffness", "N/m²", "F = −s·q²"
    reference = "Kaajakari et al., J. Microelectromech. Syst. 13 (2004) 715"
    axis: int | str = on_axis()
    strength: Scalar = strength()

    def force(self, now: Moment) -> Array:
        return self.along(now, -self.strength * now.displacement[self.axis] ** 2)
