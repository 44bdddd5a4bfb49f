"""One block: what its statistics tell, and where truth and belief are at its end.

At the start of a block the filter expects of its statistics h, linear in the errors of motion, offsets and coefficients
there; noise of variance R is white in them. So each is a scalar measurement of the start,

    v = P h,   S = h v + R,   dx += v (r - h dx) / S,   P -= v vᵀ / S,

and the block's end follows by J = [F 0 T w; 0 1] from the corrected start: what a smoother knows of the start carried
through a linear block is what a filter knows of the end. Coefficients act to first order about the linearisation.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from memsgyro_jax.device.small import dot

from ..observers.base import Believed, Innovation
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
) -> tuple[Array, Believed, Innovation]:
    """True motion and belief a block later, and what was told that the filter had not expected."""
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
    shift, covariance, read = corrected(rows, innovation, facts.expected, covariance)

    moved = applied_to(maps.estimated, w)[:4] + applied_to(maps.free, shift[:4])
    if len(away):
        moved = moved + weighted(away + shift[first:], turned)
    mean = jnp.concatenate([moved, mean[4:] + shift[4:]])
    covariance = covariance_later(covariance, maps.free, maps.walked, turned, facts.walk)
    return applied_to(maps.true, u), Believed(mean, covariance), read


def _rows(maps: Maps, seen: Array, with_offsets: bool) -> Float[Array, "k 2 states lanes"]:
    """h of every statistic."""
    parts = [maps.seen_free]
    if with_offsets:
        parts.append(maps.ones[:, None, None] * jnp.eye(2)[..., None])
    return jnp.concatenate([*parts, jnp.swapaxes(seen, 1, 2)], axis=2)


class _Read(NamedTuple):
    """What statistics told: by how much the mean at the start shifts, its covariance, and of each channel's innovations
    Σ e²/S and Σ ln S.
    """

    shift: Float[Array, "states lanes"]
    covariance: Float[Array, "states states lanes"]
    squares: Float[Array, "channels lanes"]
    logarithms: Float[Array, "channels lanes"]


def corrected(
    rows: Float[Array, "k 2 states lanes"], innovation: Array, variance: Array, covariance: Array
) -> tuple[Array, Array, Innovation]:
    """Shift of the mean at the start, its covariance, and a channel's innovations as one: the root of the mean of their
    squares, each over its variance, times the geometric mean of those.
    """
    read, count = _both(jnp.swapaxes(rows, 0, 1), jnp.swapaxes(innovation, 0, 1), variance, covariance), len(rows)
    spread = jnp.exp(read.logarithms / count)
    return read.shift, read.covariance, Innovation(tuple(jnp.sqrt(read.squares / count * spread)), tuple(spread))


@jax.custom_jvp
def _both(
    rows: Float[Array, "channels k states lanes"], innovation: Float[Array, "channels k lanes"],
    variance: Float[Array, "channels lanes"], covariance: Float[Array, "states states lanes"],
) -> _Read:  # fmt: skip
    """One scalar after the other, those of x first."""

    def one(carry, measured):
        shift, covariance = carry
        h, r, noise = measured
        v = applied_to(covariance, h)
        inverse = 1.0 / (dot(h, v) + noise)
        error = r - dot(h, shift)
        gain = v * inverse
        return (shift + gain * error, covariance - gain[:, None] * v[None]), (error**2 * inverse, inverse)

    flat = lambda array: array.reshape(-1, *array.shape[2:])  # noqa: E731
    noise = jnp.broadcast_to(variance[:, None], innovation.shape)
    start = jnp.zeros_like(rows[0, 0]), covariance
    (shift, covariance), told = jax.lax.scan(one, start, (flat(rows), flat(innovation), flat(noise)))
    squares, inverse = (part.reshape(innovation.shape) for part in told)
    return _Read(shift, covariance, jnp.sum(squares, axis=1), -jnp.sum(jnp.log(inverse), axis=1))


@_both.defjvp
def _both_slopes(given: tuple, moved: tuple) -> tuple[_Read, _Read]:
    return _both(*given), jax.jvp(_one_by_one, given, moved)[1]


def _one_by_one(rows: Array, innovation: Array, variance: Array, covariance: Array) -> _Read:
    """One channel after the other."""
    shift, squares, logarithms = jnp.zeros_like(rows[0, 0]), [], []
    for h, r, noise in zip(rows, innovation, variance, strict=True):
        read = _read(h, r - applied_to(h, shift), noise, covariance)
        shift, covariance = shift + read.shift, read.covariance
        squares.append(read.squares)
        logarithms.append(read.logarithms)
    return _Read(shift, covariance, jnp.concatenate(squares), jnp.concatenate(logarithms))


@jax.custom_jvp
def _read(
    rows: Float[Array, "k states lanes"], innovation: Float[Array, "k lanes"], variance: Float[Array, " lanes"],
    covariance: Float[Array, "states states lanes"],
) -> _Read:  # fmt: skip
    """Of one channel alone."""
    return _both(rows[None], innovation[None], variance[None], covariance)


@_read.defjvp
def _read_slopes(given: tuple, moved: tuple) -> tuple[_Read, _Read]:
    """Of all of them at once, with M = HᵀH / R, A = 1 - P⁺ M, K = P⁺Hᵀ / R and the rest z = (r - H s) / R:

        dP⁺ = A dP Aᵀ - P⁺ dM P⁺,    ds = A dP Hᵀz + P⁺ dHᵀ z + K (dr - dH s - z dR),
        dΣe²/S = 2 zᵀ (dr - dH s) - |z|² dR - zᵀH dP Hᵀz,    dΣln S = tr(Hᵀ S⁻¹ H dP) + 2 tr(K dH) + tr(S⁻¹) dR

    of which nothing but products is to be turned around: step by step every covariance would be kept.
    """
    rows, innovation, variance, _ = given
    times = partial(multiplied, looped=True)
    d_rows, d_innovation, d_variance, d_covariance = moved
    found = _read(*given)
    shift, after = found.shift, found.covariance
    turned, count = jnp.swapaxes(rows, 0, 1), len(rows)
    weighed = turned / variance
    information, gain = times(weighed, rows), times(after, weighed)
    left = (innovation - applied_to(rows, shift)) / variance
    kept = jnp.eye(len(shift))[..., None] - times(after, information)
    told = applied_to(turned, left)

    d_turned = jnp.swapaxes(d_rows, 0, 1)
    half = times(d_turned, jnp.swapaxes(weighed, 0, 1))
    d_information = half + jnp.swapaxes(half, 0, 1) - information * (d_variance / variance)
    d_kept = times(kept, d_covariance)
    d_after = times(d_kept, jnp.swapaxes(kept, 0, 1)) - times(times(after, d_information), after)
    d_left = d_innovation - applied_to(d_rows, shift)
    d_shift = applied_to(d_kept, told) + applied_to(after, applied_to(d_turned, left))
    d_shift = d_shift + applied_to(gain, d_left - left * d_variance)
    d_squares = 2.0 * dot(left, d_left) - dot(left, left) * d_variance - dot(told, applied_to(d_covariance, told))
    seen = times(information, kept)
    trace = (count - jnp.sum(rows * jnp.swapaxes(gain, 0, 1), axis=(0, 1))) / variance
    d_logarithms = jnp.sum(seen * d_covariance, axis=(0, 1)) + 2.0 * jnp.sum(gain * d_turned, axis=(0, 1))
    return found, _Read(d_shift, d_after, d_squares[None], (d_logarithms + trace * d_variance)[None])


def covariance_later(
    covariance: Array, free: Array, walked: Array, turned: Float[Array, "p 4 lanes"], walk: Array
) -> Array:
    """J P Jᵀ and what walked meanwhile: of the motion, which goes by `free`, and of the constants."""
    constants, count = covariance[4:, 4:], len(turned)
    columns = jnp.swapaxes(turned, 0, 1)  # (4, p)
    rest = jnp.zeros((4, len(constants) - count, *columns.shape[2:]))
    jacobian = jnp.concatenate([free, rest, columns], axis=1)
    rows = multiplied(jacobian, covariance)
    motion, cross = multiplied(rows, jnp.swapaxes(jacobian, 0, 1)) + walked, rows[:, 4:]
    motion = 0.5 * (motion + jnp.swapaxes(motion, 0, 1))
    constants = constants + jnp.eye(len(constants))[..., None] * walk
    top = jnp.concatenate([motion, cross], axis=1)
    return jnp.concatenate([top, jnp.concatenate([jnp.swapaxes(cross, 0, 1), constants], axis=1)])
