"""Electrodes that also push along the other axis."""

from jaxtyping import Array

from .axes import Coupling, on_axis
from .base import DriveEffect, Moment, Scalar, strength


class ForceMisalignment(Coupling, DriveEffect):
    """u_target → u_target + s·u_source, s the tangent of an angle up to 45°. Zero: electrodes are aligned.

    Shows as motion of the undriven axis in phase with the drive, at every frequency.

    Shkel et al., "Dynamics and control of micromachined gyroscopes", Proc. American Control Conference (1999) 2119.
    """

    name, unit, law = "force_misalignment", "1", "u_target → u_target + s·u_source"
    reference = "Shkel et al., Proc. American Control Conference (1999) 2119"
    last = True
    source: int | str = on_axis("x")
    target: int | str = on_axis("y")
    strength: Scalar = strength(low=-1.0, high=1.0)

    def applied(self, command: Array, now: Moment) -> Array:
        return command + self.strength * self.across(now, now.force)
