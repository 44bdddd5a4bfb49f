"""Section `[readout]` of a study file, a read-out by its numbers."""

from collections.abc import Callable
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.quantity import Density, Farad, FileSection, Hertz, In, Metre, Pair, Share, Volt
from memsgyro_jax.device.gyro import VX, VY, X, Y
from memsgyro_jax.loop.readout import AbstractReadout, ChargeAmplifier, DirectReadout, snr_density
from memsgyro_jax.measurement.model import Model

from .carrier import Converter, Flickering


class Snr(FileSection):
    """Noise as the thesis states it, by what it is in a sample."""

    ratio: Annotated[float, Field(gt=0.0), In("1")]
    """Amplitude of the signal over the standard deviation of the noise of a sample, no ratio of powers."""
    amplitude: Annotated[float, Field(gt=0.0), In("m")] = 1e-6
    """Displacement amplitude of that signal."""
    sample_rate: Hertz = 10e6
    """Sample rate at which the ratio holds, whatever that of the loop."""


class _Amplified(FileSection):
    """What charge amplifiers share. Noise is given as `noise_density` or as `snr`; with neither there is none."""

    make: ClassVar[Callable[..., ChargeAmplifier]]
    kind: str
    bias: Volt
    """Bias voltage of the sensor's capacitors."""
    feedback: Pair[Farad]
    """Feedback capacitance Cf of the charge amplifier."""
    parasitic: Pair[Farad] = (0.0, 0.0)
    """Parasitic capacitance Cp from the amplifier's input to ground."""
    opamp_offset: Pair[Volt] = (0.0, 0.0)
    """Input offset voltage of the op-amp."""
    rejection: Annotated[float, Field(ge=0.0, le=1.0), In("1")] = 1.0
    """Share of the op-amp's offset that is left at the output: 1 rejects nothing of it, zero all."""
    noise_density: Pair[Density] | None = None
    """White noise at the output, one-sided density; instead of `snr`."""
    snr: Snr | None = None
    """White noise by a signal-to-noise ratio of a sample; instead of `noise_density`."""
    adc: Converter | None = None
    """Analogue-to-digital converter behind the output; left out, nothing is rounded or clipped."""
    flicker: Flickering | None = None
    """Flicker (1/f) of the phase, as a delay that wanders; left out, none."""

    @model_validator(mode="after")
    def _can_exist(self) -> Self:
        self.build()
        return self

    def build(self) -> AbstractReadout:
        """The read-out; raises `InputError` where it cannot exist."""
        given, make = self.numbers(), type(self).make
        noise, snr, adc = given.pop("noise_density"), given.pop("snr"), given.pop("adc")
        given["flicker"] = self.flicker and self.flicker.build()
        if noise is not None and snr is not None:
            raise ValueError("must have either noise_density or snr, but has both")
        quiet = make(**given, noise_density=noise or 0.0, adc=adc and adc.build())
        if snr is None:
            return quiet
        density = tuple(snr_density(snr.ratio, snr.amplitude, float(s), snr.sample_rate) for s in quiet.scale)
        return make(**given, noise_density=density, adc=quiet.adc)


class Charge(_Amplified):
    """`kind = "charge_amplifier"`: comb pick-off and charge amplifier (thesis 3.2, 3.3.1).

    Noise is given as `noise_density` or as `snr`; with neither there is none.
    """

    make = ChargeAmplifier
    kind: Literal["charge_amplifier"]
    fingers: Pair[Share]
    """Number N of capacitors between fingers, of each half: dC/dx = N·ε·width/gap."""
    width: Pair[Metre]
    """Width W of the fingers across their overlap: the layer's thickness."""
    gap: Pair[Metre]
    """Gap Z between two fingers."""
    overlap: Pair[Metre]
    """Overlap x0 of the fingers at rest, which is also how far the mass may travel."""
    mismatch: Pair[Metre] = (0.0, 0.0)
    """Error d of the overlap, more in one half and less in the other, which makes an offset."""


class Capacitive(_Amplified):
    """`kind = "capacitive"`: a charge amplifier behind a pick-off of two halves, of which only the capacitance and its
    slope are known: 2·bias·gradient/feedback volts per metre.

    Noise is given as `noise_density` or as `snr`; with neither there is none.
    """

    make = ChargeAmplifier.from_gradient
    kind: Literal["capacitive"]
    gradient: Pair[Annotated[float, Field(gt=0.0), In("F/m")]]
    """Change of each half's capacitance per displacement, dC/dx."""
    capacitance: Pair[Annotated[float, Field(gt=0.0), In("F")]]
    """Capacitance of each half at rest; the mass may travel until it is gone."""
    capacitance_mismatch: Pair[Farad] = (0.0, 0.0)
    """Difference of the two halves at rest, which makes an offset."""


class Position(FileSection):
    """`kind = "displacement"`: a pick-off of displacement without circuit."""

    kind: Literal["displacement"]
    scale: Pair[Annotated[float, In("V/m")]]
    """Output voltage per displacement."""
    offset: Pair[Volt] = (0.0, 0.0)
    """Output voltage at rest."""
    noise_density: Pair[Density] = (0.0, 0.0)
    """White noise at the output, one-sided density; zero is none."""
    adc: Converter | None = None
    """Analogue-to-digital converter behind the output; left out, nothing is rounded or clipped."""
    flicker: Flickering | None = None
    """Flicker (1/f) of the phase, as a delay that wanders; left out, none."""

    def build(self) -> AbstractReadout:
        """The read-out."""
        return _direct(self, (X, Y), self.flicker)


class Velocity(FileSection):
    """`kind = "velocity"`: a pick-off of velocity, as the thesis' own observer needs."""

    kind: Literal["velocity"]
    scale: Pair[Annotated[float, In("V*s/m")]]
    """Output voltage per velocity."""
    offset: Pair[Volt] = (0.0, 0.0)
    """Output voltage at rest."""
    noise_density: Pair[Density] = (0.0, 0.0)
    """White noise at the output, one-sided density; zero is none."""
    adc: Converter | None = None
    """Analogue-to-digital converter behind the output; left out, nothing is rounded or clipped."""

    def build(self) -> AbstractReadout:
        """The read-out."""
        return _direct(self, (VX, VY))


class FittedReadout(FileSection):
    """`kind = "fitted"`: scale and offset of the file that `[device]` names; noise and converter stand here."""

    kind: Literal["fitted"]
    noise_density: Pair[Density] = (0.0, 0.0)
    """White noise at the output, one-sided density; zero is none."""
    adc: Converter | None = None
    """Analogue-to-digital converter behind the output; left out, nothing is rounded or clipped."""

    def build(self, model: Model | None) -> AbstractReadout:
        """The read-out; raises `InputError` without a fitted device."""
        if model is None:
            raise InputError('must go with a fitted device, [device] file = "device.toml", but the device is given')
        scale, offset = (tuple(map(float, pair)) for pair in (model.scale, model.offset))
        return DirectReadout(scale, offset, self.noise_density, self.adc and self.adc.build(), (X, Y))


def _direct(part: Position | Velocity, signals: tuple[int, int], flicker: Flickering | None = None) -> DirectReadout:
    adc = part.adc and part.adc.build()
    return DirectReadout(part.scale, part.offset, part.noise_density, adc, signals, flicker and flicker.build())
