"""Sections `[device]` and `[readout]` of a study file."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from memsgyro_jax.base.quantity import (
    Damping,
    Density,
    Farad,
    FileSection,
    Hertz,
    In,
    Kilogram,
    Metre,
    Pair,
    Share,
    Stiffness,
    Volt,
    Whole,
)
from memsgyro_jax.device.gyro import VX, VY, AbstractGyro, DualMassGyro, SingleMassGyro, X, Y
from memsgyro_jax.loop.readout import AbstractReadout, Adc, ChargeAmplifier, DirectReadout, snr_density


class SingleMass(FileSection):
    """`kind = "single_mass"`: thesis (3.1). `dyx` left out equals `dxy`."""

    kind: Literal["single_mass"]
    mass: Kilogram
    kxx: Stiffness
    kyy: Stiffness
    kxy: Stiffness
    dxx: Damping
    dyy: Damping
    dxy: Damping
    dyx: Damping | None = None
    rotating_frame: bool = False

    @model_validator(mode="after")
    def _can_exist(self) -> "SingleMass":
        self.build()
        return self

    def build(self) -> AbstractGyro:
        """The device; raises `InputError` where it cannot exist."""
        return SingleMassGyro(**self.numbers())


class DualMass(FileSection):
    """`kind = "dual_mass"`: thesis (3.3)."""

    kind: Literal["dual_mass"]
    mass_x: Kilogram
    mass_y: Kilogram
    kxx: Stiffness
    kyy: Stiffness
    kxy: Stiffness
    kyx: Stiffness
    dxx: Damping
    dyy: Damping
    rotating_frame: bool = False

    @model_validator(mode="after")
    def _can_exist(self) -> "DualMass":
        self.build()
        return self

    def build(self) -> AbstractGyro:
        """The device; raises `InputError` where it cannot exist."""
        return DualMassGyro(**self.numbers())


Device = Annotated[SingleMass | DualMass, Field(discriminator="kind")]


class Converter(FileSection):
    """`adc = { limit = "1 V", bits = 16 }`: half the span and the word length."""

    limit: Annotated[float, Field(gt=0.0), In("V")]
    bits: Annotated[Whole, Field(ge=1, le=48)]

    def build(self) -> Adc:
        """The converter."""
        return Adc(self.limit, self.bits)


class Snr(FileSection):
    """Noise as the thesis states it: an amplitude ratio of `amplitude` to the noise of a sample at `sample_rate`."""

    ratio: Annotated[float, Field(gt=0.0), In("1")]
    amplitude: Annotated[float, Field(gt=0.0), In("m")] = 1e-6
    sample_rate: Hertz = 10e6


class Charge(FileSection):
    """`kind = "charge_amplifier"`: comb pick-off and charge amplifier (thesis 3.2, 3.3.1).

    Noise is given as `noise_density` or as `snr`; with neither there is none.
    """

    kind: Literal["charge_amplifier"]
    fingers: Pair[Share]
    width: Pair[Metre]
    gap: Pair[Metre]
    overlap: Pair[Metre]
    mismatch: Pair[Metre] = (0.0, 0.0)
    bias: Volt
    feedback: Pair[Farad]
    parasitic: Pair[Farad] = (0.0, 0.0)
    opamp_offset: Pair[Volt] = (0.0, 0.0)
    rejection: Annotated[float, Field(ge=0.0, le=1.0), In("1")] = 1.0
    noise_density: Pair[Density] | None = None
    snr: Snr | None = None
    adc: Converter | None = None

    @model_validator(mode="after")
    def _can_exist(self) -> "Charge":
        if self.noise_density is not None and self.snr is not None:
            raise ValueError("must have either noise_density or snr, but has both")
        self.build()
        return self

    def build(self) -> AbstractReadout:
        """The read-out; raises `InputError` where it cannot exist."""
        given = self.numbers()
        noise, snr, adc = given.pop("noise_density"), given.pop("snr"), given.pop("adc")
        quiet = ChargeAmplifier(**given, noise_density=noise or 0.0, adc=adc and adc.build())
        if snr is None:
            return quiet
        density = tuple(snr_density(snr.ratio, snr.amplitude, float(s), snr.sample_rate) for s in quiet.scale)
        return ChargeAmplifier(**given, noise_density=density, adc=quiet.adc)


class Position(FileSection):
    """`kind = "displacement"`: a pick-off of displacement without circuit, `scale` in V/m."""

    kind: Literal["displacement"]
    scale: Pair[Annotated[float, In("V/m")]]
    offset: Pair[Volt] = (0.0, 0.0)
    noise_density: Pair[Density] = (0.0, 0.0)
    adc: Converter | None = None

    def build(self) -> AbstractReadout:
        """The read-out."""
        return _direct(self, (X, Y))


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


def _direct(part: Position | Velocity, signals: tuple[int, int]) -> DirectReadout:
    adc = part.adc and part.adc.build()
    return DirectReadout(part.scale, part.offset, part.noise_density, adc, signals)


Readout = Annotated[Charge | Position | Velocity, Field(discriminator="kind")]
