"""Block algebra of the extended Kalman filter: a symmetric covariance of 4 motion entries beside constants."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.device.gyro import Pair, Scalar
from memsgyro_jax.device.propagate import State4, dot


class Covariance(NamedTuple):
    """Symmetric covariance in blocks: `motion` upper triangle by rows (10 numbers), `cross` 4 rows, `constants`."""

    motion: tuple[Scalar, ...]
    cross: tuple[Float[Array, "constants *lanes"], ...]
    constants: Float[Array, "constants constants *lanes"]


Matrix4 = tuple[tuple[Scalar, ...], ...]
Column = tuple[tuple[int, float, Scalar], ...]
Columns = tuple[Column, Column]
Kick = tuple[Matrix4, Columns]


class Rows(NamedTuple):
    """The motion rows of J P: 4×4 over the motion, 4 vectors over the constants."""

    motion: tuple[tuple[Scalar, ...], ...]
    constants: tuple[Array, ...]


class Predicted(NamedTuple):
    """Predicted motion, the motion rows of J P, and J itself: the motion's transition and the constants' kicks."""

    mean: State4
    rows: Rows
    full: Matrix4
    kicks: tuple[Kick, ...]


class Prediction(NamedTuple):
    """Covariance before a measurement. The constants' block is kept as it was, with what is to be done to it: writing
    it out here would cost a pass over the largest array of the step."""

    motion: tuple[Scalar, ...]
    cross: tuple[Array, ...]
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

    motion: tuple[Scalar, ...]
    constants: Array
    motion_gain: tuple[Scalar, ...]
    constant_gain: Array
    spread: Scalar


def square(upper: tuple[Scalar, ...]) -> list[list[Scalar]]:
    """The 4x4 matrix of an upper triangle listed by rows."""
    block: list[list[Scalar]] = [[0.0] * 4 for _ in range(4)]
    entries = iter(upper)
    for i in range(4):
        for j in range(i, 4):
            block[i][j] = block[j][i] = next(entries)
    return block


def rows(covariance: Covariance, full: Matrix4, kicks: tuple[Kick, ...]) -> Rows:
    """The 4 motion rows of J P."""
    block = square(covariance.motion)
    motion = [[dot(row, tuple(block[k][j] for k in range(4))) for j in range(4)] for row in full]
    constants = [combine(row, covariance.cross) for row in full]
    cross, matrix = [entries(row) for row in covariance.cross], entries(covariance.constants)
    for kick, columns in kicks:
        on_motion = [[gathered(column, cross[j]) for column in columns] for j in range(4)]
        on_constants = [gathered(column, matrix) for column in columns]
        for i, push in enumerate(kick):
            motion[i] = [value + dot(push, tuple(on_motion[j])) for j, value in enumerate(motion[i])]
            constants[i] = constants[i] + combine(push, on_constants)
    return Rows(tuple(map(tuple, motion)), tuple(constants))


def entries(vector: Array) -> tuple[Array, ...]:
    """Those along the leading axis. Backwards they are concatenated, where indexing would add up padded arrays."""
    return tuple(part[0] for part in jax.lax.split(vector, (1,) * vector.shape[0]))


def gathered(column: Column, vector: tuple[Array, ...]) -> Scalar:
    """Acceleration of one axis by the constants `vector`; entries of `vector` may themselves be vectors."""
    return sum(_signed(factor, beside(signal, vector[m]) * vector[m]) for m, factor, signal in column)


def beside(number: Scalar, constants: Array) -> Array:
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


def combine(weights: tuple[Scalar, ...], vectors: tuple[Array, ...]) -> Array:
    """Weighted sum of vectors of constants; weights are scalars of one die."""
    pairs = zip(weights, vectors, strict=True)
    return dot(tuple(w if isinstance(w, float) else beside(w, vector) for w, vector in pairs), tuple(vectors))


def motion_block(predicted: Predicted) -> tuple[Scalar, ...]:
    """Upper triangle of (J P) Jᵀ over the motion."""
    across = predicted.rows
    vectors = [entries(v) for v in across.constants]
    kicked = [
        [[gathered(column, vectors[i]) for column in columns] for i in range(4)] for _, columns in predicted.kicks
    ]
    upper = []
    for i in range(4):
        for j in range(i, 4):
            value = dot(across.motion[i], predicted.full[j])
            for (kick, _), gained in zip(predicted.kicks, kicked, strict=True):
                value = value + dot(kick[j], tuple(gained[i]))
            upper.append(value)
    return tuple(upper)


def add_diagonal(upper: tuple[Scalar, ...], intensity: State4, period: Scalar) -> tuple[Scalar, ...]:
    """An upper triangle with `intensity * period` added to its diagonal."""
    diagonal = {0: 0, 4: 1, 7: 2, 9: 3}  # positions of (i, i) in an upper triangle by rows
    return tuple(p + intensity[diagonal[n]] * period if n in diagonal else p for n, p in enumerate(upper))


def correct_mean(motion: State4, constants: Array, first: Gain, second: Gain, weights: Pair) -> tuple[State4, Array]:
    """Motion and constants moved by the two (decorrelated) innovations `weights` through their gains."""
    moved = tuple(
        m + a * weights[0] + b * weights[1]
        for m, a, b in zip(motion, first.motion_gain, second.motion_gain, strict=True)
    )
    steps = (beside(w, constants) * gain.constant_gain for w, gain in zip(weights, (first, second), strict=True))
    return moved, sum(steps, constants)


def _faded(factor: Scalar, constants: Array) -> Array:
    return constants if isinstance(factor, float) else factor * constants


def _diagonal(walk: Array, like: Array) -> Array:
    """`walk` on the diagonal of a matrix shaped as `like`; dies are trailing axes of either."""
    count, lanes = like.shape[0], like.ndim - 2
    eye = np.eye(count).reshape((count, count) + (1,) * lanes)
    return eye * _repeated(walk.reshape(walk.shape + (1,) * (lanes + 1 - walk.ndim)), count, axis=0)


def _repeated(value: Array, count: int, axis: int) -> Array:
    return jnp.concatenate([jnp.expand_dims(value, axis)] * count, axis=axis)


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
    pairs = [(i, j) for i in range(4) for j in range(i, 4)]
    motion = tuple(
        p - first.motion_gain[i] * first.motion[j] - second.motion_gain[i] * second.motion[j]
        for p, (i, j) in zip(prior.motion, pairs, strict=True)
    )
    cross = tuple(
        row
        - beside(first.motion_gain[i], row) * first.constants
        - beside(second.motion_gain[i], row) * second.constants
        for i, row in enumerate(prior.cross)
    )
    # Products of one vector with itself are symmetric to the last bit. They must be: a difference between (i, j) and
    # (j, i) is never corrected by a measurement, and fading multiplies it by λ at every sample.
    first_root, second_root = (g.constants / beside(jnp.sqrt(g.spread), g.constants) for g in (first, second))
    constants = (
        _faded(prior.faded, prior.constants)
        + _diagonal(prior.walk, prior.constants)
        - _outer_square(first_root)
        - _outer_square(second_root)
    )
    return Covariance(motion, cross, constants)
