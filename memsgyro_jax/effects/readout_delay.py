"""Read-outs that answer late."""

import abc

import jax.numpy as jnp
from jaxtyping import Array

from .base import Moment, ReadoutEffect, Scalar, strength


class LateEffect(ReadoutEffect):
    """Shows the motion as it was some time ago: exactly, harmonic by harmonic, to a lock-in that knows its frequency;
    over time by Taylor's series to the third order, whose error (ω·delay)⁴/24 is 1e-5 at a ninth of a radian.
    """

    @abc.abstractmethod
    def late(self, now: Moment) -> Array:
        """By how much the read-out lags behind the motion [s]."""

    def signal(self, volts: Array, now: Moment) -> Array:
        return volts - now.scale * lag(self.late(now), *now.derivatives[1:])


class ReadoutDelay(LateEffect):
    """V(t) of q(t − s) on every channel, with s in s. Zero: no delay.

    Shows as the same phase in every channel, growing with the frequency, and in a phasor as exp(−iω·s); it turns
    stiffness into damping for whoever closes a loop.

    Saukoski, Aaltonen and Halonen, "Zero-rate output and quadrature compensation in vibratory MEMS gyroscopes", IEEE
    Sensors J. 7 (2007) 1639.
    """

    name, unit, law = "readout_delay", "s", "V(t) of q(t − s)"
    reference = "Saukoski, Aaltonen and Halonen, IEEE Sensors J. 7 (2007) 1639"
    strength: Scalar = strength(sign=+1)

    def late(self, now: Moment) -> Array:
        return self.strength


def behind(delay: Array, omega: Array) -> Array:
    """exp(−iω·delay), by which a phasor at `omega` [rad/s] is seen late by `delay` [s]."""
    return jnp.exp(-1j * omega * delay)


def lag(delay: Array, *derivatives: Array) -> Array:
    """By how much q(t − delay) lies behind q(t) [m]: as far as its derivatives are given, velocity first."""
    part = delay / len(derivatives) * derivatives[-1]
    for order in range(len(derivatives) - 1, 0, -1):
        part = delay / order * (derivatives[order - 1] - part)
    return part
