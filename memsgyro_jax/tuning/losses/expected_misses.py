"""The share of dies that miss a tolerance, as the filter itself expects."""

from typing import ClassVar

import jax
import jax.numpy as jnp

from memsgyro_jax.device.gyro import Scalar, check_positive, number

from .base import AbstractFinal, claimed_variance


class ExpectedMisses(AbstractFinal):
    """The probability that the rate is beyond ±`tolerance` [rad/s] at the end of the run: erfc(tolerance / (σ √2)), σ
    the standard deviation that the filter claims.

    Its mean over the dies is 1 less the yield that a consistent filter may expect, and hardly depends on the noise
    drawn: what a design is centred by. An error drawn once jumps about with the phase of a vibration that a stiffness
    changes, and its gradient says nothing about the yield. It believes any claim of the filter, whose own numbers
    tuning refuses to free with it. It needs no truth.
    """

    tolerance: Scalar = number()
    sees_truth: ClassVar[bool] = False
    believes_claims: ClassVar[bool] = True

    def __check_init__(self):
        check_positive("tolerance", self.tolerance)

    def of(self, sample):
        return claimed_variance(sample, "ExpectedMisses")

    def value(self, memory):
        return jax.scipy.special.erfc(self.tolerance / jnp.sqrt(2.0 * memory))
