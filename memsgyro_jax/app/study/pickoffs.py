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
    """Noise as the thesis states it: an amplitude ratio of `amplitude` to the noise of a sample at `sample_rate`."""

    ratio: Annotated[float, Field(gt=0.0), In("1")]
    amplitude: Annotated[float, Field(gt=0.0), In("m")] = 1e-6
    sample_rate: Hertz = 10e6


class _Amplified(FileSection):
    """What charge amplifiers share. Noise is given as `noise_density` or as `snr`; with neither there is none."""

    make: ClassVar[Callable[..., ChargeAmplifier]]
    kind: str
    bias: Volt
    feedback: Pair[Farad]
    parasitic: Pair[Farad] = (0.0, 0.0)
    opamp_offset: Pair[Volt] = (0.0, 0.0)
    rejection: Annotated[float, Field(ge=0.0, le=1.0), In("1")] = 1.0
    noise_density: Pair[Density] | None = None
    snr: Snr | None = None
    adc: Converter | None = None
    flicker: Flickering | None = None

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
    width: Pair[Metre]
    gap: Pair[Metre]
    overlap: Pair[Metre]
    mismatch: Pair[Metre] = (0.0, 0.0)


class Capacitive(_Amplified):
    """`kind = "capacitive"`: a charge amplifier behind a pick-off of two halves, each of `gradient` in F/m and
    `capacitance` at rest: 2·bias·gradient/feedback volts per metre.

    Noise is given as `noise_density` or as `snr`; with neither there is none.
    """

    make = ChargeAmplifier.from_gradient
    kind: Literal["capacitive"]
    gradient: Pair[Annotated[float, Field(gt=0.0), In("F/m")]]
    capacitance: Pair[Annotated[float, Field(gt=0.0), In("F")]]
    capacitance_mismatch: Pair[Farad] = (0.0, 0.0)


class Position(FileSection):
    """`kind = "displacement"`: a pick-off of displacement without circuit, `scale` in V/m."""

    kind: Literal["displacement"]
    scale: Pair[Annotated[float, In("V/m")]]
    offset: Pair[Volt] = (0.0, 0.0)
    noise_density: Pair[Density] = (0.0, 0.0)
    adc: Converter | None = None
    flicker: Flickering | None = None

    def build(self) -> AbstractReadout:
        """The read-out."""
        return _direct(self, (X, Y), self.flicker)


class Velocity(FileSection):
    """`kind = "velocity"`: a pick-off of velocity, as the thesis' own observer needs; `scale` in V·s/m."""

    kind: Literal["velocity"]
    scale: Pair[Annotated[float, In("V*s/m")]]
    offset: Pair[Volt] = (0.0, 0.0)
    noise_density: Pair[Density] = (0.0, 0.0)
    adc: Converter | None = None

    def build(self) -> AbstractReadout:
        """The read-out."""
        return _direct(self, (VX, VY))


class FittedReadout(FileSection):
    """`kind = "fitted"`: scale and offset of the file that `[device]` names; noise and converter stand here."""

    kind: Literal["fitted"]
    noise_density: Pair[Density] = (0.0, 0.0)
    adc: Converter | None = None

    def build(self, model: Model | None) -> AbstractReadout:
        """The read-out; raises `InputError` without a fitted device."""
        if model is None:
            raise InputError('must go with a fitted device, [device] file = "device.toml", but the device is given')
        scale, offset = (tuple(map(float, pair)) for pair in (model.scale, model.offset))
        return DirectReadout(scale, offset, self.noise_density, self.adc and self.adc.build(), (X, Y))


def _direct(part: Position | Velocity, signals: tuple[int, int], flicker: Flickering | None = None) -> DirectReadout:
    adc = part.adc and part.adc.build()
    return DirectReadout(part.scale, part.offset, part.noise_density, adc, signals, flicker and flicker.build())
