"""A charge amplifier as it is: feedback resistor, finite gain-bandwidth, parasitics, offset and noise."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.concrete import check_not_negative, check_positive, is_concrete
from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.fields import Scalar

from ..brownian import BOLTZMANN
from ..gyro import number


class Responses(NamedTuple):
    """Output volts per charge [V/C], per volt at the op-amp's input [1], per current into the node [V/A]."""

    charge: Scalar
    volt: Scalar
    current: Scalar


class ChargeStage(Displayed):
    """An op-amp that keeps the charge q of its sensor on `feedback` Cf.

    With A(s) = 1/(1/`gain` + s/2πGBW), C the sum of all capacitances at the node, u what stands at the op-amp's input
    (offset and noise) and i a current into the node:

        v [s Cf + s C/A + (1 + 1/A)/Rf] = (s C + 1/Rf) u − s q − i

    `sensor` is that of both halves together, `parasitic` that of the node to ground [F]. For `resistor` [Ω] and
    `gain_bandwidth` [Hz] infinite this is thesis (3.7) to (3.10), v = −q/Cf + C/Cf·Vos; a resistor takes the second
    part back to Vos within Rf·Cf, and a finite bandwidth turns the phase of a carrier. `noise` [V/√Hz, one-sided] is
    that of the op-amp, with 1/f below `corner` [Hz]; the resistor's noise is that of `temperature` [K], which on Cf
    alone is kT/Cf in all. Zeros are absent.
    """

    feedback: Scalar = number()
    sensor: Scalar = number()
    parasitic: Scalar = number(default=0.0)
    resistor: Scalar = number(default=jnp.inf)
    gain_bandwidth: Scalar = number(default=jnp.inf)
    gain: Scalar = number(default=jnp.inf)
    offset: Scalar = number(default=0.0)
    noise: Scalar = number(default=0.0)
    corner: Scalar = number(default=0.0)
    temperature: Scalar = number(default=0.0)

    def __check_init__(self):
        for name in ("feedback", "sensor"):
            check_positive(name, getattr(self, name))
        for name in ("parasitic", "noise", "corner", "temperature"):
            check_not_negative(name, getattr(self, name))
        for name in ("resistor", "gain_bandwidth", "gain"):  # may be infinite
            value = getattr(self, name)
            if is_concrete(value) and not np.all(np.asarray(value) > 0.0):
                raise InputError(f"Argument `{name}` must be positive, but {value} was given.")

    @property
    def total(self) -> Scalar:
        """All capacitance at the node [F]."""
        return self.feedback + self.sensor + self.parasitic

    def responses(self, omega: Scalar) -> Responses:
        """At jω, `omega` in rad/s and not zero unless there is a resistor."""
        s, leak = 1j * omega, 1.0 / self.resistor
        inverse = 1.0 / self.gain + s / (2.0 * jnp.pi * self.gain_bandwidth)
        under = s * self.feedback + s * self.total * inverse + (1.0 + inverse) * leak
        return Responses(-s / under, (s * self.total + leak) / under, -1.0 / under)

    def powers(self, omega: Scalar) -> dict[str, Scalar]:
        """One-sided noise power density at the output [V²/Hz] by source, at ω > 0."""
        seen = self.responses(omega)
        white = jnp.abs(seen.volt) ** 2 * self.noise**2
        return {
            "op-amp": white,
            "op-amp 1/f": white * self.corner * 2.0 * jnp.pi / omega,
            "feedback resistor": jnp.abs(seen.current) ** 2 * 4.0 * BOLTZMANN * self.temperature / self.resistor,
        }
