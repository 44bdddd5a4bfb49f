"""Into what the samples of a block are projected: a constant and the sine and cosine of what swings in it.

With b_n = (1, cos ω_j n, sin ω_j n) at sample n = 1 … M and noise v_n of variance R the statistics Σ b_n v_n have the
covariance R G, G = Σ b_n b_nᵀ. With W G Wᵀ = 1 those of W b_n are white, each with the variance R of one sample. One
rotation leads from b_n to b_{n+m}; so sums over 2m samples follow from those over m:

    G_2m = G_m + R_m G_m R_mᵀ
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .algebra import multiplied


Angles = Float[Array, "frequencies lanes"]


class Turn(NamedTuple):
    """Cosine and sine of an angle for each frequency."""

    cosine: Float[Array, "frequencies lanes"]
    sine: Float[Array, "frequencies lanes"]

    @property
    def twice(self) -> "Turn":
        """By twice the angle."""
        return Turn(self.cosine**2 - self.sine**2, 2.0 * self.sine * self.cosine)


class Sums(NamedTuple):
    """Sums over samples of something times 1, the cosines and the sines: apart, since XLA joins slowly."""

    one: Float[Array, "... lanes"]
    cosine: Float[Array, "frequencies ... lanes"]
    sine: Float[Array, "frequencies ... lanes"]

    @classmethod
    def first(cls, turn: Turn, value: Float[Array, "... lanes"]) -> "Sums":
        """Of one sample, at the angle `turn`."""
        cosine, sine = (_beside(part, value) for part in turn)
        return cls(value, cosine * value, sine * value)

    def turned(self, turn: Turn) -> "Sums":
        """Those over b_n as those over b_{n+m}, where b_m is at `turn`."""
        c, s = (_beside(part, self.one) for part in turn)
        return Sums(self.one, c * self.cosine - s * self.sine, s * self.cosine + c * self.sine)

    @property
    def joined(self) -> Float[Array, "basis ... lanes"]:
        """In the order of the basis."""
        return jnp.concatenate([self.one[None], self.cosine, self.sine])


def _beside(part: Float[Array, "frequencies lanes"], value: Float[Array, "... lanes"]) -> Array:
    return part.reshape(part.shape[:1] + (1,) * (value.ndim - 1) + part.shape[1:])


def at(angles: Angles) -> Float[Array, "basis lanes"]:
    """The basis where the phases are `angles` [rad]: 1, the cosines, the sines."""
    return jnp.concatenate([jnp.ones_like(angles[:1]), jnp.cos(angles), jnp.sin(angles)])


def along(angles: Float[Array, " frequencies"], samples: int) -> Float[Array, "basis samples"]:
    """The basis of one die at samples 1 … `samples`, a power of two: from few sines, by the sum of two angles."""
    step = 1 << (samples.bit_length() // 2)
    coarse, fine = (
        angles[:, None, None] * n for n in (jnp.arange(0.0, samples, step)[:, None], jnp.arange(1.0, step + 1.0))
    )
    (c, s), (d, t) = ((jnp.cos(phase), jnp.sin(phase)) for phase in (coarse, fine))
    parts = (c * d - s * t).reshape(-1, samples), (s * d + c * t).reshape(-1, samples)
    return jnp.concatenate([jnp.ones((1, samples)), *parts])


def rotated(parts: Float[Array, "basis ... lanes"], turn: Turn) -> Float[Array, "basis ... lanes"]:
    """`Sums.turned` of sums in one array."""
    count = len(turn.cosine)
    return Sums(parts[0], parts[1 : 1 + count], parts[1 + count :]).turned(turn).joined


def gram_twice(gram: Float[Array, "basis basis lanes"], turn: Turn) -> Float[Array, "basis basis lanes"]:
    """G_2m from G_m, where b_m is at `turn`."""
    return gram + rotated(jnp.swapaxes(rotated(gram, turn), 0, 1), turn)


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
    return multiplied(whiten, sums)
