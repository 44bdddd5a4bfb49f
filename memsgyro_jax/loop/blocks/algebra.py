"""Small matrices of many dies, which trail: products written out as sums of elementwise ones.

XLA vectorises those over the dies (12 GFlop/s of a core, where a reduction reached 3 and a batched product less). The
product is a primitive of JAX's, whose derivative is made of products again: that of a sum written out is made of padded
arrays, many times as long to run and to compile. A derivative goes row by row, in a loop: XLA would repeat a product in
each that takes it in.
"""

from collections.abc import Iterable
from functools import reduce
from operator import add
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float


def over_lanes(entries: Iterable[Any], lanes: tuple[int, ...]) -> Array:
    """Nested tuples of numbers as one array, each number repeated for all dies."""
    if isinstance(entries, tuple | list):
        return jnp.stack([over_lanes(entry, lanes) for entry in entries])
    return jnp.broadcast_to(jnp.asarray(entries, float), lanes)


def multiplied(
    a: Float[Array, "... rows inner lanes"], b: Float[Array, "... inner columns lanes"], looped: bool = False
) -> Float[Array, "... rows columns lanes"]:
    """a b, for what stands in front of the last three axes too; `looped` row by row, to the same bits."""
    return _PRODUCT.bind(jnp.asarray(a), jnp.asarray(b), looped=looped)


def applied_to(a: Float[Array, "... inner lanes"], vector: Float[Array, "inner lanes"]) -> Float[Array, "... lanes"]:
    """a v."""
    return multiplied(a.reshape(-1, *a.shape[-2:]), vector[:, None]).reshape(*a.shape[:-2], -1)


def weighted(weights: Float[Array, "some lanes"], parts: Float[Array, "some ... lanes"]) -> Float[Array, "... lanes"]:
    """The sum of `parts`, each times its weight."""
    return weighted_by(weights[None], parts)[0]


def weighted_by(
    weights: Float[Array, "rows some lanes"], parts: Float[Array, "some ... lanes"]
) -> Float[Array, "rows ... lanes"]:
    """Sums of `parts`, one for each row of weights."""
    flat = parts.reshape(len(parts), -1, parts.shape[-1])
    return multiplied(weights, flat).reshape(len(weights), *parts.shape[1:-1], -1)


def _made(a: Array, b: Array, *, looped: bool) -> Array:
    """The product, as it is computed."""
    if not looped or (a.ndim == b.ndim == 3 and len(a) == 1):
        return reduce(add, (a[..., :, k, None, :] * b[..., k, None, :, :] for k in range(b.shape[-3])))
    if a.ndim == b.ndim == 3:
        return jax.lax.map(lambda row: _made(row[None], b, looped=False)[0], a)
    if b.ndim == 3:
        return _made(a.reshape(-1, *a.shape[-2:]), b, looped=True).reshape(*a.shape[:-2], *b.shape[-2:])
    front = jnp.broadcast_shapes(a.shape[:-3], b.shape[:-3])
    flat = tuple(jnp.broadcast_to(part, front + part.shape[-3:]).reshape(-1, *part.shape[-3:]) for part in (a, b))
    found = jax.lax.map(lambda pair: _made(*pair, looped=True), flat)
    return found.reshape(*front, *found.shape[1:])


def _shaped(a: Any, b: Any, *, looped: bool) -> jax.core.ShapedArray:
    front = jnp.broadcast_shapes(a.shape[:-3], b.shape[:-3])
    lanes = jnp.broadcast_shapes(a.shape[-1:], b.shape[-1:])
    return jax.core.ShapedArray((*front, a.shape[-3], b.shape[-2], *lanes), jnp.result_type(a.dtype, b.dtype))


def _pulled(pull: Any, a: Any, b: Any, *, looped: bool) -> tuple[Any, Any]:
    """The pull on one factor of a product, whose other is given."""
    if isinstance(pull, ad.Zero):
        return None, None
    if ad.is_undefined_primal(a):
        return _summed_to(a.aval.shape, multiplied(pull, jnp.swapaxes(b, -3, -2), True)), None
    return None, _summed_to(b.aval.shape, multiplied(jnp.swapaxes(a, -3, -2), pull, True))


def _summed_to(shape: tuple[int, ...], pull: Array) -> Array:
    """Of what was repeated along an axis the sum over it."""
    pull = jnp.sum(pull, axis=tuple(range(pull.ndim - len(shape))))
    repeated = tuple(axis for axis, size in enumerate(shape) if size != pull.shape[axis])
    return jnp.sum(pull, axis=repeated, keepdims=True)


def _batched(pair: tuple[Array, Array], axes: tuple[Any, Any], *, looped: bool) -> tuple[Array, int]:
    front = max(part.ndim - (axis is not None) for part, axis in zip(pair, axes, strict=True))
    a, b = (_fronted(part, axis, front) for part, axis in zip(pair, axes, strict=True))
    return multiplied(a, b, looped), 0


def _fronted(part: Array, axis: Any, rank: int) -> Array:
    """With the batch as the first of `rank` + 1 axes."""
    if axis is None:
        return part
    part = jnp.moveaxis(part, axis, 0)
    return part.reshape(part.shape[:1] + (1,) * (rank + 1 - part.ndim) + part.shape[1:])


_PRODUCT = Primitive("small_matrix_product")
_PRODUCT.def_impl(jax.jit(_made, static_argnames="looped"))
_PRODUCT.def_abstract_eval(_shaped)
mlir.register_lowering(_PRODUCT, mlir.lower_fun(_made, multiple_results=False))
batching.primitive_batchers[_PRODUCT] = _batched
ad.primitive_transposes[_PRODUCT] = _pulled
ad.defjvp(
    _PRODUCT,
    lambda moved, a, b, **_: multiplied(moved, b, True),
    lambda moved, a, b, **_: multiplied(a, moved, True),
)
