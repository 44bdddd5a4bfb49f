"""A device that the power it takes makes warmer than what it stands in."""

import jax.numpy as jnp
from jaxtyping import Array

from .base import Moment, Scalar, SurroundingsEffect, strength
from .numbers import setting


class SelfHeating(SurroundingsEffect):
    """A rise θ of the temperature that all other effects see, with θ' = (s·(P + Fᵀq') − θ)/τ, s in K/W.

    P is the `power` [W] that is taken whatever moves, Fᵀq' that of the electrodes' force, τ the `settling` [s]. Zero:
    as warm as the surroundings. At power-on θ is zero.

    Shows as a drift after power-on, with its own time, of all that depends on the temperature.

    Senturia, Microsystem Design, chapter 11 (lumped thermal circuits).
    """

    name, unit, law = "self_heating", "K/W", "ΔT → ΔT + θ, θ' = (s·(P + Fᵀq') − θ)/τ"
    reference = "Senturia, Microsystem Design, chapter 11"
    own_size = 1
    strength: Scalar = strength(sign=+1)
    power: Array = setting(1e-3, "W")
    settling: Array = setting(1.0, "s")

    def own_rate(self, now: Moment) -> Array:
        """How fast it warms [K/s]."""
        taken = self.power + jnp.sum(now.force * now.velocity)
        return (self.strength * taken - now.own) / self.settling

    def warmer(self, now: Moment) -> Array:
        return now.own[0]
