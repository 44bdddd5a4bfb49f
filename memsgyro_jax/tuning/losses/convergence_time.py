"""Time that a die needs to come within a tolerance, made smooth."""

import jax
import jax.numpy as jnp

from memsgyro_jax.device.gyro import Scalar, check_not_negative, check_positive, number

from .base import AbstractLoss, rate_error


class ConvergenceTime(AbstractLoss[Scalar]):
    """Time in s that the rate spends outside ±`tolerance` [rad/s], from `settle` [s] on.

    For a die that comes in once and stays this is the time to converge; each later excursion adds its length. The edge
    is a logistic curve of relative width `softness`, so that the tolerance has a derivative.
    """

    tolerance: Scalar = number()
    softness: Scalar = number(default=0.1)
    settle: Scalar = number(default=0.0)

    def __check_init__(self):
        check_positive("tolerance", self.tolerance)
        check_positive("softness", self.softness)
        check_not_negative("settle", self.settle)

    def init(self):
        """No time."""
        return jnp.zeros(())

    def sample(self, memory, sample):
        """Add the share of the sample that counts as outside."""
        # √(e² + small²) for |e|: smooth where the error passes zero, which changes nothing out at the tolerance.
        size = jnp.sqrt(rate_error(sample) ** 2 + (1e-3 * self.tolerance) ** 2)
        outside = jax.nn.sigmoid((size / self.tolerance - 1.0) / self.softness)
        return memory + jnp.where(sample.clock.time >= self.settle, sample.clock.period * outside, 0.0)

    def value(self, memory):
        """The time."""
        return memory

    def begins(self):
        """`settle`."""
        return self.settle
