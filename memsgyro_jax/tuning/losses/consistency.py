"""How far the innovations are from what the filter claims."""

from typing import ClassVar

import jax.numpy as jnp

from memsgyro_jax.device.gyro import Scalar, check_not_negative, number

from .base import AbstractLoss, innovation_of


class Consistency(AbstractLoss[tuple[Scalar, Scalar, Scalar]]):
    """Σ (ln ν)² over the two channels, ν the mean of e²/S from `settle` [s] on; zero when both are 1.

    A filter far too bold (ν = 10) and one far too shy (ν = 1/10) count alike. It says nothing about the rate: add it,
    weighted, to a loss that does. It needs no truth.
    """

    settle: Scalar = number(default=0.0)
    sees_truth: ClassVar[bool] = False

    def __check_init__(self):
        check_not_negative("settle", self.settle)

    def init(self):
        """Sums of both channels, and the count."""
        return jnp.zeros(()), jnp.zeros(()), jnp.zeros(())

    def sample(self, memory, sample):
        """Add e²/S of both channels once settled."""
        counts = sample.clock.time >= self.settle
        x, y = innovation_of(sample, "Consistency").squared
        return memory[0] + jnp.where(counts, x, 0.0), memory[1] + jnp.where(counts, y, 0.0), memory[2] + counts

    def value(self, memory):
        """Σ (ln ν)²; the smallest number a float can hold stands in for a sum of zero."""
        tiny, count = jnp.finfo(float).tiny, jnp.maximum(memory[2], 1.0)
        return sum(jnp.log(jnp.maximum(total / count, tiny)) ** 2 for total in memory[:2])

    def begins(self):
        """`settle`."""
        return self.settle
