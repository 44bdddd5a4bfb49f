"""Fading memory: the factor by which a Kalman filter forgets (thesis 4.1.3.3)."""

import abc
from typing import Generic, TypeVar

import jax.numpy as jnp

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.device.gyro import Pair, Scalar, check_not_negative, check_positive, number


Memory = TypeVar("Memory")


class AbstractFading(Displayed, Generic[Memory]):
    """Gives the factor λ >= 1 of (4.15) at each sample."""

    @abc.abstractmethod
    def init(self) -> Memory:
        """What is remembered before the first sample."""

    @abc.abstractmethod
    def factor(
        self, memory: Memory, spread: Pair, innovation: Pair, variance: Pair, period: Scalar
    ) -> tuple[Scalar, Memory]:
        """λ and the new memory, from the predicted output variances `spread`, the innovations and the noise variances
        [V²].
        """


class FixedFading(AbstractFading[tuple[()]]):
    """λ = exp(forgetting * period); `forgetting` in 1/s, zero means an infinite memory.

    The thesis' λ = 1.00014 at 10 MHz is 1400/s, a memory of 0.7 ms.
    """

    forgetting: Scalar = number(default=0.0)

    def __check_init__(self):
        check_not_negative("forgetting", self.forgetting)

    @classmethod
    def per_sample(cls, factor: float, sample_rate: float) -> "FixedFading":
        """The law whose factor is `factor` at `sample_rate` [Hz], and the same memory in seconds at any other rate."""
        return cls(jnp.log(factor) * sample_rate)

    def init(self) -> tuple[()]:
        """Nothing."""
        return ()

    def factor(self, memory, spread, innovation, variance, period):
        return jnp.exp(self.forgetting * period), memory


class AdaptiveFading(AbstractFading[Pair]):
    """λ = max(1, trace N / trace M) of (4.16): forget when the innovations are larger than the filter expects.

    M is the predicted output covariance, N the observed innovation covariance, averaged over `window` seconds, less the
    measurement noise; (4.16) as printed defines N by itself, the form here is the one of its source (Xia et al.,
    Automatica 30, 1994).
    """

    window: Scalar = number(default=1e-3)
    ceiling: Scalar = number(default=1.01)

    def __check_init__(self):
        check_positive("window", self.window)
        check_not_negative("ceiling - 1", self.ceiling - 1.0)

    def init(self) -> tuple[Scalar, Scalar]:
        """Weighted sum of squared innovations over their noise, and the weight it has gathered."""
        return jnp.zeros(()), jnp.zeros(())

    def factor(self, memory, spread, innovation, variance, period):
        keep = jnp.exp(-period / self.window)
        square = keep * memory[0] + (1.0 - keep) * sum(e**2 for e in innovation)
        weight = keep * memory[1] + (1.0 - keep)
        excess = square / weight - sum(variance)
        return jnp.clip(excess / sum(spread), 1.0, self.ceiling), (square, weight)
