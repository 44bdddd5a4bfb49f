"""Information on the rate from a steady motion of several tones, in closed form: no sample is ever visited.

With forces held over samples, tones U_k at frequencies ω_k (z_k = exp(iω_k h)) keep the motion

    x_n = Re Σ_k X_k z_k^n,   X_k = R_k P U_k z_k^½,   R_k = (z_k - A)^-1

and what an unknown θ changes of it, from a common start on and with the commands held, is the same sum with
dX_k = R_k (dA X_k + dP U_k z_k^½), plus free motion that cancels it at time zero. Every sensitivity is therefore a sum
of exponentials (tones, the two modes, and 1 for offsets), and the information, the sum over samples of products of two
of them, is a sum of geometric series. The result is that of `information_bound` for the same commands.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.linalg import cholesky, solve_pairs
from memsgyro_jax.device.gyro import X, Y

from .plant import Plant


_NOTHING = 1e-22  # square of what is left of a column of length one that depends on the others


class Tones(NamedTuple):
    """Steady motion: displacement = Re Σ amplitude · exp(iωt), ω in rad/s, amplitudes in m, per tone and axis."""

    omega: Float[Array, " tones"]
    amplitude: Complex[Array, "tones 2"]


class Held(NamedTuple):
    """What keeps a steady motion: force phasors [N], and the phasors of (x, y, vx, vy) at time zero."""

    force: Complex[Array, "tones 2"]
    motion: Complex[Array, "tones 4"]


def held(die: Plant, tones: Tones, period: float) -> Held:
    """Forces, held over samples and taken in their middles, under which the displacement at the samples is `tones`."""
    _, inputs = _responses(die, tones.omega, period)
    force = solve_pairs(inputs[:, :2], tones.amplitude)
    return Held(force, jnp.einsum("kij,kj->ki", inputs, force))


def _responses(die: Plant, omega: Array, period: float) -> tuple[Array, Array]:
    """Resolvent (tones, 4, 4), and motion per force (tones, 4, 2)."""
    turn = jnp.exp(1j * omega * period)
    resolvent = jnp.einsum("im,km,mj->kij", die.shapes, 1.0 / (turn[:, None] - die.poles), die.left)
    return resolvent, resolvent @ die.push * jnp.exp(0.5j * omega * period)[:, None, None]


def sensitivities(
    die: Plant, tones: Tones, period: float, samples: int, signals: tuple[int, int]
) -> Float[Array, "rows unknowns"]:
    """Derivatives of the whitened records by the columns of `plant.unknowns`, as few rows as there are exponentials.

    `signals` are the entries of the motion that the two channels show. Rows stand for orthonormal combinations of the
    exponentials, so that products of columns are those of the records themselves.
    """
    resolvent, inputs = _responses(die, tones.omega, period)
    force = solve_pairs(inputs[:, :2], tones.amplitude)
    motion = jnp.einsum("kij,kj->ki", inputs, force)
    pushed = force * jnp.exp(0.5j * tones.omega * period)[:, None]
    kick = jnp.einsum("cij,kj->kic", die.full_slopes, motion) + jnp.einsum("cij,kj->kic", die.push_slopes, pushed)
    slopes = resolvent @ kick  # (tones, 4, changes)
    free = jnp.concatenate([jnp.eye(4), -jnp.sum(slopes, axis=0).real], axis=1)  # starts of the free motion
    ring = 2.0 * jnp.einsum("im,mj,jc->mic", die.shapes[:, :2], die.left[:2], free)

    seen, weight = jnp.asarray(signals), die.scale / die.noise
    none = lambda rows, columns: jnp.zeros((rows, 2, columns))  # noqa: E731
    moving = motion[:, 2:] if signals == (X, Y) else 1j * tones.omega[:, None] * motion[:, 2:]
    late = -moving[:, :, None] * jnp.eye(2)
    tone_rows = jnp.concatenate([none(len(motion), 6), slopes[:, seen], late], axis=2) * weight[:, None]
    mode_rows = jnp.concatenate([ring[:, seen, :4], none(2, 2), ring[:, seen, 4:], none(2, 2)], axis=2)
    constant = none(1, tone_rows.shape[2]).at[0, (0, 1), (4, 5)].set(1.0 / die.noise)
    rows = jnp.concatenate([constant, tone_rows, mode_rows * weight[:, None]])
    exponents = jnp.concatenate([jnp.zeros(1), 1j * tones.omega * period, jnp.log(die.poles[:2])])

    real = jnp.concatenate([rows.real, -rows.imag[1:]])  # the constant has no imaginary part
    mixed = jnp.einsum("ab,ajp->bjp", cholesky(_gram(exponents, samples)), real)
    return mixed.reshape(-1, rows.shape[2])


def _gram(exponents: Complex[Array, " n"], samples: int) -> Float[Array, "m m"]:
    """Sums over samples of products of Re and Im exp(exponent · n); the first exponent is zero and has no Im."""
    same = geometric(exponents[:, None] + exponents, samples)
    opposite = geometric(exponents[:, None] + exponents.conj(), samples)
    even, odd, mixed = (opposite + same).real, (opposite - same).real, (same - opposite).imag
    return 0.5 * jnp.block([[even, mixed[:, 1:]], [mixed[:, 1:].T, odd[1:, 1:]]])


def geometric(exponent: Complex[Array, "..."], count: int) -> Complex[Array, "..."]:
    """Σ exp(exponent · n) for n from 1 to `count`, accurate (with its derivative) for exponents near zero too."""
    near = jnp.abs(exponent) * count < 1e-5
    safe = jnp.where(near, 1.0, exponent)
    far = jnp.exp(0.5 * (count + 1) * safe) * jnp.sinh(0.5 * count * safe) / jnp.sinh(0.5 * safe)
    return jnp.where(near, count * (1.0 + 0.5 * (count + 1) * exponent), far)


def rate_variance(
    rows: Float[Array, "rows unknowns"], own: Float[Array, " own"], rate: int, std: Float[Array, " errors"]
) -> Float[Array, ""]:
    """Bound of the rate's variance, when the `own` unknowns (1; 0: known) are found without prior and the errors of the
    model beside them are known a priori to `std` (0: exactly).
    """
    count = len(own)
    seen = jnp.concatenate([rows[:, :count] * own, rows[:, count:] * std], axis=1)
    before = jnp.eye(len(std), rows.shape[1], count)  # an error in units of its own standard deviation
    return jnp.sum(estimator(jnp.concatenate([seen, before]), rate) ** 2)


def estimator(rows: Float[Array, "rows unknowns"], last: int) -> Float[Array, " rows"]:
    """The weights with which least squares takes unknown `last` from (whitened) records, all others being unknown too.

    That is the part of its column that is orthogonal to all others, over its square; the variance is the weights'
    square.
    """
    others = jnp.delete(rows, last, axis=1, assume_unique_indices=True)
    square = jnp.sum(others**2, axis=0)
    size = jnp.sqrt(jnp.where(square > 0.0, square, 1.0))  # a known one has no column; a root has no slope at zero
    columns = jnp.concatenate([others / size, rows[:, last, None]], axis=1)

    def reduced(columns: Array, index: Array) -> tuple[Array, None]:
        # Gram and Schmidt, twice is enough.
        chosen = columns[:, index]
        square = jnp.sum(chosen**2)
        unit = chosen / jnp.sqrt(jnp.where(square > _NOTHING, square, 1.0))
        later = jnp.arange(columns.shape[1]) > index
        return columns - jnp.where(later, unit[:, None] * (unit @ columns), 0.0), None

    count = columns.shape[1] - 1
    rest = jax.lax.scan(reduced, columns, jnp.arange(count))[0][:, -1]
    return rest / jnp.sum(rest**2)
