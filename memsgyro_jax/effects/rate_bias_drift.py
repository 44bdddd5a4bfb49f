"""A rate offset that wanders within a record."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .axes import Planar, coriolis
from .base import ForceEffect, Moment, strength


TERMS = 6


class RateBiasDrift(Planar, ForceEffect):
    """Ω → Ω + Σ s_k·cos(π·k·τ), k = 1 ... 6, with s in rad/s and τ the part of the record that has passed, in records
    whose rate reference is not calibrated. Zero: the offset is constant. The constant is `rate_offset`.

    Shows as a slow wander of the undriven axis over a long record. The cosines are the leading shapes of a random walk
    whose mean was removed, so that few of them catch most of a drift.

    IEEE Std 1431-2004, Coriolis vibratory gyros, bias instability and rate random walk.
    """

    name, unit, law = "rate_bias_drift", "rad/s", "Ω → Ω + Σ s_k·cos(π·k·t/T), k = 1 ... 6"
    reference = "IEEE Std 1431-2004, rate random walk"
    strength: Array = strength((0.0,) * TERMS)

    def force(self, now: Moment) -> Array:
        shapes = jnp.cos(np.pi * np.arange(1, TERMS + 1) * now.progress)
        return coriolis(now, (1.0 - now.rate_trusted) * (self.strength @ shapes))
