"""Stiffness and damping that change with the temperature."""

from jaxtyping import Array

from .base import ForceEffect, Moment, Scalar, strength


def _spring(now: Moment, part: Array) -> Array:
    """Force of so much more stiffness, of itself."""
    device = now.device
    return -part * device.stiffness[: now.displacement.shape[0]] * now.displacement / device.mobility


def _damper(now: Moment, part: Array) -> Array:
    """Force of so much more damping, of itself."""
    device = now.device
    return -part * device.damping[: now.displacement.shape[0]] * now.velocity / device.mobility


class ThermalStiffness(ForceEffect):
    """k_xx and k_yy times 1 + s·ΔT with s in 1/K and ΔT the temperature above the reference; the coupling, a matter of
    angles, stays. Zero: none depends on it.

    Shows as a resonance that moves by s·ΔT/2 relative to itself; silicon has about −6e-5/K. A case with one temperature
    cannot see it.

    Hopcroft, Nix and Kenny, "What is the Young's modulus of silicon?", J. Microelectromech. Syst. 19 (2010) 229.
    """

    name, unit, law = "thermal_drift", "1/K", "k_xx and k_yy · (1 + s·ΔT)"
    reference = "Hopcroft, Nix and Kenny, J. Microelectromech. Syst. 19 (2010) 229"
    strength: Scalar = strength()

    @property
    def where(self) -> str:
        """What drifts."""
        return "stiffness"

    def force(self, now: Moment) -> Array:
        return _spring(now, self.strength * now.warming)


class ThermalDamping(ForceEffect):
    """d_xx and d_yy times 1 + s·ΔT with s in 1/K and ΔT the temperature above the reference. Zero: none depends on it.

    Shows as a width of the resonance that changes with the temperature: gas grows more viscous, thermoelastic loss
    shifts. A case with one temperature cannot see it.

    Kim et al., "Temperature dependence of quality factor in MEMS resonators", J. Microelectromech. Syst. 17 (2008) 755.
    """

    name, unit, law = "thermal_drift", "1/K", "d_xx and d_yy · (1 + s·ΔT)"
    reference = "Kim et al., J. Microelectromech. Syst. 17 (2008) 755"
    strength: Scalar = strength()

    @property
    def where(self) -> str:
        """What drifts."""
        return "damping"

    def force(self, now: Moment) -> Array:
        return _damper(now, self.strength * now.warming)


class ThermalStiffnessCurvature(ForceEffect):
    """k_xx and k_yy gain s·ΔT² of themselves, with s in 1/K² and ΔT the temperature above the reference, beside what
    goes with ΔT. Zero: they go straight.

    Shows as a resonance whose course with the temperature bends, by s·ΔT²/2 relative to itself: the parabola of a
    quartz fork, or what doping leaves of silicon's drift. A case with fewer than three temperatures cannot see it.

    Jaakkola et al., "Determination of doping and temperature-dependent elastic constants of degenerately doped silicon
    from MEMS resonators", IEEE Trans. Ultrason. Ferroelectr. Freq. Control 61 (2014) 1063.
    """

    name, unit, law = "thermal_curvature", "1/K²", "k_xx and k_yy · (1 + s·ΔT²)"
    reference = "Jaakkola et al., IEEE Trans. Ultrason. Ferroelectr. Freq. Control 61 (2014) 1063"
    strength: Scalar = strength()

    @property
    def where(self) -> str:
        """What bends."""
        return "stiffness"

    def force(self, now: Moment) -> Array:
        return _spring(now, self.strength * now.warming**2)


class ThermalDampingCurvature(ForceEffect):
    """d_xx and d_yy gain s·ΔT² of themselves, with s in 1/K² and ΔT the temperature above the reference, beside what
    goes with ΔT. Zero: they go straight.

    Shows as a width of the resonance whose course with the temperature bends: thermoelastic loss goes with a power of
    the absolute temperature. A case with fewer than three temperatures cannot see it.

    Kim et al., "Temperature dependence of quality factor in MEMS resonators", J. Microelectromech. Syst. 17 (2008) 755.
    """

    name, unit, law = "thermal_curvature", "1/K²", "d_xx and d_yy · (1 + s·ΔT²)"
    reference = "Kim et al., J. Microelectromech. Syst. 17 (2008) 755"
    strength: Scalar = strength()

    @property
    def where(self) -> str:
        """What bends."""
        return "damping"

    def force(self, now: Moment) -> Array:
        return _damper(now, self.strength * now.warming**2)
