"""A capacitive pick-off by its drawing, made by the process that makes the device."""

import equinox as eqx
import jax.numpy as jnp

from memsgyro_jax.device.geometry import Process
from memsgyro_jax.device.gyro import Pair, Scalar

from .flicker import Flicker
from .readout import AbstractLinearReadout, Adc, ChargeAmplifier


class LayoutReadout(AbstractLinearReadout):
    """The pick-off and charge amplifier `drawn`, as `process` makes its combs; zeros are the drawing.

    An over-etch e widens the gaps by 2e and shortens the overlap by 2e, the layer's thickness is the fingers' width,
    walls that lean narrow the gaps towards their foot. With `Vary("process.over_etch", ...)` a lot varies in a process
    that the device (`LayoutGyro`) and its read-out share. Raises `InputError` where nothing is left of a gap or finger.
    """

    drawn: ChargeAmplifier
    process: Process = eqx.field(default_factory=Process)

    def __check_init__(self):
        self.made  # noqa: B018  # checks itself

    @property
    def made(self) -> ChargeAmplifier:
        """The read-out that the process makes of the drawing."""
        lost, drawn = 2.0 * self.process.over_etch, self.drawn
        width = tuple(w + self.process.thickness for w in drawn.width)
        # A gap that closes evenly from mean + lean to mean - lean: ∫ dz/gap = height/mean · artanh(r)/r, r their ratio.
        lean = tuple(w * jnp.tan(self.process.sidewall) for w in width)
        mean = tuple(gap + lost - part for gap, part in zip(drawn.gap, lean, strict=True))
        flat = tuple(gap / _crowding(part / gap) for gap, part in zip(mean, lean, strict=True))
        overlap = tuple(length - lost for length in drawn.overlap)
        places = lambda each: (each.width, each.gap, each.overlap)  # noqa: E731
        made = eqx.tree_at(places, drawn, (width, flat, overlap))
        made.__check_init__()
        return made

    @property
    def scale(self) -> Pair:
        """Of what is made."""
        return self.made.scale

    @property
    def offset(self) -> Pair:
        """Of what is made."""
        return self.made.offset

    @property
    def noise_density(self) -> Pair:
        """Of the circuit."""
        return self.drawn.noise_density

    @property
    def adc(self) -> Adc | None:
        """Of the circuit."""
        return self.drawn.adc

    @property
    def signals(self) -> tuple[int, int]:
        """Of the circuit."""
        return self.drawn.signals

    @property
    def flicker(self) -> Flicker | None:
        """Of the circuit."""
        return self.drawn.flicker

    @property
    def travel(self) -> float:
        """Until the fingers that are made leave each other."""
        return self.made.travel


def _crowding(ratio: Scalar) -> Scalar:
    """artanh(r)/r, and its slope at zero."""
    small = jnp.abs(ratio) < 1e-3
    safe = jnp.where(small, 0.5, ratio)
    return jnp.where(small, 1.0 + ratio**2 / 3.0 + ratio**4 / 5.0, jnp.arctanh(safe) / safe)
