"""White noise that depends only on (die, sample, stream), drawn inside the fused time step.

`jax.random.normal` inside a float64 scan cost more than the whole Kalman step (130 ns against 140 ns for two channels),
because the CPU lowering of its generator runs as a rolled loop. The generator here is the same Threefry-2x32 (Salmon et
al., SC11, 2011), written out so that XLA vectorises it (7 ns). A draw is addressed, not consumed: any chunking, device
count or resume gives the same noise to the same die.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, UInt32


_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
_PARITY = 0x1BD11BDA


def threefry2x32(
    key: tuple[UInt32[Array, "..."], ...], counter: tuple[UInt32[Array, "..."], ...]
) -> tuple[Array, Array]:
    """Threefry-2x32 with 20 rounds: two words of key and two of counter to two random words (all uint32, broadcast)."""
    words = (key[0], key[1], key[0] ^ key[1] ^ jnp.uint32(_PARITY))
    x0, x1 = counter[0] + words[0], counter[1] + words[1]
    for group in range(5):
        for rotation in _ROTATIONS[group % 2]:
            x0 = x0 + x1
            x1 = (x1 << jnp.uint32(rotation)) | (x1 >> jnp.uint32(32 - rotation))
            x1 = x1 ^ x0
        x0 = x0 + words[(group + 1) % 3]
        x1 = x1 + words[(group + 2) % 3] + jnp.uint32(group + 1)
    return x0, x1


@jax.jit
def die_words(key: Array, die: Array) -> tuple[UInt32[Array, "*lanes"], UInt32[Array, "*lanes"]]:
    """The two key words of dies `die` (integers, any shape): `fold_in(key, die)`, whatever the batch."""
    folded = jax.vmap(lambda index: jax.random.key_data(jax.random.fold_in(key, index)))(jnp.ravel(die))
    shape = jnp.shape(die)
    return folded[:, 0].reshape(shape), folded[:, 1].reshape(shape)


def normal_pair(
    key: tuple[Array, Array], sample: Array, stream: int
) -> tuple[Float[Array, "*lanes"], Float[Array, "*lanes"]]:
    """Two independent standard normal numbers for sample number `sample` of stream `stream`.

    Each comes from a sign bit and 31 bits of probability through the inverse error function, evaluated in single
    precision (24-bit resolution; one draw in 17 million is clipped, at 5.4 sigma) and returned in the default
    precision.
    """
    bits = threefry2x32(key, (jnp.uint32(sample), jnp.uint32(stream)))
    return _normal(bits[0]), _normal(bits[1])


def _normal(bits: UInt32[Array, "*lanes"]) -> Float[Array, "*lanes"]:
    below = (bits >> jnp.uint32(1)).astype(jnp.float32) * jnp.float32(2.0**-31)
    size = jax.lax.erf_inv(jnp.minimum(below, jnp.float32(1.0 - 2.0**-24)))
    signed = jnp.where((bits & jnp.uint32(1)) == 0, size, -size)
    return (jnp.float32(math.sqrt(2.0)) * signed).astype(float)
