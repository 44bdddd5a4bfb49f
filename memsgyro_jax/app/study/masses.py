"""Section `[device]` of a study file, a device by its numbers."""

from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import ConfigDict, Field, model_validator

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.quantity import Damping, FileSection, Hertz, In, Kilogram, Pair, Radian, Rate, Stiffness
from memsgyro_jax.device.gyro import AbstractGyro, DualMassGyro, SingleMassGyro
from memsgyro_jax.effects import Effect
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.model_file import read_model

from .paths import RelativePath


Warmth = Annotated[float, Field(ge=0.0), In("K")]


class Warm(FileSection):
    """Of every device: `temperature` brings the Brownian force of its damping; left out there is none."""

    temperature: Warmth | None = None


_MODES = "frequency = [x, y] and quality_factor in the place of all stiffnesses and dampings"


class SingleMass(Warm):
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


class DualMass(Warm):
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


class SingleModes(Warm):
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


class DualModes(Warm):
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


class Fitted(Warm):
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
