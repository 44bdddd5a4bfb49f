"""Electronics that change with the temperature: what the pick-off shows, how late, and what the electrodes give."""

from jaxtyping import Array

from .base import DriveEffect, Moment, ReadoutEffect, Scalar, SurroundingsEffect, strength
from .readout_delay import LateEffect


class ThermalGain(ReadoutEffect):
    """All voltages times 1 + s·ΔT with s in 1/K and ΔT the temperature above the reference. Zero: the gain stays.

    Shows as a swing that a gain control holds at another amplitude, and as a scale factor that moves by s·ΔT.

    Weinberg and Kourepenis, "Error sources in in-plane silicon tuning-fork MEMS gyroscopes", J. Microelectromech. Syst.
    15 (2006) 479.
    """

    name, unit, law = "thermal_drift", "1/K", "V · (1 + s·ΔT)"
    reference = "Weinberg and Kourepenis, J. Microelectromech. Syst. 15 (2006) 479"
    strength: Scalar = strength()

    @property
    def where(self) -> str:
        """What drifts."""
        return "pickoff_gain"

    def signal(self, volts: Array, now: Moment) -> Array:
        return volts * (1.0 + self.strength * now.warming)


class ThermalDelay(LateEffect):
    """V(t) of q(t − s·ΔT) on every channel, with s in s/K. Zero: the delay stays.

    Shows as a phase of the demodulation that turns with the temperature, and so as quadrature that leaks into the
    zero-rate output by ω·s·ΔT of itself.

    Weinberg and Kourepenis, "Error sources in in-plane silicon tuning-fork MEMS gyroscopes", J. Microelectromech. Syst.
    15 (2006) 479.
    """

    name, unit, law = "thermal_drift", "s/K", "V(t) of q(t − s·ΔT)"
    reference = "Weinberg and Kourepenis, J. Microelectromech. Syst. 15 (2006) 479"
    strength: Scalar = strength()

    @property
    def where(self) -> str:
        """What drifts."""
        return "pickoff_delay"

    def late(self, now: Moment) -> Array:
        return self.strength * now.warming


class ThermalDrive(DriveEffect):
    """Applied force = command · (1 + s·ΔT) with s in 1/K. Zero: the electrodes give what is asked for.

    Shows as a scale factor of a rebalanced axis that moves by −s·ΔT; a gain control hides it on the drive axis.

    Weinberg and Kourepenis, "Error sources in in-plane silicon tuning-fork MEMS gyroscopes", J. Microelectromech. Syst.
    15 (2006) 479.
    """

    name, unit, law = "thermal_drift", "1/K", "F = u · (1 + s·ΔT)"
    reference = "Weinberg and Kourepenis, J. Microelectromech. Syst. 15 (2006) 479"
    strength: Scalar = strength()

    @property
    def where(self) -> str:
        """What drifts."""
        return "drive_gain"

    def applied(self, command: Array, now: Moment) -> Array:
        return command * (1.0 + self.strength * now.warming)


class ThermalBias(SurroundingsEffect):
    """Bias voltage of the electrodes times 1 + s·ΔT with s in 1/K, as `electrostatic_softening` sees it. Zero: the
    voltage is that of the scenario.

    Shows as the mode split of a device that is matched by a bias: it opens as the voltage drifts.

    Weinberg and Kourepenis, "Error sources in in-plane silicon tuning-fork MEMS gyroscopes", J. Microelectromech. Syst.
    15 (2006) 479.
    """

    name, unit, law = "thermal_drift", "1/K", "V_bias · (1 + s·ΔT)"
    reference = "Weinberg and Kourepenis, J. Microelectromech. Syst. 15 (2006) 479"
    strength: Scalar = strength()

    @property
    def where(self) -> str:
        """What drifts."""
        return "bias_voltage"

    def more_volts(self, now: Moment) -> Array:
        return self.strength * now.warming * now.bias_voltage
