"""Electrodes whose force is not proportional to the command."""

from jaxtyping import Array

from .axes import on_axis
from .base import DriveEffect, Moment, Scalar, strength


class DriveNonlinearity(DriveEffect):
    """u → u + s·u² with s in 1/N. Zero: force follows the command.

    A comb between a bias V and a signal ±v pulls with (V + v)²: without the opposite comb the square of the signal
    remains. Shows as a mean and a second harmonic of the force; near resonance, in raw records with several tones.

    Tang et al., "Electrostatic-comb drive of lateral polysilicon resonators", Sensors and Actuators A 21 (1990) 328.
    """

    name, unit, law = "drive_nonlinearity", "1/N", "u → u + s·u²"
    reference = "Tang et al., Sens. Actuators A 21 (1990) 328"
    axis: int | str = on_axis()
    strength: Scalar = strength()

    def applied(self, command: Array, now: Moment) -> Array:
        return command + self.along(now, self.strength * command[self.axis] ** 2)
