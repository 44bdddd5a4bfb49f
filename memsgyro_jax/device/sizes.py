"""How large the numbers of a device are where they vary from die to die: a coupling meant to be zero is not known."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.fields import Scalar

from .gyro import AbstractGyro


LEAST_COUPLING = 0.01  # of the geometric mean of the main coefficients: an etch tilted by some tenths of a degree


def numbers_of(gyro: AbstractGyro) -> tuple[str, ...]:
    """Paths of the numbers that differ from die to die, those of a gyro inside included: all that are not zero, and the
    couplings. The temperature is one for all.
    """
    found: list[str] = []
    for name, value in vars(gyro).items():
        if isinstance(value, AbstractGyro):
            found += [f"{name}.{inner}" for inner in numbers_of(value)]
        elif (
            name != "temperature"
            and eqx.is_inexact_array(value)
            and (name in gyro.couplings or np.all(np.asarray(value)))
        ):
            found.append(name)
    return tuple(found)


def with_sizes(gyro: AbstractGyro) -> AbstractGyro:
    """`gyro` with the size of each coupling, at least 1 % of the geometric mean of its main coefficients, in its place:
    what a relative variation is of.
    """
    for name, value in vars(gyro).items():
        if isinstance(value, AbstractGyro):
            gyro = eqx.tree_at(lambda made, name=name: getattr(made, name), gyro, with_sizes(value))
    sizes = []
    for name, (first, second) in gyro.couplings.items():
        value, main = getattr(gyro, name), (getattr(gyro, first), getattr(gyro, second))
        sizes.append(_size(np if is_concrete(value, main) else jnp, value, main))
    return eqx.tree_at(lambda made: [getattr(made, name) for name in gyro.couplings], gyro, sizes) if sizes else gyro


def _size(xp: object, value: Scalar, main: tuple[Scalar, Scalar]) -> Scalar:
    return xp.maximum(xp.abs(value), LEAST_COUPLING * xp.sqrt(main[0] * main[1]))  # type: ignore[attr-defined]
