"""Time that a die needs to come within a tolerance, made smooth."""

from typing import ClassVar

from memsgyro_jax.device.gyro import Scalar, check_positive, number

from .base import AbstractSums, missed, rate_error


class ConvergenceTime(AbstractSums):
    """Time in s that the rate spends outside ±`tolerance` [rad/s], from `settle` [s] on.

    For a die that comes in once and stays this is the time to converge; each later excursion adds its length. The edge
    is soft, of relative width `softness`.
    """

    tolerance: Scalar = number()
    softness: Scalar = number(default=0.1)
    settle: Scalar = number(default=0.0)
    sums: ClassVar[int] = 1

    def __check_init__(self):
        check_positive("tolerance", self.tolerance)
        check_positive("softness", self.softness)

    def terms(self, sample):
        return (sample.clock.period * missed(rate_error(sample), self.tolerance, self.softness),)

    def value(self, memory):
        return memory[0]
