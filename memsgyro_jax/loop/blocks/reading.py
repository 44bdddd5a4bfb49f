"""What statistics tell a filter: one scalar measurement after the other, and the derivative of all of them.

Of a measurement r = h dx + noise of variance R, with e what the shift s of the mean has not explained yet,

    v = P h,   S = h v + R,   e = r - h s,   s += v e / S,   P -= v vᵀ / S.

Backwards, with a = P̄ v, where P̄ and s̄ pull at what it left and q̄ and l̄ at e²/S and ln S,

    S̄ = (v a - e s̄ v) / S² - q̄ e²/S² + l̄/S,    v̄ = (s̄ e - 2 a) / S + S̄ h,    ē = s̄ v / S + 2 q̄ e / S,
    h̄ = S̄ v + P v̄ - ē s,    s̄ -= ē h,    P̄ += (v̄ hᵀ + h v̄ᵀ) / 2,    r̄ = ē,    R̄ = S̄,

for which P += v vᵀ / S is gone back to: of the way there nothing but v, S and e is kept.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float

from memsgyro_jax.device.small import dot

from .algebra import among_dies, multiplied


class Scalars(NamedTuple):
    """What is measured, of n scalars, and before it: the covariance of what they measure."""

    rows: Float[Array, "n states lanes"]
    innovation: Float[Array, "n lanes"]
    variance: Float[Array, "n lanes"]
    covariance: Float[Array, "states states lanes"]


class Read(NamedTuple):
    """What was told: by how much the mean shifts, the covariance, and of each scalar e²/S and ln S."""

    shift: Float[Array, "states lanes"]
    covariance: Float[Array, "states states lanes"]
    squares: Float[Array, "n lanes"]
    logarithms: Float[Array, "n lanes"]


class _Way(NamedTuple):
    """Of each scalar v, e and 1/S."""

    v: Float[Array, "n states lanes"]
    error: Float[Array, "n lanes"]
    inverse: Float[Array, "n lanes"]


@jax.custom_jvp
def read_off(given: Scalars) -> Read:
    """All scalars, one after the other."""
    return _read(given)[0]


@read_off.defjvp
def _slopes(given: tuple[Scalars], moved: tuple[Scalars]) -> tuple[Read, Read]:
    read, way = _read(*given)
    return read, Read._make(_TANGENT.bind(*given[0], read.shift, read.covariance, *way, *moved[0]))


def _read(given: Scalars) -> tuple[Read, _Way]:
    def one(carry, measured):
        shift, covariance = carry
        h, r, noise = measured
        v = multiplied(covariance, h)
        inverse = 1.0 / (dot(h, v) + noise)
        error = r - dot(h, shift)
        gain = v * inverse
        return (shift + gain * error, covariance - gain[:, None] * v[None]), _Way(v, error, inverse)

    start = jnp.zeros_like(given.rows[0]), given.covariance
    (shift, covariance), way = jax.lax.scan(one, start, given[:3])
    return Read(shift, covariance, way.error**2 * way.inverse, -jnp.log(way.inverse)), way


_KNOWN = len(Scalars._fields) + 2 + len(_Way._fields)  # of what is given to the derivative; behind it stands what moves


def _moved(*parts: Array) -> tuple[Array, ...]:
    """The derivative forwards."""
    given, moved = Scalars(*parts[: len(Scalars._fields)]), Scalars(*parts[_KNOWN:])
    return tuple(jax.jvp(lambda *given: _read(Scalars(*given))[0], tuple(given), tuple(moved))[1])


def _pulled(pulls: tuple[Any, ...], *parts: Any) -> tuple[Any, ...]:
    """And backwards. What a turn tells is stacked by the next one: XLA would join it with the pull at the covariance,
    and a loop over both would write the whole stack in every turn."""
    given, way = Scalars(*parts[: len(Scalars._fields)]), _Way(*parts[_KNOWN - len(_Way._fields) : _KNOWN])
    shift, covariance = parts[len(Scalars._fields) : len(Scalars._fields) + 2]
    pull = Read._make(jnp.zeros(p.aval.shape) if isinstance(p, ad.Zero) else p for p in pulls)

    def back(carry, was):
        (pull_shift, pulled, shift, covariance), before = carry
        h, v, error, inverse, square, logarithm = was
        gain, a, along = v * inverse, multiplied(pulled, v), dot(pull_shift, v)
        error_there = error * inverse
        covariance = covariance + gain[:, None] * v[None]
        shift = shift - gain * error
        pull_error = along * inverse + 2.0 * square * error_there
        pull_spread = (dot(v, a) * inverse - along * error_there) * inverse - square * error_there**2
        pull_spread = pull_spread + logarithm * inverse
        pull_v = pull_shift * error_there - 2.0 * inverse * a + pull_spread * h
        pull_h = pull_spread * v + multiplied(covariance, pull_v) - pull_error * shift
        half = 0.5 * pull_v[:, None] * h[None]
        carry = pull_shift - pull_error * h, pulled + half + jnp.swapaxes(half, 0, 1), shift, covariance
        return (carry, (pull_h, pull_error, pull_spread)), before

    even = 0.5 * (pull.covariance + jnp.swapaxes(pull.covariance, 0, 1))
    nothing = given.rows[0], *(given.innovation[0],) * 2
    start = (pull.shift, even, shift, covariance), nothing
    measured = (given.rows, *way, pull.squares, pull.logarithms)
    ((_, at_start, _, _), first), later = jax.lax.scan(back, start, measured, reverse=True)
    told = (jnp.concatenate([one[None], rest[:-1]]) for one, rest in zip(first, later, strict=True))
    moving = zip((*told, at_start), parts[_KNOWN:], strict=True)
    return (None,) * _KNOWN + tuple(p if ad.is_undefined_primal(part) else None for p, part in moving)


_TANGENT = Primitive("reading_tangent")
_TANGENT.multiple_results = True
_TANGENT.def_impl(jax.jit(_moved))
_TANGENT.def_abstract_eval(lambda *parts: (*parts[_KNOWN - 5 : _KNOWN - 3], *(parts[_KNOWN - 1],) * 2))
mlir.register_lowering(_TANGENT, mlir.lower_fun(_moved, multiple_results=True))
batching.primitive_batchers[_TANGENT] = lambda parts, axes: among_dies(_TANGENT.bind, parts, axes)
ad.primitive_transposes[_TANGENT] = _pulled
