"""One block: what its statistics tell, and where truth and belief are at its end.

At the start of a block the filter expects of its statistics h, linear in the errors of motion, offsets and coefficients
there; noise of variance R is white in them. So each is a scalar measurement of the start,

    v = P h,   S = h v + R,   dx += v (r - h dx) / S,   P -= v vᵀ / S,

and the block's end follows by J = [F 0 T w; 0 1] from the corrected start: what a smoother knows of the start carried
through a linear block is what a filter knows of the end. Coefficients act to first order about the linearisation.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from memsgyro_jax.device.small import dot

from ..observers.base import Believed
from .algebra import applied_to, multiplied, weighted
from .maps import Maps


class Facts(NamedTuple):
    """Of a block, from outside: sines and cosines of the tones at its start, the true and a fixed offset [V], standard
    normal numbers for its statistics, the variance [V²] of a sample's noise as it is and as it is expected, and the
    walk of the constants in the block, in unit².
    """

    tones: Float[Array, "2·tones lanes"]
    offset: Float[Array, "2 lanes"]
    fixed: Float[Array, "2 lanes"]
    normal: Float[Array, "k 2 lanes"]
    noise: Float[Array, "2 lanes"]
    expected: Float[Array, "2 lanes"]
    walk: Float[Array, "constants lanes"]


def advanced(
    motion: Float[Array, "4 lanes"], believed: Believed, maps: Maps, facts: Facts, with_offsets: bool
) -> tuple[Array, Believed, Float[Array, "k 2 lanes"]]:
    """True motion, belief and the squared innovations over their variances, a block later."""
    mean, covariance = believed
    first = 6 if with_offsets else 4
    w = jnp.concatenate([mean[:4], facts.tones])
    u = jnp.concatenate([motion, w, jnp.ones_like(w[:1])])
    away = mean[first:] - maps.theta
    turned, seen = applied_to(maps.turned, w), applied_to(maps.seen_turned, w)  # (p, 4), (k, p, 2)
    offset = facts.offset - (mean[4:6] if with_offsets else facts.fixed)
    innovation = applied_to(maps.unexpected, u) + maps.ones[:, None] * offset + jnp.sqrt(facts.noise) * facts.normal
    rows = _rows(maps, seen, with_offsets)
    if len(away):
        innovation = innovation - weighted(away, jnp.swapaxes(seen, 0, 1))
    shift, covariance, squares = _corrected(rows, innovation, facts.expected, covariance)

    moved = applied_to(maps.estimated, w)[:4] + applied_to(maps.free, shift[:4])
    if len(away):
        moved = moved + weighted(away + shift[first:], turned)
    mean = jnp.concatenate([moved, mean[4:] + shift[4:]])
    covariance = _carried(covariance, maps, turned, facts.walk)
    return applied_to(maps.true, u), Believed(mean, covariance), squares


def _rows(maps: Maps, seen: Array, with_offsets: bool) -> Float[Array, "k 2 states lanes"]:
    """h of every statistic."""
    parts = [maps.seen_free]
    if with_offsets:
        parts.append(maps.ones[:, None, None] * jnp.eye(2)[..., None])
    return jnp.concatenate([*parts, jnp.swapaxes(seen, 1, 2)], axis=2)


def _corrected(
    rows: Float[Array, "k 2 states lanes"], innovation: Array, variance: Array, covariance: Array
) -> tuple[Array, Array, Array]:
    """Shift of the mean at the start, its covariance, and squared innovations over their variances."""
    size, states = rows.shape[0] * 2, rows.shape[2]

    def one(carry, measured):
        shift, covariance = carry
        h, r, noise = measured
        v = applied_to(covariance, h)
        inverse = 1.0 / (dot(h, v) + noise)
        error = r - dot(h, shift)
        gain = v * inverse
        return (shift + gain * error, covariance - gain[:, None] * v[None]), error**2 * inverse

    spread = jnp.broadcast_to(variance[None], innovation.shape)
    flat = lambda array: array.reshape(size, *array.shape[2:])  # noqa: E731
    start = (jnp.zeros((states, *innovation.shape[2:])), covariance)
    (shift, covariance), squares = jax.lax.scan(one, start, (flat(rows), flat(innovation), flat(spread)))
    return shift, covariance, squares.reshape(innovation.shape)


def _carried(covariance: Array, maps: Maps, turned: Float[Array, "p 4 lanes"], walk: Array) -> Array:
    """J P Jᵀ and what walked meanwhile."""
    constants, count = covariance[4:, 4:], len(turned)
    columns = jnp.swapaxes(turned, 0, 1)  # (4, p)
    rest = jnp.zeros((4, len(constants) - count, *columns.shape[2:]))
    jacobian = jnp.concatenate([maps.free, rest, columns], axis=1)
    rows = multiplied(jacobian, covariance)
    motion, cross = multiplied(rows, jnp.swapaxes(jacobian, 0, 1)) + maps.walked, rows[:, 4:]
    motion = 0.5 * (motion + jnp.swapaxes(motion, 0, 1))
    constants = constants + jnp.eye(len(constants))[..., None] * walk
    top = jnp.concatenate([motion, cross], axis=1)
    return jnp.concatenate([top, jnp.concatenate([jnp.swapaxes(cross, 0, 1), constants], axis=1)])
