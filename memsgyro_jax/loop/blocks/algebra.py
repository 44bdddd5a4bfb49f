"""Small matrices of many dies, which trail: products written out as sums of elementwise ones.

XLA vectorises those over the dies (12 GFlop/s of a core, where a reduction reached 3 and a batched product less).
"""

from collections.abc import Iterable
from functools import reduce
from operator import add
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float


def over_lanes(entries: Iterable[Any], lanes: tuple[int, ...]) -> Array:
    """Nested tuples of numbers as one array, each number repeated for all dies."""
    if isinstance(entries, tuple | list):
        return jnp.stack([over_lanes(entry, lanes) for entry in entries])
    return jnp.broadcast_to(jnp.asarray(entries, float), lanes)


def multiplied(
    a: Float[Array, "... rows inner lanes"], b: Float[Array, "... inner columns lanes"]
) -> Float[Array, "... rows columns lanes"]:
    """a b, for what stands in front of the last three axes too."""
    return reduce(add, (a[..., :, k, None, :] * b[..., k, None, :, :] for k in range(b.shape[-3])))


def applied_to(a: Float[Array, "... inner lanes"], vector: Float[Array, "inner lanes"]) -> Float[Array, "... lanes"]:
    """a v."""
    return reduce(add, (a[..., k, :] * vector[k] for k in range(a.shape[-2])))


def weighted(weights: Float[Array, "some lanes"], parts: Float[Array, "some ... lanes"]) -> Float[Array, "... lanes"]:
    """The sum of `parts`, each times its weight."""
    return reduce(add, (w * p for w, p in zip(weights, parts, strict=True)))


def weighted_by(
    weights: Float[Array, "rows some lanes"], parts: Float[Array, "some ... lanes"]
) -> Float[Array, "rows ... lanes"]:
    """Sums of `parts`, one for each row of weights."""
    middle = (1,) * (parts.ndim - 2)
    wide = weights.reshape(weights.shape[:2] + middle + weights.shape[2:])
    return reduce(add, (wide[:, i] * part[None] for i, part in enumerate(parts)))
