"""The share of dies that miss a tolerance, made smooth."""

import jax
import jax.numpy as jnp

from memsgyro_jax.device.gyro import Scalar, check_positive, number

from .base import AbstractLoss, rate_error


class OutOfTolerance(AbstractLoss[Scalar]):
    """1 for a die whose rate error at the end of the run is far beyond ±`tolerance` [rad/s], 0 for one well within.

    Its mean over the dies is 1 less the yield, with the edge drawn out to a logistic curve of relative width
    `softness`, so that dies near the edge pull: what a design is centred by.
    """

    tolerance: Scalar = number()
    softness: Scalar = number(default=0.2)

    def __check_init__(self):
        check_positive("tolerance", self.tolerance)
        check_positive("softness", self.softness)

    def init(self):
        """No error yet."""
        return jnp.zeros(())

    def sample(self, memory, sample):
        """Only the last one counts."""
        return rate_error(sample) + 0.0 * memory

    def value(self, memory):
        """How much the die counts as missing the tolerance."""
        # √(e² + small²) for |e|: smooth where the error passes zero, which changes nothing out at the tolerance.
        size = jnp.sqrt(memory**2 + (1e-3 * self.tolerance) ** 2)
        return jax.nn.sigmoid((size / self.tolerance - 1.0) / self.softness)
