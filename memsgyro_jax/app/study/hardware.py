"""Sections `[device]` and `[readout]` of a study file."""

from collections.abc import Callable, Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from memsgyro_jax.base.errors import InputError
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
    Radian,
    Rate,
    Share,
    Stiffness,
    Volt,
    field_unit,
)
from memsgyro_jax.device.gyro import VX, VY, AbstractGyro, DualMassGyro, SingleMassGyro, X, Y
from memsgyro_jax.effects import Effect
from memsgyro_jax.loop.readout import AbstractReadout, ChargeAmplifier, DirectReadout, snr_density
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.model_file import read_model

from .carrier import Carrier, Converter, Flickering
from .paths import RelativePath


Warmth = Annotated[float, Field(ge=0.0), In("K")]


class _Warm(FileSection):
    """Of every device: `temperature` brings the Brownian force of its damping; left out there is none."""

    temperature: Warmth | None = None


_MODES = "frequency = [x, y] and quality_factor in the place of all stiffnesses and dampings"


class SingleMass(_Warm):
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
    instead: ClassVar[dict[str, str]] = dict.fromkeys(("kxx", "kyy", "kxy", "dxx", "dyy", "dxy"), _MODES)

    @model_validator(mode="after")
    def _can_exist(self) -> "SingleMass":
        self.build()
        return self

    def build(self) -> AbstractGyro:
        """The device; raises `InputError` where it cannot exist."""
        return SingleMassGyro(**self.numbers())


class DualMass(_Warm):
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


Quality = Annotated[float, Field(gt=0.0), In("1")]


def _as_written(schema: dict[str, Any]) -> None:
    """For an editor: what a device given by its modes, or by a file, says of its kind."""
    kind = schema["properties"]["kind"]
    kind["const"] = kind["const"].removesuffix("_modes")
    if kind["const"] == "fitted":
        schema["required"].remove("kind")


class SingleModes(_Warm):
    """`kind = "single_mass"` with `frequency`: a mass by its modes, see `SingleMassGyro.from_modes`.

    `angle` or `quadrature` says how the modes couple, with neither they do not.
    """

    model_config = ConfigDict(json_schema_extra=_as_written)
    kind: Literal["single_mass_modes"]
    mass: Kilogram
    frequency: tuple[Hertz, Hertz]
    quality_factor: Pair[Quality]
    angle: Radian | None = None
    quadrature: Rate | None = None
    cross_damping: Annotated[float, Field(gt=-1.0, lt=1.0), In("1")] = 0.0
    rotating_frame: bool = False

    def build(self) -> AbstractGyro:
        """The device; raises `InputError` where it cannot exist."""
        given = self.numbers()
        temperature = given.pop("temperature")
        return SingleMassGyro.from_modes(**given).at_temperature(temperature)


class DualModes(_Warm):
    """`kind = "dual_mass"` with `frequency`: two masses by their modes, see `DualMassGyro.from_modes`."""

    model_config = ConfigDict(json_schema_extra=_as_written)
    kind: Literal["dual_mass_modes"]
    mass_x: Kilogram
    mass_y: Kilogram
    frequency: tuple[Hertz, Hertz]
    quality_factor: Pair[Quality]
    quadrature: Rate = 0.0
    rotating_frame: bool = False

    def build(self) -> AbstractGyro:
        """The device; raises `InputError` where it cannot exist."""
        given = self.numbers()
        temperature = given.pop("temperature")
        return DualMassGyro.from_modes(**given).at_temperature(temperature)


class Fitted(_Warm):
    """`file = "device.toml"`: what `memsgyro fit --out` or `memsgyro diagnose --out` found, its effects included; the
    file name starts at the folder of the study file.
    """

    model_config = ConfigDict(json_schema_extra=_as_written)
    kind: Literal["fitted"]
    file: RelativePath
    rotating_frame: bool = False

    def read(self, own: Sequence[Effect] = ()) -> tuple[AbstractGyro, Model]:
        """The device with its effects, and the model it comes from; `own` are effects beyond the catalogue.

        Raises `InputError` unless it has two axes.
        """
        model = read_model(self.file, own)
        gyro = model.physical(rotating_frame=True) if self.rotating_frame else model.physical()
        if not isinstance(gyro, AbstractGyro):
            raise InputError(f"must be a device with two axes to run in a loop, but {self.file} has one")
        return gyro.at_temperature(self.temperature), model


def _kind_by_keys(given: Any) -> Any:
    """A device that names a file needs no kind; one with frequencies is given by its modes."""
    if not isinstance(given, dict):
        return given
    if "file" in given:
        return {"kind": "fitted", **given}
    return {**given, "kind": f"{given['kind']}_modes"} if "frequency" in given and given.get("kind") in _BOTH else given


_BOTH = ("single_mass", "dual_mass")
Device = Annotated[
    SingleMass | DualMass | SingleModes | DualModes | Fitted,
    Field(discriminator="kind"),
    BeforeValidator(_kind_by_keys),
]


def unit_of_device(part: FileSection, name: str) -> str | None:
    """Unit of number `name` of the device that a section describes, by its modes or by a fit too."""
    masses = SingleMass if isinstance(part, SingleMass | SingleModes | Fitted) else DualMass
    return field_unit(masses, name)


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
    flicker: Flickering | None = None

    @model_validator(mode="after")
    def _can_exist(self) -> "Charge":
        self.build()
        return self

    def build(self) -> AbstractReadout:
        """The read-out; raises `InputError` where it cannot exist."""
        return _amplifier(self, ChargeAmplifier)


class Capacitive(FileSection):
    """`kind = "capacitive"`: a charge amplifier behind a pick-off of `gradient` in F/m and `capacitance` at rest.

    Noise is given as `noise_density` or as `snr`; with neither there is none.
    """

    kind: Literal["capacitive"]
    gradient: Pair[Annotated[float, Field(gt=0.0), In("F/m")]]
    capacitance: Pair[Annotated[float, Field(gt=0.0), In("F")]]
    capacitance_mismatch: Pair[Farad] = (0.0, 0.0)
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
    def _can_exist(self) -> "Capacitive":
        self.build()
        return self

    def build(self) -> AbstractReadout:
        """The read-out; raises `InputError` where it cannot exist."""
        return _amplifier(self, ChargeAmplifier.from_gradient)


def _amplifier(part: Charge | Capacitive, make: Callable[..., ChargeAmplifier]) -> ChargeAmplifier:
    """What `make` gives of the section's numbers, with its noise."""
    given = part.numbers()
    noise, snr, adc = given.pop("noise_density"), given.pop("snr"), given.pop("adc")
    given["flicker"] = part.flicker and part.flicker.build()
    if noise is not None and snr is not None:
        raise ValueError("must have either noise_density or snr, but has both")
    quiet = make(**given, noise_density=noise or 0.0, adc=adc and adc.build())
    if snr is None:
        return quiet
    density = tuple(snr_density(snr.ratio, snr.amplitude, float(s), snr.sample_rate) for s in quiet.scale)
    return make(**given, noise_density=density, adc=quiet.adc)


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


Readout = Annotated[Charge | Capacitive | Carrier | Position | Velocity | FittedReadout, Field(discriminator="kind")]
