"""A two-axis device from what an engineer knows of it: mode frequencies, quality factors, mass, coupling."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.base.concrete import check_positive, is_concrete
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.plainly import at_once
from memsgyro_jax.base.text import excerpt

from .inertial import Pair
from .small import Matrix, Scalar


Symmetric = tuple[Array, Array, Array]  # xx, yy, xy


def rates_of(frequency: Pair, quality_factor: Scalar | Pair) -> tuple[Pair, Pair]:
    """Angular frequencies ω [rad/s] and damping rates ω/Q [1/s] of both modes; one quality factor serves both.

    Raises `InputError` unless all are positive.
    """
    quality = quality_factor if isinstance(quality_factor, tuple | list) else (quality_factor,) * 2
    frequency, quality = _both("frequency", frequency, "Hz"), _both("quality_factor", quality, "1")
    first, second = (2.0 * jnp.pi * jnp.asarray(value) for value in frequency)
    return (first, second), (first / quality[0], second / quality[1])


def _both(name: str, given: Any, unit: str) -> Pair:
    """One positive number in `unit` for each mode."""
    if isinstance(given, str) or not np.iterable(given):
        raise InputError(
            f"Argument `{name}` must be a pair, one number for each mode, but is {excerpt(given)} of type "
            f"{type(given).__name__}; write `({excerpt(given)}, {excerpt(given)})` where both modes have the same."
        )
    if len(given) != 2:
        raise InputError(f"Argument `{name}` must be a pair, one number for each mode, but {len(given)} were given.")
    first, second = (quantity(name, value, unit) for value in given)
    for value in (first, second):
        check_positive(name, value)
    return first, second


@at_once
def in_turned_axes(first: Scalar, second: Scalar, cross: Scalar, angle: Scalar) -> Symmetric:
    """The symmetric matrix that is [[first, cross], [cross, second]] in axes turned by `angle` [rad] from x to y."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return (
        c**2 * first + s**2 * second - 2.0 * s * c * cross,
        s**2 * first + c**2 * second + 2.0 * s * c * cross,
        s * c * (first - second) + (c**2 - s**2) * cross,
    )


def angle_of_quadrature(quadrature: Scalar, modes: Pair) -> Array:
    """Angle [rad] of the first mode from x whose coupling feels like the rate `quadrature` [rad/s] in amplitude.

    The coupling force kxy·x at the first mode's ω is that of the rate kxy/(2·mass·ω). Raises `InputError` where modes
    as near to each other cannot couple as much.
    """
    first, second = modes
    share = 4.0 * first * quadrature / (first**2 - second**2)
    if is_concrete(share) and not np.all(np.abs(share) <= 1.0):
        limit = np.max(np.abs(first**2 - second**2) / (4.0 * first))
        raise InputError(
            f"Argument `quadrature` must be at most {np.degrees(limit):.4g} deg/s between these frequencies, but "
            f"{np.degrees(np.max(np.abs(quadrature))):.4g} deg/s was given; lower it or set the modes further apart."
        )
    return 0.5 * jnp.arcsin(share)


def coupled(modes: Pair, coupling: Scalar) -> Pair:
    """Natural angular frequencies squared of two axes, first and second, whose modes are `modes` [rad/s] once they
    couple by `coupling`, the product of both couplings per mass [rad⁴/s⁴].

    Raises `InputError` where such modes cannot couple as much.
    """
    mean, half = 0.5 * (modes[0] ** 2 + modes[1] ** 2), 0.5 * (modes[0] ** 2 - modes[1] ** 2)
    left = half**2 - coupling
    if is_concrete(left) and not np.all(left >= 0.0):
        raise InputError(
            "Argument `quadrature` must be smaller: modes as near to each other cannot couple as much; lower it or set "
            "the frequencies further apart."
        )
    split = jnp.sign(half) * jnp.sqrt(left)
    return mean + split, mean - split


def natural_frequencies(stiffness: Matrix) -> Float[np.ndarray, "*dies two"]:
    """Undamped mode frequencies in Hz, ascending, of a `stiffness` per mass in rad²/s²."""
    xp = np if is_concrete(stiffness) else jnp
    (a, b), (c, d) = (xp.broadcast_arrays(*map(xp.asarray, row)) for row in stiffness)
    # The root has no derivative where both modes are one: there each is given that of their mean, which has one.
    apart = 0.25 * (a - d) ** 2 + b * c
    mean, split = 0.5 * (a + d), xp.where(apart == 0.0, 0.0, xp.sqrt(xp.where(apart == 0.0, 1.0, apart)))
    return xp.sqrt(xp.stack([mean - split, mean + split], axis=-1)) / (2.0 * np.pi)
