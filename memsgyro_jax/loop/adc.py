"""The converter behind a read-out."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Scalar, check_positive, number
from memsgyro_jax.effects.adc_saturation import saturated


class Adc(Displayed):
    """An analogue-to-digital converter: `limit` is half the span in volts, `bits` the word length.

    Conversion rounds and clips; its derivative is that of the clipped straight line, so tuning sees through the steps.
    """

    limit: Scalar = number("V")
    bits: int = eqx.field(static=True)

    def __check_init__(self):
        check_positive("limit", self.limit)
        if isinstance(self.bits, bool) or not isinstance(self.bits, int | np.integer):
            raise InputError(f"Argument `bits` of the converter must be a whole number, but {self.bits} was given.")
        if not 1 <= self.bits <= 48:
            raise InputError(f"Argument `bits` of the converter must lie between 1 and 48, but {self.bits} was given.")

    def convert(self, volts: Scalar) -> Scalar:
        """The nearest code's voltage, clipped at the limits."""
        clipped = saturated(volts, self.limit, self.step)
        return clipped + jax.lax.stop_gradient(self.step * jnp.round(clipped / self.step) - clipped)

    @property
    def step(self) -> Scalar:
        """From code to code [V]."""
        return 2.0 * self.limit / 2**self.bits

    @property
    def without_steps(self) -> "Adc":
        """The same range, rounded to next to nothing: what noise over several steps makes of it on average."""
        return Adc(self.limit, 48)
