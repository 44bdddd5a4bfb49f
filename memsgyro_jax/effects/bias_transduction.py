"""Capacitive transducers, which give and see as much as their bias voltage makes of them."""

import jax.numpy as jnp
from jaxtyping import Array

from .base import DriveEffect, Moment, ReadoutEffect, Scalar, strength


def _log_ratio(now: Moment) -> Array:
    """ln|V/V_ref| of the bias voltages; zero where one of them is zero, as a transducer without bias is none."""
    biased = (now.bias_voltage != 0.0) & (now.reference_bias != 0.0)
    ratio = jnp.abs(jnp.where(biased, now.bias_voltage, 1.0) / jnp.where(biased, now.reference_bias, 1.0))
    return jnp.log(ratio)


class DriveTransduction(DriveEffect):
    """u → |V/V_ref|ˢ·u with s a pure number, V the bias of the record and V_ref the one at which the drive's scale
    holds. Zero: the force of a command does not depend on the bias. One: it is proportional to it, as the force
    V·v·∂C/∂q of a signal v beside a bias V is.

    Shows as a gain that changes from bias to bias. A bias of zero changes nothing: without it there is no transducer.
    On a device that is linear no record tells it from `bias_transduction pickoff`: where both electrodes have the same
    bias, s = 2 stands for one of each.

    Tang et al., "Electrostatic-comb drive of lateral polysilicon resonators", Sensors and Actuators A 21 (1990) 328.
    """

    name, unit, law = "bias_transduction", "1", "u → |V_bias/V_ref|ˢ·u"
    reference = "Tang et al., Sens. Actuators A 21 (1990) 328"
    strength: Scalar = strength(sign=+1)

    @property
    def where(self) -> str:
        """Which transducer."""
        return "drive"

    def applied(self, command: Array, now: Moment) -> Array:
        return command * jnp.exp(self.strength * _log_ratio(now))


class PickoffTransduction(ReadoutEffect):
    """What the read-out shows of the motion times |V/V_ref|ˢ with s a pure number, V the bias of the record and V_ref
    the one at which the read-out's scale holds. Zero: the scale does not depend on the bias. One: it is proportional to
    it, as the current V·∂C/∂q·v of a biased electrode is.

    Shows as a gain that changes from bias to bias, of the motion alone: offset and feed-through stay. A bias of zero
    changes nothing: without it there is no transducer. See `bias_transduction drive` for what tells them apart.

    Nguyen and Howe, "An integrated CMOS micromechanical resonator high-Q oscillator", IEEE J. Solid-State Circuits 34
    (1999) 440.
    """

    name, unit, law = "bias_transduction", "1", "q → |V_bias/V_ref|ˢ·q"
    reference = "Nguyen and Howe, IEEE J. Solid-State Circuits 34 (1999) 440"
    strength: Scalar = strength(sign=+1)

    @property
    def where(self) -> str:
        """Which transducer."""
        return "pickoff"

    def signal(self, volts: Array, now: Moment) -> Array:
        return volts + now.scale * jnp.expm1(self.strength * _log_ratio(now)) * now.seen
