"""How far the innovations are from what the filter claims."""

from typing import ClassVar

import jax.numpy as jnp

from memsgyro_jax.device.gyro import Scalar, number

from .base import AbstractSums, innovation_of


class Consistency(AbstractSums):
    """Σ (ln ν)² over the two channels, ν the mean of e²/S from `settle` [s] on; zero when both are 1.

    A filter far too bold (ν = 10) and one far too shy (ν = 1/10) count alike. It says nothing about the rate: add it,
    weighted, to a loss that does. It needs no truth.
    """

    settle: Scalar = number(default=0.0)
    sees_truth: ClassVar[bool] = False
    sums: ClassVar[int] = 3

    def terms(self, sample):
        return *innovation_of(sample, "Consistency").squared, 1.0

    def value(self, memory):
        # The smallest number that a float can hold stands in for a sum of zero.
        tiny, count = jnp.finfo(float).tiny, jnp.maximum(memory[2], 1.0)
        return sum(jnp.log(jnp.maximum(total / count, tiny)) ** 2 for total in memory[:2])
