"""Small matrices of many dies, which trail: products written out as sums of elementwise ones.

XLA vectorises those over the dies (12 GFlop/s of a core, where a reduction reached 3 and a batched product less). The
product is a primitive of JAX's, whose derivative is made of products again: that of a sum written out is made of padded
arrays, many times as long to run and to compile. A derivative goes part by part, in a loop: XLA would repeat a product
in each that takes it in. Which axes a product sums over is its parameter: a derivative sums over others, and a matrix
turned for it would be copied.
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


def matrix_over_lanes(matrix: Array, lanes: tuple[int, ...]) -> Float[Array, "rows columns lanes"]:
    """A matrix, of one or of many dies, repeated for all."""
    return jnp.broadcast_to(matrix.reshape(*matrix.shape[:2], -1), (*matrix.shape[:2], *lanes))


def multiplied(a: Float[Array, "... inner lanes"], b: Float[Array, "inner ... lanes"]) -> Float[Array, "... lanes"]:
    """The sum over the last of the axes of `a` and the first of `b`, dies apart."""
    lanes = jnp.broadcast_shapes(a.shape[-1:], b.shape[-1:])
    rows, columns = a.shape[:-2], b.shape[1:-1]
    flat = a.reshape(-1, *a.shape[-2:]), b.reshape(b.shape[0], -1, b.shape[-1])
    pair = (jnp.broadcast_to(part, (*part.shape[:2], *lanes)) for part in flat)
    return _PRODUCT.bind(*pair, over=(1, 0), looped=False).reshape(*rows, *columns, *lanes)


def _looped(a: Array, b: Array, over: tuple[int, int]) -> Array:
    """The same over these axes, in parts."""
    return _PRODUCT.bind(a, b, over=over, looped=True)


def _made(a: Array, b: Array, *, over: tuple[int, int], looped: bool) -> Array:
    """The sum over one axis of each of two matrices, as it is computed."""
    inner, rows = a.shape[over[0]], a.shape[1 - over[0]]
    if not looped or inner == 1 or (rows == 1 and inner <= _AT_ONCE):
        return reduce(add, (_along(a, over[0], k)[:, None] * _along(b, over[1], k)[None] for k in range(inner)))
    if inner > _AT_ONCE:
        some = _divisor(inner)

        def more(place, total):
            part = (
                jax.lax.dynamic_slice_in_dim(of, some * place, some, axis)
                for of, axis in zip((a, b), over, strict=True)
            )
            return total + _made(*part, over=over, looped=False)

        return jax.lax.fori_loop(0, inner // some, more, jnp.zeros((rows, b.shape[1 - over[1]], *b.shape[2:])))
    some = _divisor(rows)

    def part(place):
        these = jax.lax.dynamic_slice_in_dim(a, some * place, some, 1 - over[0])
        return _made(these, b, over=over, looped=False)

    return jax.lax.map(part, jnp.arange(rows // some)).reshape(rows, -1, *b.shape[2:])


def _along(matrix: Array, axis: int, place: int) -> Array:
    """The row or column of a matrix at a place of one axis."""
    return matrix[:, place] if axis else matrix[place]


_AT_ONCE = 16  # rows, or products of a sum, in a turn of a loop


def _divisor(number: int) -> int:
    """The largest part of a number that is done at once; not all, since XLA takes a loop of one turn apart."""
    return max(part for part in range(1, min(number // 2, _AT_ONCE) + 1) if number % part == 0)


def _shaped(a: Any, b: Any, *, over: tuple[int, int], looped: bool) -> jax.core.ShapedArray:
    shape = a.shape[1 - over[0]], b.shape[1 - over[1]], *b.shape[2:]
    return jax.core.ShapedArray(shape, jnp.result_type(a.dtype, b.dtype))


def _pulled(pull: Any, a: Any, b: Any, *, over: tuple[int, int], looped: bool) -> tuple[Any, Any]:
    """The pull on one factor of a product, whose other is given, with its axes as they are: nothing is transposed."""
    if isinstance(pull, ad.Zero):
        return None, None
    of_a, of_b = 1 - over[0], 1 - over[1]  # where what is not summed over stands
    if ad.is_undefined_primal(a):
        return (_looped(pull, b, (1, of_b)) if over[0] else _looped(b, pull, (of_b, 1))), None
    return None, (_looped(pull, a, (0, of_a)) if over[1] else _looped(a, pull, (of_a, 0)))


def _batched(pair: tuple[Array, Array], axes: tuple[Any, Any], **how: Any) -> tuple[Array, int]:
    return among_dies(lambda *given: _PRODUCT.bind(*given, **how), pair, axes)


def among_dies(bind: Any, given: Any, axes: Any) -> tuple[Any, Any]:
    """A batch of what works on dies apart, as so many more dies."""
    size = next(part.shape[axis] for part, axis in zip(given, axes, strict=True) if axis is not None)

    def joined(part: Array, axis: int | None) -> Array:
        beside = part[..., None, :] if axis is None else jnp.moveaxis(part, axis, -2)
        return jnp.broadcast_to(beside, (*beside.shape[:-2], size, beside.shape[-1])).reshape(*beside.shape[:-2], -1)

    made = bind(*map(joined, given, axes))
    made = jax.tree.map(lambda part: part.reshape(*part.shape[:-1], size, -1), made)
    return made, jax.tree.map(lambda part: part.ndim - 2, made)


_PRODUCT = Primitive("small_matrix_product")
_PRODUCT.def_impl(jax.jit(_made, static_argnames=("over", "looped")))
_PRODUCT.def_abstract_eval(_shaped)
mlir.register_lowering(_PRODUCT, mlir.lower_fun(_made, multiple_results=False))
batching.primitive_batchers[_PRODUCT] = _batched
ad.primitive_transposes[_PRODUCT] = _pulled
ad.defjvp(
    _PRODUCT,
    lambda moved, a, b, over, **_: _looped(moved, b, over),
    lambda moved, a, b, over, **_: _looped(a, moved, over),
)
