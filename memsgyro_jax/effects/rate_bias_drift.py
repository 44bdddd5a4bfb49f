"""A rate offset that wanders within a record."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .axes import Planar, coriolis
from .base import ForceEffect, Moment, Scalar, strength


TERMS = 6


class RateBiasDrift(Planar, ForceEffect):
    """Ω → Ω + Σ s_k·sin(π·(k − ½)·τ), k = 1 ... 6, with s in rad/s and τ the part of the record that has passed, in
    records whose rate reference is not calibrated. Zero: the offset is that of the beginning, `rate_offset`.

    Shows as a slow wander of the undriven axis over a long record. The sines are the leading shapes of a random walk
    from zero (its Karhunen-Loève series), so that few of them catch most of a drift; records without a clock see none.

    IEEE Std 1431-2004, Coriolis vibratory gyros, bias instability and rate random walk.
    """

    name, unit, law = "rate_bias_drift", "rad/s", "Ω → Ω + Σ s_k·sin(π·(k−½)·t/T), k = 1 ... 6"
    reference = "IEEE Std 1431-2004, rate random walk"
    strength: Scalar = strength((0.0,) * TERMS)

    def force(self, now: Moment) -> Array:
        first = jnp.sin(0.5 * np.pi * now.progress)
        before, shape, wander = -first, first, self.strength[0] * first
        for k in range(1, TERMS):  # sin(a + d) = 2·cos(d)·sin(a) − sin(a − d): one sine for all
            before, shape = shape, 2.0 * (1.0 - 2.0 * first**2) * shape - before
            wander = wander + self.strength[k] * shape
        return coriolis(now, (1.0 - now.rate_trusted) * wander)
