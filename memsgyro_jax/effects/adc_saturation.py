"""A converter whose range ends."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .base import Moment, ReadoutEffect, Scalar, strength
from .scan import Coverage, Scanned


class AdcSaturation(Scanned, ReadoutEffect):
    """V clipped at ±1/s with s in 1/V, behind all other effects. Zero: the range has no end.

    Shows as flat tops in raw records and as a flat resonance in a sweep, while the phase goes on. The strength itself
    is scanned: a range wider than the record leaves no trace, so that the derivative at zero is zero.

    IEEE Std 1241-2010, analog-to-digital converters.
    """

    name, unit, law = "adc_saturation", "1/V", "V clipped at ±1/s"
    reference = "IEEE Std 1241-2010"
    scanned = ("strength",)
    last = True
    sharp = True
    strength: Scalar = strength(sign=+1)

    def signal(self, volts: Array, now: Moment) -> Array:
        present = self.strength > 0
        # 1/s would be infinite at zero, and its derivative no number even where it is not selected.
        limit = 1.0 / jnp.where(present, self.strength, 1.0)
        return jnp.where(present, saturated(volts, limit), volts)

    def grid(self, coverage: Coverage) -> "tuple[AdcSaturation, ...]":
        """Limits from just above the largest recorded amplitude down to what a lock-in reads of a square wave, 4/π
        times its height.
        """
        if not coverage.volts > 0:
            return ()
        return tuple(AdcSaturation(float(1.0 / (part * coverage.volts))) for part in np.linspace(1.0, np.pi / 4, 12))


def saturated(volts: Array, limit: Array, step: Array | float = 0.0) -> Array:
    """Volts clipped at ±`limit`; the highest code of a converter lies one `step` below."""
    return jnp.clip(volts, -limit, limit - step)
