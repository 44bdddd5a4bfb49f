"""A limit on the delay with which the rate is followed."""

import jax.numpy as jnp

from memsgyro_jax.device.gyro import Scalar, check_positive, number

from .base import AbstractSums, rate_error


class Delay(AbstractSums):
    """((τ - `allowed`) / `allowed`)² where the delay τ exceeds `allowed` [s], else zero.

    To first order an output that comes τ late misses the truth by -τ·slope, so τ is the regression of the error on the
    slope of the true rate, from `settle` [s] on. That holds for rates that change little within τ; a rate with a white
    slope, such as a random walk, shows no delay. A low-pass of the first order with bandwidth f has τ = 1/(2πf): this
    is a limit on the bandwidth as well.
    """

    allowed: Scalar = number()
    settle: Scalar = number(default=0.0)

    def __check_init__(self):
        check_positive("allowed", self.allowed)

    def terms(self, sample):
        slope = sample.conditions.inertial.angular_acceleration
        return rate_error(sample) * slope, slope**2

    def value(self, memory):
        along, squares = memory
        delay = -along / jnp.where(squares > 0.0, squares, 1.0)  # none for a rate that does not vary
        return jnp.maximum(delay / self.allowed - 1.0, 0.0) ** 2
