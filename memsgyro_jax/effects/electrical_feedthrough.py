"""Drive voltage that leaks into the read-out."""

from typing import ClassVar

from jaxtyping import Array

from .axes import Coupling, on_axis
from .base import Moment, ReadoutEffect, Scalar, strength


class ElectricalFeedthrough(Coupling, ReadoutEffect):
    """V_target → V_target + s·u_source with s in V/N: from the drive electrode of one axis into the channel of an axis.
    Zero: no leak.

    Shows as a constant phasor under the resonance, in proportion to the drive; it stops at once when the drive does, so
    that a ring-down is free of it.

    Lee and Seshia, "Parasitic feedthrough cancellation techniques for enhanced electrical characterization of
    electrostatic microresonators", Sensors and Actuators A 156 (2009) 36.
    """

    name, unit, law = "electrical_feedthrough", "V/N", "V_channel → V_channel + s·u_drive"
    reference = "Lee and Seshia, Sens. Actuators A 156 (2009) 36"
    straight: ClassVar[bool] = True
    source: int | str = on_axis("x")
    target: int | str = on_axis("x")
    strength: Scalar = strength()

    def signal(self, volts: Array, now: Moment) -> Array:
        return volts + self.strength * self.across(now, now.command)
