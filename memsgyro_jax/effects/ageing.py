"""A device that drifts with the logarithm of its age."""

import jax.numpy as jnp
from jaxtyping import Array

from memsgyro_jax.base.fields import AbstractVar

from .axes import Planar, coriolis
from .base import ForceEffect, Moment, Scalar, strength
from .numbers import setting


_DAY = 86400.0  # s


class Ageing(ForceEffect):
    """What ages by so much for each decade of its age, lg(1 + (age + t)/onset): `age` [s] at the start of a run, and
    the `onset` [s] before which hardly anything has changed.
    """

    age: AbstractVar[Array]
    onset: AbstractVar[Array]

    def decades(self, now: Moment) -> Array:
        """Of its age beyond the onset."""
        return jnp.log10(1.0 + (self.age + now.time) / self.onset)


class AgeingStiffness(Ageing):
    """k_xx and k_yy times 1 + s·lg(1 + (age + t)/onset), s a pure number for each decade; age and onset in s. Zero: the
    springs stay.

    Shows as a resonance that falls by half of it, hours to years after the release.

    Kaajakari et al., "Stability of wafer level vacuum encapsulated single-crystal silicon resonators", Sens. Actuators
    A 130 (2006) 42.
    """

    name, unit, law = "ageing", "1", "k_xx and k_yy · (1 + s·lg(1 + (age + t)/onset))"
    reference = "Kaajakari et al., Sens. Actuators A 130 (2006) 42"
    strength: Scalar = strength()
    age: Array = setting(0.0, "s")
    onset: Array = setting(_DAY, "s")

    @property
    def where(self) -> str:
        """What ages."""
        return "stiffness"

    def force(self, now: Moment) -> Array:
        device = now.device
        stiffness = device.stiffness[: now.displacement.shape[0]] / device.mobility
        return -self.strength * self.decades(now) * stiffness * now.displacement


class AgeingOffset(Planar, Ageing):
    """Ω → Ω + s·lg(1 + (age + t)/onset), s in rad/s for each decade; age and onset in s. Zero: the offset stays.

    Shows as a zero-rate output that creeps from test to test, less in each as much time.

    IEEE Std 1431-2004, Coriolis vibratory gyros, bias repeatability.
    """

    name, unit, law = "ageing", "rad/s", "Ω → Ω + s·lg(1 + (age + t)/onset)"
    reference = "IEEE Std 1431-2004, bias repeatability"
    strength: Scalar = strength()
    age: Array = setting(0.0, "s")
    onset: Array = setting(_DAY, "s")

    @property
    def where(self) -> str:
        """What ages."""
        return "rate_offset"

    def force(self, now: Moment) -> Array:
        return coriolis(now, self.strength * self.decades(now))
