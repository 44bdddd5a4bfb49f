"""A spring of the electrodes that softens with the amplitude, the more the higher their bias voltage is."""

from jaxtyping import Array

from .axes import on_axis
from .base import ForceEffect, Moment, Scalar, strength


class ElectrostaticCubicStiffness(ForceEffect):
    """F = +s·V²·q³ with s in N/(m³·V²), V the bias of the record. Zero: what the electrodes pull goes with the
    displacement alone. Positive: attraction softens, the more the farther the mass is out. Parallel plates of area A at
    a gap g have s = 2·ε·A/g⁵, that is 2/g² times their `electrostatic_softening`.

    Shows as a resonance that leans to lower frequencies by a part that grows with the square of the bias, by
    3·s·V²·a²/(8·k) relative to itself; a case with one bias cannot tell it from a negative `cubic_stiffness`.

    Agarwal et al., "A study of electrostatic force nonlinearities in resonant microstructures", Appl. Phys. Lett. 92
    (2008) 104106.
    """

    name, unit, law = "electrostatic_cubic_stiffness", "N/(m³·V²)", "F = +s·V_bias²·q³"
    reference = "Agarwal et al., Appl. Phys. Lett. 92 (2008) 104106"
    axis: int | str = on_axis()
    strength: Scalar = strength(sign=+1)

    def force(self, now: Moment) -> Array:
        return self.along(now, self.strength * now.bias_voltage**2 * now.displacement[self.axis] ** 3)
