"""Block algebra of the extended Kalman filter: a symmetric covariance of 4 motion entries beside constants."""

from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.device.gyro import Pair, Scalar
from memsgyro_jax.device.propagate import State4
from memsgyro_jax.device.small import Matrix, Vector, plus


class Covariance(NamedTuple):
    """Symmetric covariance in blocks: `motion` upper triangle by rows (10 numbers), `cross` 4 rows, `constants`."""

    motion: tuple[Scalar, ...]
    cross: tuple[Float[Array, "constants *lanes"], ...]
    constants: Float[Array, "constants constants *lanes"]


Column = tuple[tuple[int, float, Scalar], ...]
Columns = tuple[Column, Column]
Kick = tuple[Matrix, Columns]
UPPER = tuple((i, j) for i in range(4) for j in range(i, 4))  # entries of an upper triangle


class Rows(NamedTuple):
    """The motion rows of J P: 4×4 over the motion, 4 vectors over the constants."""

    motion: Matrix
    constants: Vector


class Predicted(NamedTuple):
    """Predicted motion, the motion rows of J P, and J itself: the motion's transition and the constants' kicks."""

    mean: Vector
    rows: Rows
    full: Matrix
    kicks: tuple[Kick, ...]


class Prediction(NamedTuple):
    """Covariance before a measurement. The constants' block is kept as it was, with what is to be done to it: writing
    it out here would cost a pass over the largest array of the step."""

    motion: Vector
    cross: Vector
    constants: Array
    faded: Scalar
    walk: Array

    def row(self, index: int) -> Array:
        """One row of the constants' block after fading and random walk."""
        unit = np.zeros(self.constants.shape[0])
        unit[index] = 1.0
        grown = unit.reshape((-1,) + (1,) * (self.constants.ndim - 2)) * entries(self.walk)[index]
        return _faded(self.faded, entries(self.constants)[index]) + grown


class Gain(NamedTuple):
    """One scalar measurement: covariance of the state with it, that divided by its variance, and the variance."""

    motion: Vector
    constants: Array
    motion_gain: Vector
    constant_gain: Array
    spread: Scalar


def square(upper: tuple[Scalar, ...]) -> Matrix:
    """The 4x4 matrix of an upper triangle listed by rows."""
    table = dict(zip(UPPER, upper, strict=True))
    return Matrix((table[min(i, j), max(i, j)] for j in range(4)) for i in range(4))


def matrix_of(covariance: Covariance) -> Float[Array, "states states *lanes"]:
    """The matrix of the blocks."""
    motion, cross, constants = covariance
    top = jnp.concatenate([jnp.stack([jnp.stack(row) for row in square(motion)]), jnp.stack(cross)], axis=1)
    bottom = jnp.concatenate([jnp.moveaxis(jnp.stack(cross), 0, 1), constants], axis=1)
    return jnp.concatenate([top, bottom], axis=0)


def blocks_of(matrix: Float[Array, "states states *lanes"]) -> Covariance:
    """The blocks of the matrix, split: the derivative of an indexed one is a sum of padded arrays."""
    sizes = 4, len(matrix) - 4
    moving, still = jax.lax.split(matrix, sizes)
    motion, cross = jax.lax.split(moving, sizes, axis=1)
    square = [entries(row) for row in entries(motion)]
    return Covariance(tuple(square[i][j] for i, j in UPPER), entries(cross), jax.lax.split(still, sizes, axis=1)[1])


def rows(covariance: Covariance, full: Matrix, kicks: tuple[Kick, ...]) -> Rows:
    """The 4 motion rows of J P."""
    motion, constants = full @ square(covariance.motion), combine(full, covariance.cross)
    cross, matrix = [entries(row) for row in covariance.cross], entries(covariance.constants)
    for kick, columns in kicks:
        motion = motion + kick @ Matrix(gathered(columns, row) for row in cross).T
        constants = constants + combine(kick, gathered(columns, matrix))
    return Rows(motion, constants)


def entries(vector: Array) -> tuple[Array, ...]:
    """Those along the leading axis. Backwards they are concatenated, where indexing would add up padded arrays."""
    return tuple(part[0] for part in jax.lax.split(vector, (1,) * vector.shape[0]))


def gathered(columns: Columns, vector: tuple[Array, ...]) -> Vector:
    """Acceleration of both axes by the constants `vector`; its entries may themselves be vectors."""
    return Vector(
        reduce(
            plus, (_signed(factor, per_constant(signal, vector[m]) * vector[m]) for m, factor, signal in column), 0.0
        )
        for column in columns
    )


def per_constant(number: Scalar, constants: Array) -> Array:
    """`number` of a die, repeated for each of its `constants`; as it is beside a number, or where dies share it.

    Its derivative is a sum of slices, which XLA vectorises over the dies; that of a broadcast is a reduction, which it
    does not.
    """
    number = jnp.asarray(number)
    if number.ndim + 1 != jnp.ndim(constants):
        return number
    return _repeated(number, len(constants), axis=0)


def _signed(factor: float, product: Array) -> Array:
    return product if factor == 1.0 else -product if factor == -1.0 else factor * product


def combine(weights: Matrix, vectors: tuple[Array, ...]) -> Vector:
    """`weights @ vectors` for vectors of constants; weights are scalars of one die."""
    return Vector(
        Vector(w if isinstance(w, float) else per_constant(w, v) for w, v in zip(row, vectors, strict=True)) @ vectors
        for row in weights
    )


def motion_block(predicted: Predicted) -> Vector:
    """Upper triangle of (J P) Jᵀ over the motion."""
    upper = _upper(predicted.rows.motion, predicted.full)
    vectors = [entries(v) for v in predicted.rows.constants]
    for kick, columns in predicted.kicks:
        upper = upper + _upper([gathered(columns, vector) for vector in vectors], kick)
    return upper


def _upper(left: Sequence[Vector], right: Sequence[Vector]) -> Vector:
    """Upper triangle of left @ rightᵀ."""
    return Vector(left[i] @ right[j] for i, j in UPPER)


def diagonal(entries: Vector) -> Vector:
    """The upper triangle of a matrix that has `entries` on its diagonal and zeros beside it."""
    return Vector(entries[i] if i == j else 0.0 for i, j in UPPER)


def correct_mean(motion: Vector, constants: Array, first: Gain, second: Gain, weights: Pair) -> tuple[State4, Array]:
    """Motion and constants moved by the two (decorrelated) innovations `weights` through their gains."""
    moved = motion + first.motion_gain * weights[0] + second.motion_gain * weights[1]
    steps = (per_constant(w, constants) * gain.constant_gain for w, gain in zip(weights, (first, second), strict=True))
    return tuple(moved), sum(steps, constants)


def _faded(factor: Scalar, constants: Array) -> Array:
    return constants if isinstance(factor, float) else factor * constants


def _diagonal(walk: Array, like: Array) -> Array:
    """`walk` on the diagonal of a matrix shaped as `like`; dies are trailing axes of either."""
    count, lanes = like.shape[0], like.ndim - 2
    eye = np.eye(count).reshape((count, count) + (1,) * lanes)
    return eye * _repeated(walk.reshape(walk.shape + (1,) * (lanes + 1 - walk.ndim)), count, axis=0)


def _repeated(value: Array, count: int, axis: int) -> Array:
    one = jnp.expand_dims(value, axis)
    return jnp.concatenate([one] * count, axis=axis) if count else jax.lax.slice_in_dim(one, 0, 0, axis=axis)


@jax.custom_jvp
def _outer_square(vector: Array) -> Array:
    """The products of a vector's entries with each other."""
    return vector[:, None] * vector[None]


@_outer_square.defjvp
def _outer_square_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    (vector,), (change,) = primals, tangents
    by_row, by_column = (_repeated(change, len(change), axis) for axis in (0, 1))
    return _outer_square(vector), vector[:, None] * by_row + by_column * vector[None]


def downdate(prior: Prediction, first: Gain, second: Gain) -> Covariance:
    """P - K₁v₁ᵀ - K₂v₂ᵀ, block by block; symmetric by construction."""
    first_part, second_part = (Vector(g.motion_gain[i] * g.motion[j] for i, j in UPPER) for g in (first, second))
    motion = prior.motion - first_part - second_part
    cross = tuple(
        row
        - per_constant(first.motion_gain[i], row) * first.constants
        - per_constant(second.motion_gain[i], row) * second.constants
        for i, row in enumerate(prior.cross)
    )
    # Products of one vector with itself are symmetric to the last bit. They must be: a difference between (i, j) and
    # (j, i) is never corrected by a measurement, and fading multiplies it by λ at every sample.
    first_root, second_root = (g.constants / per_constant(jnp.sqrt(g.spread), g.constants) for g in (first, second))
    constants = (
        _faded(prior.faded, prior.constants)
        + _diagonal(prior.walk, prior.constants)
        - _outer_square(first_root)
        - _outer_square(second_root)
    )
    return Covariance(tuple(motion), cross, constants)
