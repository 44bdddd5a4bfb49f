"""Linear algebra of many small matrices at once, as arrays to be batched by `vmap`.

LAPACK takes them one by one and, called from compiled loops on several threads, may wait for itself; elimination
written out vectorises over the batch. In the step of the loop even arrays cost too much: see `device.small`.
"""

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped

from .errors import InputError


_FEW = 36  # entries of a matrix that is written out; one of 128 is faster as a call of a library
_SAME = 1e-11  # share of a squared length that is left of a column which depends on those before it


def inverse(matrix: Shaped[Array, "n n"]) -> Shaped[Array, "n n"]:
    """Inverse of a small real or complex matrix by Gauss and Jordan with row pivoting, to be batched by `vmap`.

    Its derivative is that of the exact inverse: one Newton-Schulz step around the frozen result.
    """
    frozen = _gauss_jordan(jax.lax.stop_gradient(matrix))
    one = jnp.eye(matrix.shape[0], dtype=matrix.dtype)
    return frozen + frozen @ (one - matrix @ frozen)


def solved(matrix: Shaped[Array, "*b n n"], frozen: Shaped[Array, "*b n n"], right: Array) -> Array:
    """What a matrix makes `right` of, from its inverse without derivatives; differentiable as the exact one, with no
    more than products with vectors.
    """
    found = product(frozen, right)
    return found + product(frozen, right - product(matrix, found))


def _gauss_jordan(matrix: Array) -> Array:
    """In the place of the matrix itself: of a column that is done, that of the inverse takes the room."""
    size = matrix.shape[0]
    scale = 1.0 / jnp.max(jnp.abs(matrix), axis=1)
    rows = jnp.arange(size)

    def step(carry: tuple[Array, Array], column: Array) -> tuple[tuple[Array, Array], None]:
        table, order = carry
        entries = jax.lax.dynamic_index_in_dim(table, column, axis=1, keepdims=False)
        pivot = jnp.argmax(jnp.where(rows >= column, jnp.abs(entries), -1.0))
        here, there = jax.lax.dynamic_index_in_dim(table, column, axis=0, keepdims=False), table[pivot]
        is_column, is_pivot = rows == column, rows == pivot
        # Rows change places as they are eliminated: to move them first would pass through the whole table once more.
        row = jnp.where(is_column, 1.0, there) / there[column]
        swapped = jnp.where(is_column, 0.0, jnp.where(is_pivot[:, None], here, table))
        swapped = swapped - jnp.where(is_pivot, here[column], entries)[:, None] * row
        order = jnp.where(is_column, order[pivot], jnp.where(is_pivot, order[column], order))
        return (jnp.where(is_column[:, None], row, swapped), order), None

    table, order = jax.lax.scan(step, (matrix * scale[:, None], rows), rows)[0]
    return table[:, jnp.argsort(order)] * scale


def product(matrix: Shaped[Array, "*batch n m"], vector: Shaped[Array, "*batch m"]) -> Shaped[Array, "*batch n"]:
    """Matrix times vector, batch by batch; written out, as a call of a library for each small one takes longer."""
    return jnp.sum(matrix * vector[..., None, :], axis=-1)


def of_few(matrix: Float[np.ndarray, "m h"], columns: Shaped[Array, "*batch h n"]) -> Shaped[Array, "*batch m n"]:
    """Constant matrix times matrices; one of few entries written out, as `product` is."""
    if matrix.size > _FEW:
        return matrix @ columns
    return jnp.sum(matrix[:, :, None] * columns[..., None, :, :], axis=-2)


def at_place(part: Shaped[Array, "*p"], place: int, count: int) -> Shaped[Array, "c *p"]:
    """Zeros but for one of so many entries of the leading axis. In the step of a run XLA makes a loop of `.at[...]`."""
    return jnp.pad(part[None], [(place, count - place - 1)] + [(0, 0)] * part.ndim)


def with_entry(every: Shaped[Array, "c *p"], place: int, part: Shaped[Array, "*p"]) -> Shaped[Array, "c *p"]:
    """The same with another entry at one place of the leading axis, likewise without a loop."""
    return jnp.concatenate([every[:place], part[None], every[place + 1 :]])


def among(entries: Shaped[Array, "*b k"], places: Sequence[int], size: int) -> Shaped[Array, "*b n"]:
    """Entries of the trailing axis at their places in zeros, likewise."""
    nothing, known = jnp.zeros_like(entries[..., :1]), list(places)
    one = lambda place: entries[..., (k := known.index(place)) : k + 1] if place in known else nothing  # noqa: E731
    first, last = (min(known), max(known)) if known else (0, -1)
    if known == list(range(first, last + 1)):
        return jnp.pad(entries, [(0, 0)] * (entries.ndim - 1) + [(first, size - last - 1)])
    return jnp.concatenate([one(place) for place in range(size)], axis=-1)


def solve_pairs(matrix: Shaped[Array, "*batch 2 2"], right: Shaped[Array, "*batch 2"]) -> Shaped[Array, "*batch 2"]:
    """Solutions of 2×2 systems."""
    (a, b), (c, d) = (jnp.moveaxis(matrix, (-2, -1), (0, 1))[i] for i in (0, 1))
    p, q = right[..., 0], right[..., 1]
    return jnp.stack([d * p - b * q, a * q - c * p], axis=-1) / (a * d - b * c)[..., None]


def cholesky(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Lower triangular root of a Gram matrix; a row that depends on those before it, as of a tone of the frequency of
    another, gets no column of its own.
    """

    def column(rest: Array, index: Array) -> tuple[Array, Array]:
        pivot = rest[index, index]
        new = pivot > _SAME * matrix[index, index]
        lower = (jnp.arange(len(matrix)) >= index) & new
        found = jnp.where(lower, rest[:, index], 0.0) / jnp.sqrt(jnp.where(new, pivot, 1.0))
        return rest - found[:, None] * found, found

    return jax.lax.scan(column, matrix, jnp.arange(len(matrix)))[1].T


def small_root(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Square root of a matrix of one or two rows whose eigenvalues are positive (Cayley and Hamilton)."""
    if len(matrix) == 1:
        return jnp.sqrt(matrix)
    product_of_roots = jnp.sqrt(matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0])
    sum_of_roots = jnp.sqrt(jnp.trace(matrix) + 2 * product_of_roots)
    return (matrix + product_of_roots * jnp.eye(2)) / sum_of_roots


def exponential(matrix: Shaped[Array, "n n"]) -> Shaped[Array, "n n"]:
    """Matrix exponential by scaling and squaring of a Taylor series of order 18; no decomposition, cheap to
    differentiate.

    For any matrix of any norm, once per run. `device.propagate` has a series of its own for the 4×4 of a device once
    per sample and die: its order is known beforehand, and half of the products and all scaling fall away.
    """
    squarings, scaled = _scaled(matrix)
    one = jnp.eye(matrix.shape[-1], dtype=matrix.dtype)
    total = jax.lax.fori_loop(0, 18, lambda k, total: one + scaled @ total / (18 - k), one)
    return jax.lax.fori_loop(0, squarings, lambda _, m: m @ m, total)


def exponential_and_means(matrix: Shaped[Array, "n n"], highest: int = 2) -> tuple[Array, ...]:
    """e^M and φ_k(M) = ∫₀¹ (1 − τ)^{k−1}/(k − 1)! · e^{Mτ} dτ up to the `highest`, by scaling and squaring as
    `exponential`.
    """
    squarings, scaled = _scaled(matrix)
    one = jnp.eye(matrix.shape[-1], dtype=matrix.dtype)
    last = jax.lax.fori_loop(0, 18, lambda k, total: one + scaled @ total / (18 + highest - k), one)
    parts = [last / math.factorial(highest)]
    for order in range(highest - 1, -1, -1):
        parts.insert(0, one / math.factorial(order) + scaled @ parts[0])

    def double(_: int, parts: tuple[Array, ...]) -> tuple[Array, ...]:
        power, out = parts[0], [parts[0] @ parts[0]]
        for order, part in enumerate(parts[1:], 1):
            total = part
            for lower in range(order - 1, 0, -1):
                total = total + parts[lower] / math.factorial(order - lower)
            out.append((total + power @ part) / 2**order)
        return tuple(out)

    return jax.lax.fori_loop(0, squarings, double, tuple(parts))


def _scaled(matrix: Shaped[Array, "n n"]) -> tuple[Array, Array]:
    """How often a matrix is halved until its norm is one, and what it is then."""
    norm = jnp.max(jnp.sum(jnp.abs(matrix), axis=-1))
    squarings = jnp.clip(jnp.ceil(jnp.log2(norm)), 0, 60).astype(int)
    return squarings, matrix * 2.0 ** (-squarings.astype(matrix.real.dtype))


def semidefinite_root(name: str, matrix: np.ndarray) -> np.ndarray:
    """R with R Rᵀ = `matrix`, symmetric; eigenvalues may be zero, or below it by rounding (1e-9 of the largest).

    Raises `InputError` naming the argument `name` for one that is negative, and for a matrix that is not symmetric.
    """
    for i, j in np.argwhere(~np.isclose(matrix, matrix.T, rtol=1e-9, atol=1e-12 * np.max(np.abs(matrix), initial=0.0))):
        differ = f"entry [{i}][{j}] is {matrix[i, j]:g} and [{j}][{i}] {matrix[j, i]:g}"
        raise InputError(f"Argument `{name}` must be symmetric, but {differ}.")
    try:
        return np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(matrix)
    if values[0] < -1e-9 * values[-1]:
        raise InputError(f"Argument `{name}` must have no negative eigenvalue; lower its off-diagonal entries.")
    return vectors * np.sqrt(np.maximum(values, 0.0))
