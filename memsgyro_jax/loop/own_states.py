"""Linear states of effects, carried over a sample by the series of their exponential, however stiff beside the device.

The mass moves along the cubic through its place and velocity at both ends of the sample.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Pair, Scalar, is_concrete
from memsgyro_jax.device.propagate import State4
from memsgyro_jax.device.small import Matrix, Vector
from memsgyro_jax.effects.base import ForceEffect, Moment


Own = tuple[Scalar, ...]
_TERMS = 18  # what they leave out is 1e-14 of a state at a fifth of the sample rate, 1e-7 at a half


def stacked(values: Sequence[Scalar]) -> jax.Array:
    """Numbers of one die as an array."""
    return jnp.stack([jnp.asarray(value, float) for value in values]) if values else jnp.zeros(0)


def _slope(effect: ForceEffect, still: Moment, **seen: Sequence[Scalar]) -> Own:
    """The own state's derivative by time where all that is not `seen` is zero: a column of the linear law."""
    rest = {"displacement": (0.0, 0.0), "velocity": (0.0, 0.0), "force": (0.0, 0.0), "own": (0.0,) * effect.own_size}
    values = [stacked(value) for value in (rest | seen).values()]
    return tuple(effect.own_rate(eqx.tree_at(lambda m: [getattr(m, name) for name in rest], still, values)))


def _matrix(effect: ForceEffect, still: Moment) -> Matrix:
    """How the own state drives itself [1/s]."""
    columns = [_slope(effect, still, own=unit) for unit in np.eye(effect.own_size).tolist()]
    return Matrix(columns).T


def propagated(
    effect: ForceEffect, still: Moment, own: Own, held: Pair, start: State4, end: State4, period: Scalar
) -> Own:
    """The linear own state of one die a period later, under the held force [N]; `still` gives all else it may see."""
    h, matrix = period, _matrix(effect, still)
    axes = [(q, h * v, p, h * w) for q, v, p, w in zip(start[:2], start[2:], end[:2], end[2:], strict=True)]
    cubic = [(q, v, 3.0 * (p - q) - 2.0 * v - w, 2.0 * (q - p) + v + w, 0.0) for q, v, p, w in axes]
    loads = [
        _slope(
            effect, still, displacement=power, velocity=[(k + 1) / h * v for v in following],
            force=(0.0, 0.0) if k else held,
        )
        for k, (power, following) in enumerate(pairwise(zip(*cubic, strict=True)))
    ]  # fmt: skip
    # The k-th derivative by time over the period; all summed at the end.
    derivatives = [Vector(own)]
    for k in range(_TERMS):
        slopes = matrix @ derivatives[-1]
        if k < len(loads):
            slopes = slopes + math.factorial(k) * Vector(loads[k])
        derivatives.append(h * slopes)
    weights = Vector(1.0 / math.factorial(k) for k in range(len(derivatives)))
    return tuple(weights @ derivatives)


def check_speed(effect: ForceEffect, still: Moment, sample_rate: float) -> None:
    """Refuse a linear own state that turns faster than half the sample rate [Hz], which the series does not follow.

    **Raises:** `InputError`; traced values pass.
    """
    matrix = stacked([entry for row in _matrix(effect, still) for entry in row])
    if is_concrete(matrix):
        turning = np.linalg.eigvals(np.asarray(matrix).reshape(effect.own_size, effect.own_size))
        fastest = float(np.max(np.abs(turning))) / (2.0 * np.pi)
        if fastest > 0.5 * sample_rate:
            raise InputError(
                f"Argument `sample_rate` must be at least twice the {fastest:.0f} Hz of the effect `{effect.label}`, "
                f"but {sample_rate:g} Hz was given."
            )
