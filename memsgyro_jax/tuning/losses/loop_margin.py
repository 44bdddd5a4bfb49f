"""How near the loops of classic control come to instability."""

import jax.numpy as jnp

from memsgyro_jax.device.gyro import Scalar, check_positive, number
from memsgyro_jax.loop.separate_loops import separate_margins

from .base import AbstractLoss


class LoopMargin(AbstractLoss[tuple[()]]):
    """Squares of what the Nyquist margins of the loops, each by itself, miss of `wanted`, as shares of it, summed over
    them; zero where all loops of the die keep it. The coupling of the axes is left out: ask `loop_margins` of what was
    tuned.

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
        return sum(jnp.maximum(1.0 - margin / self.wanted, 0.0) ** 2 for margin in separate_margins(loop))
