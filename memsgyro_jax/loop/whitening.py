"""What a force that nobody knows leaves of a measurement: rows of sensitivities made independent of each other.

A white force that shakes the mass makes the errors of all later samples depend on one another. The Kalman filter of the
shaken motion alone, fed with the sensitivities as if they were measured, predicts of each row what the rows before say
of it; what is left, over the deviation of its innovation, is independent, and the information is the sum of squares
again (T. Kailath, IEEE Trans. Autom. Control 13, 1968: innovations).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from memsgyro_jax.device.gyro import Scalar
from memsgyro_jax.device.small import Matrix, Vector


class Shaken(NamedTuple):
    """Of the motion (x, y, vx, vy) that the force alone makes: covariance, entries (*lanes), and what the rows so far
    say of it for each quantity.
    """

    covariance: tuple[tuple[Scalar, ...], ...]
    motion: tuple[Float[Array, "quantities *lanes"], ...]

    @classmethod
    def still(cls, like: Float[Array, "quantities *lanes"]) -> "Shaken":
        """Nothing has been shaken; `like` has the shape of one entry for each quantity."""
        return cls(((jnp.zeros_like(like[0]),) * 4,) * 4, (jnp.zeros_like(like),) * 4)

    def carried(self, transition: Matrix, added: Matrix) -> "Shaken":
        """A sample later, in which the force has `added` covariance."""
        moved = transition @ Matrix(self.covariance) @ transition.T + added
        return Shaken(tuple(map(tuple, moved)), tuple(transition @ Vector(self.motion)))

    def whitened(self, row: Float[Array, "quantities *lanes"], place: int, gain: Scalar) -> tuple["Shaken", Array]:
        """A row that shows `gain` times entry `place` of the motion, over a noise of one: what is left of it, and what
        it says.
        """
        column = [gain * entry[place] for entry in self.covariance]  # of motion and measurement
        variance = 1.0 + gain * column[place]
        missed = row - gain * self.motion[place]
        rest = tuple(
            tuple(entry - a * b / variance for entry, b in zip(entries, column, strict=True))
            for entries, a in zip(self.covariance, column, strict=True)
        )
        motion = tuple(known + c / variance * missed for known, c in zip(self.motion, column, strict=True))
        return Shaken(rest, motion), missed / jnp.sqrt(variance)
