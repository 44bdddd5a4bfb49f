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
    """What every device may say."""

    kind: str
    temperature: Warmth | None = None
    """Temperature T at which the damping makes thermomechanical (Brownian) noise, of the force density 4 k T D
    one-sided; left out or zero, none."""


class InFrame(Warm):
    """A device whose frame may turn and be shaken."""

    rotating_frame: bool = False
    """Whether the terms of a rotating frame act: Ω², dΩ/dt, cross rates and acceleration of the frame (thesis (2.4));
    false keeps the Coriolis force alone."""


_MODES = "frequency = [x, y] and quality_factor in the place of all stiffnesses and dampings"


class SingleMass(InFrame):
    """`kind = "single_mass"`: one proof mass that moves along x and y, thesis (3.1)."""

    kind: Literal["single_mass"]
    mass: Kilogram
    """Mass m of the proof mass."""
    kxx: Stiffness
    """Stiffness along x."""
    kyy: Stiffness
    """Stiffness along y."""
    kxy: Stiffness
    """Stiffness that couples x and y, the source of quadrature; its square must be below kxx·kyy."""
    dxx: Damping
    """Damping along x."""
    dyy: Damping
    """Damping along y."""
    dxy: Damping
    """Cross damping: the force on x per velocity along y. In phase with the Coriolis force, it makes bias."""
    dyx: Damping | None = None
    """Cross damping: the force on y per velocity along x. Left out, equal to `dxy`; a difference acts as a rate of
    (dyx - dxy)/(4·mass)."""
    instead: ClassVar[dict[str, str]] = dict.fromkeys(("kxx", "kyy", "kxy", "dxx", "dyy", "dxy"), _MODES)

    @model_validator(mode="after")
    def _can_exist(self) -> "SingleMass":
        self.build()
        return self

    def build(self) -> AbstractGyro:
        """The device; raises `InputError` where it cannot exist."""
        return SingleMassGyro(**self.numbers())


class TwoMasses(InFrame):
    """The masses of a decoupled gyro."""

    mass_x: Kilogram
    """Whole mass that moves along x, frame and inner mass, m1 + m2; more than `mass_y`."""
    mass_y: Kilogram
    """Mass that moves along y, the inner mass m1 alone."""


class DualMass(TwoMasses):
    """`kind = "dual_mass"`: a frame that moves along x, and in it a mass that moves along y, thesis (3.3)."""

    kind: Literal["dual_mass"]
    kxx: Stiffness
    """Stiffness along x."""
    kyy: Stiffness
    """Stiffness along y."""
    kxy: Stiffness
    """Coupling: the force on x per displacement along y."""
    kyx: Stiffness
    """Coupling: the force on y per displacement along x."""
    dxx: Damping
    """Damping along x."""
    dyy: Damping
    """Damping along y."""

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


class SingleModes(InFrame):
    """`kind = "single_mass"` with `frequency`: one proof mass by its modes, see `SingleMassGyro.from_modes`.

    `angle` or `quadrature` says how the modes couple, with neither they do not.
    """

    model_config = ConfigDict(json_schema_extra=_as_written)
    kind: Literal["single_mass_modes"]
    mass: Kilogram
    """Mass m of the proof mass."""
    frequency: tuple[Hertz, Hertz]
    """Natural frequencies of the two modes; the first mode moves along x, or at `angle` to it."""
    quality_factor: Pair[Quality]
    """Quality factors of the two modes, or one for both."""
    angle: Radian | None = None
    """Angle of the first mode from x towards y."""
    quadrature: Rate | None = None
    """Quadrature error as a rate: the coupling is kxy = 2·mass·ω·quadrature, with the ω of the first mode."""
    cross_damping: Annotated[float, Field(gt=-1.0, lt=1.0), In("1")] = 0.0
    """Damping that couples the modes, as a share of the geometric mean of both dampings; zero is none."""

    def build(self) -> AbstractGyro:
        """The device; raises `InputError` where it cannot exist."""
        given = self.numbers()
        temperature = given.pop("temperature")
        return SingleMassGyro.from_modes(**given).at_temperature(temperature)


class DualModes(TwoMasses):
    """`kind = "dual_mass"` with `frequency`: two masses by their modes, see `DualMassGyro.from_modes`."""

    model_config = ConfigDict(json_schema_extra=_as_written)
    kind: Literal["dual_mass_modes"]
    frequency: tuple[Hertz, Hertz]
    """Natural frequencies of the mode along x and of that along y."""
    quality_factor: Pair[Quality]
    """Quality factors of the two modes, or one for both."""
    quadrature: Rate = 0.0
    """Quadrature error as a rate: kxy = kyx = 2·mass_y·ω·quadrature, with the ω of the first mode; zero is no
    coupling."""

    def build(self) -> AbstractGyro:
        """The device; raises `InputError` where it cannot exist."""
        given = self.numbers()
        temperature = given.pop("temperature")
        return DualMassGyro.from_modes(**given).at_temperature(temperature)


class Fitted(InFrame):
    """`kind = "fitted"`, or `file` alone: what `memsgyro fit --out` or `memsgyro diagnose --out` found, its effects
    included.
    """

    model_config = ConfigDict(json_schema_extra=_as_written)
    kind: Literal["fitted"]
    file: RelativePath
    """The file of the fitted model, by its name from the folder of the study file."""

    def read(self, own: Sequence[Effect] = ()) -> tuple[AbstractGyro, Model]:
        """The device with its effects, and the model it comes from; `own` are effects beyond the catalogue.

        Raises `InputError` unless it has two axes.
        """
        model = read_model(self.file, own)
        gyro = model.physical(rotating_frame=True) if self.rotating_frame else model.physical()
        if not isinstance(gyro, AbstractGyro):
            raise InputError(f"must be a device with two axes to run in a loop, but {self.file} has one")
        return gyro.at_temperature(self.temperature), model
