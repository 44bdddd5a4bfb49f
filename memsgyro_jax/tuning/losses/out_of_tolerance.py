"""The share of dies that miss a tolerance, made smooth."""

from memsgyro_jax.device.gyro import Scalar, check_positive, number

from .base import AbstractFinal, missed, rate_error


class OutOfTolerance(AbstractFinal):
    """1 for a die whose rate error at the end of the run is far beyond ±`tolerance` [rad/s], 0 for one well within.

    Its mean over the dies is 1 less the yield, with the edge drawn out to a logistic curve of relative width
    `softness`, so that dies near the edge pull: what a design is centred by.
    """

    tolerance: Scalar = number()
    softness: Scalar = number(default=0.2)

    def __check_init__(self):
        check_positive("tolerance", self.tolerance)
        check_positive("softness", self.softness)

    def of(self, sample):
        return rate_error(sample)

    def value(self, memory):
        return missed(memory, self.tolerance, self.softness)
