"""How a number differs from die to die, by what it is drawn from."""

import abc
import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import special

from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Scalar


def _share(given: Any) -> Any:
    return None if given is None else quantity("relative", given, "1")


class AbstractDistribution(Displayed):
    """Turns a standard normal number into a value around a design value; a new kind gives `value`, and `of_itself`
    where it varies a number by a share of it: nothing, of one that is zero.
    """

    @property
    def of_itself(self) -> bool:
        """Whether the width is a share of the design value alone."""
        return False

    def place(self, normal: Float[np.ndarray, " dies"]) -> Float[np.ndarray, " dies"]:
        """Where the dies stand, whatever the design: a function of their standard normal numbers, itself by default."""
        return normal

    @abc.abstractmethod
    def value(self, design: Scalar, place: Float[Array, " dies"]) -> Float[Array, " dies"]:
        """Values of the dies, differentiable by the design value."""


class Normal(AbstractDistribution):
    """Normal about the design value, or about `mean` where one is given, cut at ±`cut` deviations; `relative` to it or
    `std` in its unit.
    """

    relative: float = eqx.field(converter=_share, default=0.0)
    std: float = 0.0
    cut: float = 4.0
    mean: float | None = None

    def __check_init__(self):
        if not (self.relative >= 0.0 and self.std >= 0.0):
            raise InputError(f"A spread must not be negative, but {self.relative:g}, {self.std:g} were given.")
        if not self.cut > 0.0:
            raise InputError(f"Argument `cut` must be positive, but {self.cut:g} was given.")

    @property
    def of_itself(self) -> bool:
        """With `relative` alone."""
        return self.relative > 0.0 and self.std == 0.0 and self.mean is None

    def place(self, normal):
        # The inverse of the cut distribution, from its nearer end.
        least = special.ndtr(-self.cut)
        return np.copysign(special.ndtri(least + (1.0 - 2.0 * least) * special.ndtr(-np.abs(normal))), normal)

    def value(self, design, place):
        design = design if self.mean is None else self.mean
        std = self.relative * abs(design) if self.std == 0.0 else jnp.hypot(self.relative * design, self.std)
        return design + place * std


class Uniform(AbstractDistribution):
    """Uniform; `relative` half width about the design value, or from `low` to `high` in its unit."""

    relative: float | None = eqx.field(converter=_share, default=None)
    low: float = math.nan
    high: float = math.nan

    def __check_init__(self):
        missing = [math.isnan(end) for end in (self.low, self.high)]
        if any(missing) if self.relative is None else not all(missing):
            raise InputError("A uniform spread must have either `relative`, or `low` and `high`.")
        if self.relative is not None and not self.relative >= 0.0:
            raise InputError(f"A spread must not be negative, but {self.relative:g} was given.")
        if self.high < self.low:
            raise InputError(f"A uniform spread must have low <= high, but {self.low:g} and {self.high:g} were given.")

    @property
    def of_itself(self) -> bool:
        """With `relative`."""
        return bool(self.relative)

    def place(self, normal):
        return special.ndtr(normal)

    def value(self, design, place):
        if self.relative is not None:
            return design * (1.0 + self.relative * (2.0 * place - 1.0))
        return self.low + place * (self.high - self.low)


class AtLeast(AbstractDistribution):
    """`inner` about a design value smaller than `size`, but as wide as it is about `size`."""

    inner: AbstractDistribution
    size: Scalar

    def place(self, normal):
        return self.inner.place(normal)

    def value(self, design, place):
        return design + (self.inner.value(self.size, place) - self.size)
