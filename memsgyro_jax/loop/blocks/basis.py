"""Into what the samples of a block are projected: a constant and the sine and cosine of what swings in it.

With b_n = (1, cos ω_j n, sin ω_j n) at sample n = 1 … M and noise v_n of variance R the statistics Σ b_n v_n have the
covariance R G, G = Σ b_n b_nᵀ. With W G Wᵀ = 1 those of W b_n are white, each with the variance R of one sample. One
rotation leads from b_n to b_{n+m}; so sums over 2m samples follow from those over m:

    G_2m = G_m + R_m G_m R_mᵀ
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from memsgyro_jax.device.small import dot


Angles = Float[Array, "frequencies lanes"]


def at(angles: Angles) -> Float[Array, "basis lanes"]:
    """The basis where the phases are `angles` [rad]: 1, the cosines, the sines."""
    return jnp.concatenate([jnp.ones_like(angles[:1]), jnp.cos(angles), jnp.sin(angles)])


def rotated(parts: Float[Array, "basis ..."], basis: Float[Array, "basis lanes"]) -> Float[Array, "basis ..."]:
    """Sums over b_n as those over b_{n+m}, where `basis` is b_m; dies trail."""
    count = (len(parts) - 1) // 2
    one, cosine, sine = parts[:1], parts[1 : 1 + count], parts[1 + count :]
    shape = (count,) + (1,) * (parts.ndim - 2) + basis.shape[1:]
    c, s = basis[1 : 1 + count].reshape(shape), basis[1 + count :].reshape(shape)
    return jnp.concatenate([one, c * cosine - s * sine, s * cosine + c * sine])


def twice(basis: Float[Array, "basis lanes"]) -> Float[Array, "basis lanes"]:
    """b_2m from b_m."""
    return rotated(basis, basis)


def gram_twice(
    gram: Float[Array, "basis basis lanes"], basis: Float[Array, "basis lanes"]
) -> Float[Array, "basis basis lanes"]:
    """G_2m from G_m, where `basis` is b_m."""
    half = jnp.swapaxes(rotated(gram, basis), 0, 1)
    return gram + rotated(half, basis)


_DEPENDENT = 1e-9  # of its own square, what of a function the ones before do not hold


def whitening(gram: Float[Array, "basis basis lanes"]) -> Float[Array, "basis basis lanes"]:
    """W with W G Wᵀ = 1, by Gram and Schmidt; a function that depends on those before it gets a row of zeros."""
    size, lanes = len(gram), gram.shape[2:]
    diagonal = jnp.stack([gram[i, i] for i in range(size)])
    unit = jnp.broadcast_to(jnp.eye(size)[..., None], (size, size, *lanes))

    def one(rows, place):
        # left: what remains of G, right: what was done to it
        pivot_row = rows[place]
        pivot = pivot_row[place]
        sound = pivot > _DEPENDENT * diagonal[place]
        inverse = jnp.where(sound, 1.0 / jnp.where(sound, pivot, 1.0), 0.0)
        below = (jnp.arange(size) > place)[:, None]
        factors = jnp.where(below, rows[:, place] * inverse, 0.0)
        done = rows - factors[:, None] * pivot_row[None]
        return done, pivot_row[size:] * jnp.sqrt(inverse)

    return jax.lax.scan(one, jnp.concatenate([gram, unit], axis=1), jnp.arange(size))[1]


def projected(
    angles: Angles, whiten: Float[Array, "basis basis lanes"], samples: Float[Array, "samples channels lanes"]
) -> Float[Array, "basis channels lanes"]:
    """The whitened statistics of a block's samples."""
    turns = jnp.arange(1.0, len(samples) + 1.0)
    sums = jnp.sum(jax.vmap(lambda n, v: at(n * angles)[:, None] * v[None])(turns, samples), axis=0)
    return jnp.stack([dot(row, sums) for row in whiten])
