"""The share of dies that miss a tolerance, as the filter itself expects."""

from typing import ClassVar

import jax
import jax.numpy as jnp

from memsgyro_jax.device.gyro import Scalar, check_positive, number
from memsgyro_jax.loop.loop import Sample

from .base import AbstractLoss, claimed_variance


class ExpectedMisses(AbstractLoss[Scalar]):
    """The probability that the rate is beyond ±`tolerance` [rad/s] at the end of the run: erfc(tolerance / (σ √2)), σ
    the standard deviation that the filter claims.

    Its mean over the dies is 1 less the yield that a consistent filter may expect, and hardly depends on the noise
    drawn: what a design is centred by. An error drawn once jumps about with the phase of a vibration that a stiffness
    changes, and its gradient says nothing about the yield. Never free the filter's own noises with it: it would believe
    any claim. It needs no truth.
    """

    tolerance: Scalar = number()
    sees_truth: ClassVar[bool] = False

    def __check_init__(self):
        check_positive("tolerance", self.tolerance)

    def init(self):
        """No variance yet."""
        return jnp.zeros(())

    def sample(self, memory: Scalar, sample: Sample) -> Scalar:
        """Only the last one counts."""
        return claimed_variance(sample, "ExpectedMisses") + 0.0 * memory

    def value(self, memory: Scalar) -> Scalar:
        """The probability."""
        return jax.scipy.special.erfc(self.tolerance / jnp.sqrt(2.0 * memory))
