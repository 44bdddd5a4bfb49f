"""Inverses of many small matrices at once.

LAPACK takes them one by one and, called from compiled loops on several threads, may wait for itself; elimination
written out vectorises over the batch.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Shaped


def inverse(matrix: Shaped[Array, "n n"]) -> Shaped[Array, "n n"]:
    """Inverse of a small real or complex matrix by Gauss and Jordan with row pivoting, to be batched by `vmap`.

    Its derivative is that of the exact inverse: one Newton-Schulz step around the frozen result.
    """
    frozen = _gauss_jordan(jax.lax.stop_gradient(matrix))
    one = jnp.eye(matrix.shape[0], dtype=matrix.dtype)
    return frozen + frozen @ (one - matrix @ frozen)


def _gauss_jordan(matrix: Array) -> Array:
    size = matrix.shape[0]
    scale = 1.0 / jnp.max(jnp.abs(matrix), axis=1, keepdims=True)
    table = jnp.concatenate([matrix * scale, jnp.eye(size, dtype=matrix.dtype) * scale], axis=1)
    rows = jnp.arange(size)

    def step(table: Array, column: Array) -> tuple[Array, None]:
        entries = jax.lax.dynamic_index_in_dim(table, column, axis=1, keepdims=False)
        pivot = jnp.argmax(jnp.where(rows >= column, jnp.abs(entries), -1.0))
        swapped = jnp.where(rows == column, pivot, jnp.where(rows == pivot, column, rows))
        table, entries = table[swapped], entries[swapped]
        row = table[column] / entries[column]
        table = table - jnp.where(rows == column, 0.0, entries)[:, None] * row
        return jnp.where((rows == column)[:, None], row, table), None

    return jax.lax.scan(step, table, rows)[0][:, size:]


def product(matrix: Shaped[Array, "*batch n m"], vector: Shaped[Array, "*batch m"]) -> Shaped[Array, "*batch n"]:
    """Matrix times vector, batch by batch."""
    return jnp.einsum("...ij,...j->...i", matrix, vector)
