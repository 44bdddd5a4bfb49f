"""A spring that the bias voltage of the electrodes softens."""

from jaxtyping import Array

from .axes import on_axis
from .base import ForceEffect, Moment, Scalar, strength


class ElectrostaticSoftening(ForceEffect):
    """F = +s·(V² − V_ref²)·q with s in N/(m·V²), V the bias of the record and V_ref the one at which the base stiffness
    holds. Zero: the bias does not matter. Positive: attraction softens. Parallel plates of area A at a gap
    g have s = ε·A/g³.

    Shows as a resonance that falls with the square of the bias; a case with one bias cannot see it.

    Nathanson et al., "The resonant gate transistor", IEEE Trans. Electron Devices 14 (1967) 117.
    """

    name, unit, law = "electrostatic_softening", "N/(m·V²)", "F = +s·(V_bias² − V_ref²)·q"
    reference = "Nathanson et al., IEEE Trans. Electron Devices 14 (1967) 117"
    axis: int | str = on_axis()
    strength: Scalar = strength(sign=+1)

    def force(self, now: Moment) -> Array:
        excess = now.bias_voltage**2 - now.reference_bias**2
        return self.along(now, self.strength * excess * now.displacement[self.axis])
