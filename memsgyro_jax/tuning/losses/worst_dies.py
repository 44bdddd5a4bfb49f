"""The worst dies of a lot instead of all of them."""

from typing import Any

import jax
import jax.numpy as jnp

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Scalar, check_positive, is_concrete, number

from .base import AbstractLoss


class WorstDies(AbstractLoss[Any]):
    """The mean of another loss over the worst `share` of the dies, made smooth (conditional value at risk).

    With h = `softness` · standard deviation over the dies, the minimum over t of t + h/share · mean softplus((v - t)/h)
    (Rockafellar and Uryasev, J. Risk 2, 2000, their hinge made smooth); h to zero gives the plain mean of the worst
    dies, `share` 1 the mean of all (and h/2-ish more).
    """

    loss: AbstractLoss
    share: Scalar = number(default=0.1)
    softness: Scalar = number(default=0.05)

    def __check_init__(self):
        check_positive("softness", self.softness)
        if is_concrete(self.share) and not 0.0 < float(self.share) < 1.0:
            raise InputError(f"Argument `share` must lie between 0 and 1, but {float(self.share):g} was given.")

    @property
    def sees_truth(self) -> bool:  # type: ignore[override]  # depends on what is wrapped
        return self.loss.sees_truth

    @property
    def believes_claims(self) -> bool:  # type: ignore[override]  # depends on what is wrapped
        return self.loss.believes_claims

    def init(self):
        return self.loss.init()

    def sample(self, memory, sample):
        return self.loss.sample(memory, sample)

    def value(self, memory):
        return self.loss.value(memory)

    def of_loop(self, loop):
        return self.loss.of_loop(loop)

    def begins(self):
        return self.loss.begins()

    def combine(self, values):
        spread = jnp.var(values)
        width = self.softness * jnp.sqrt(jnp.where(spread > 0.0, spread, 1.0))
        # At the minimum over t the derivative by t is zero: only the values carry a derivative.
        level = jax.lax.stop_gradient(_level(values, width, self.share))
        tail = level + width / self.share * jnp.mean(jax.nn.softplus((values - level) / width))
        return jnp.where(spread > 0.0, tail, jnp.mean(values))


def _level(values, width, share):
    """The t at which the mean of sigmoid((v - t)/h) is the share, by bisection to rounding."""

    def halve(_, ends):
        low, high = ends
        middle = 0.5 * (low + high)
        above = jnp.mean(jax.nn.sigmoid((values - middle) / width)) > share
        return jnp.where(above, middle, low), jnp.where(above, high, middle)

    reach = 50.0 * width
    ends = jax.lax.fori_loop(0, 100, halve, (jnp.min(values) - reach, jnp.max(values) + reach))
    return 0.5 * (ends[0] + ends[1])
