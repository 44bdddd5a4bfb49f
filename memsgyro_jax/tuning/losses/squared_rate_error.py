"""Mean squared error of the rate."""

from .base import AbstractMean, rate_error


class SquaredRateError(AbstractMean):
    """Mean of (given out - true rate)² from `settle` [s] on, in (rad/s)².

    It does not see whether the filter's claims are right: the gain of a Kalman filter depends on ratios of its noises
    only, so a common factor of all of them is a direction without effect.
    """

    def of(self, sample):
        return rate_error(sample) ** 2
