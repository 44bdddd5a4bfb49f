"""One block: what its statistics tell, and where truth and belief are at its end.

At the start of a block the filter expects of its statistics h, linear in the errors of motion, offsets and coefficients
there; noise of variance R is white in them. So each is a scalar measurement of the start,

    v = P h,   S = h v + R,   dx += v (r - h dx) / S,   P -= v vᵀ / S,

and the block's end follows by J = [F 0 T w; 0 1] from the corrected start: what a smoother knows of the start carried
through a linear block is what a filter knows of the end. Coefficients act to first order about the linearisation.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..observers.base import Believed, Innovation
from .algebra import multiplied
from .maps import Maps
from .reading import Scalars, read_off


class Facts(NamedTuple):
    """Of a block, from outside: sines and cosines of the tones at its start, the true and a fixed offset [V], standard
    normal numbers for its statistics, the variance [V²] of a sample's noise as it is and as it is expected, the walk of
    the constants in the block, in unit², what they move by for a unit of each, None where they stand still, and the
    slope of the true rate [rad/s²].
    """

    tones: Float[Array, "2·tones lanes"]
    offset: Float[Array, "2 lanes"]
    fixed: Float[Array, "2 lanes"]
    normal: Float[Array, "k 2 lanes"]
    noise: Float[Array, "2 lanes"]
    expected: Float[Array, "2 lanes"]
    walk: Float[Array, "constants lanes"]
    moves: Float[Array, "constants constants lanes"] | None = None
    slope: Float[Array, " lanes"] | float = 0.0


def advanced(
    motion: Float[Array, "4 lanes"], believed: Believed, maps: Maps, facts: Facts, with_offsets: bool
) -> tuple[Array, Believed, Innovation]:
    """True motion and belief a block later, and what was told that the filter had not expected."""
    mean, covariance = believed
    first = 6 if with_offsets else 4
    w = jnp.concatenate([mean[:4], facts.tones])
    u = jnp.concatenate([motion, w, jnp.ones_like(w[:1])])
    away = mean[first:] - maps.theta
    turned, seen = multiplied(maps.turned, w), multiplied(maps.seen_turned, w)  # (4, p), (k, 2, p)
    offset = facts.offset - (mean[4:6] if with_offsets else facts.fixed)
    true, unexpected = maps.true, maps.unexpected
    if maps.ramp is not None:
        true, unexpected = true + facts.slope * maps.ramp.true, unexpected + facts.slope * maps.ramp.unexpected
    innovation = multiplied(unexpected, u) + maps.ones[:, None] * offset + jnp.sqrt(facts.noise) * facts.normal
    rows = _rows(maps, seen, with_offsets)
    if len(away):
        innovation = innovation - multiplied(seen, away)
    shift, covariance, told = corrected(rows, innovation, facts.expected, covariance)

    moved = multiplied(maps.estimated, w)[:4] + multiplied(maps.free, shift[:4])
    if len(away):
        moved = moved + multiplied(turned, away + shift[first:])
    after = Believed(
        jnp.concatenate([moved, mean[4:] + shift[4:]]),
        covariance_later(covariance, maps.free, maps.walked, turned, facts.walk),
    )
    after = after if facts.moves is None else _moved(after, facts.moves)
    return multiplied(true, u), after, told


def _moved(believed: Believed, moves: Float[Array, "constants constants lanes"]) -> Believed:
    """Where the constants have gone by their own, the motion left where it is."""
    mean, covariance = believed
    jacobian = jnp.zeros_like(covariance).at[4:, 4:].set(moves) + jnp.eye(len(mean))[..., None]
    rows = multiplied(jacobian, covariance)
    return Believed(multiplied(jacobian, mean), multiplied(rows, jnp.swapaxes(jacobian, 0, 1)))


def _rows(maps: Maps, seen: Array, with_offsets: bool) -> Float[Array, "k 2 states lanes"]:
    """h of every statistic."""
    parts = [maps.seen_free]
    if with_offsets:
        parts.append(maps.ones[:, None, None] * jnp.eye(2)[..., None])
    return jnp.concatenate([*parts, seen], axis=2)


def corrected(
    rows: Float[Array, "k 2 states lanes"], innovation: Array, variance: Array, covariance: Array
) -> tuple[Array, Array, Innovation]:
    """Shift of the mean at the start, its covariance, and a channel's innovations as one, those of x first: the root of
    the mean of their squares, each over its variance, times the geometric mean of those.
    """
    count, lanes = len(rows), innovation.shape[-1:]
    flat = lambda array: jnp.swapaxes(array, 0, 1).reshape(-1, *array.shape[2:])  # noqa: E731
    noise = jnp.broadcast_to(variance[:, None], (2, count, *lanes)).reshape(-1, *lanes)
    read = read_off(Scalars(flat(rows), flat(innovation), noise, covariance))
    squares, logarithms = (jnp.sum(part.reshape(2, count, *lanes), axis=1) for part in read[2:])
    spread = jnp.exp(logarithms / count)
    return read.shift, read.covariance, Innovation(tuple(jnp.sqrt(squares / count * spread)), tuple(spread))


def covariance_later(
    covariance: Array, free: Array, walked: Array, turned: Float[Array, "4 p lanes"], walk: Array
) -> Array:
    """J P Jᵀ and what walked meanwhile: of the motion, which goes by `free`, and of the constants."""
    constants, count = covariance[4:, 4:], turned.shape[1]
    rest = jnp.zeros((4, len(constants) - count, *turned.shape[2:]))
    jacobian = jnp.concatenate([free, rest, turned], axis=1)
    rows = multiplied(jacobian, covariance)
    motion, cross = multiplied(rows, jnp.swapaxes(jacobian, 0, 1)) + walked, rows[:, 4:]
    motion = 0.5 * (motion + jnp.swapaxes(motion, 0, 1))
    constants = constants + jnp.eye(len(constants))[..., None] * walk
    top = jnp.concatenate([motion, cross], axis=1)
    return jnp.concatenate([top, jnp.concatenate([jnp.swapaxes(cross, 0, 1), constants], axis=1)])
