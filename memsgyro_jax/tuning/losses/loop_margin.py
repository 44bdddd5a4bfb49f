"""How near the loops of classic control come to instability."""

import jax.numpy as jnp

from memsgyro_jax.device.gyro import Scalar, check_positive, number
from memsgyro_jax.loop.stability import loop_margins

from .base import AbstractLoss


class LoopMargin(AbstractLoss[tuple[()]]):
    """The square of what the least Nyquist margin of `loop_margins` misses of `wanted`, as a share of it; zero where
    all loops of the die keep it.

    It looks at the gains and the die, not at the run, and stands beside a loss that does:
    `Weighted((SquaredRateError(0.05), 1.0), (LoopMargin(), 10.0))`.
    """

    wanted: Scalar = number(default=0.5)

    def __check_init__(self):
        check_positive("wanted", self.wanted)

    def init(self):
        return ()

    def sample(self, memory, sample):
        return memory

    def value(self, memory):
        return jnp.zeros(())

    def of_loop(self, loop):
        return jnp.maximum(1.0 - loop_margins(loop).least / self.wanted, 0.0) ** 2
