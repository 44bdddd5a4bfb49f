"""Section `[scenario]` of a study file: what varies during a run."""

from pathlib import Path
from typing import Annotated, Any, Generic, Literal, TypeVar

from pydantic import BeforeValidator, Field, field_validator

from memsgyro_jax.base.quantity import (
    Acceleration,
    Also,
    Duration,
    FileSection,
    Hertz,
    In,
    Kelvin,
    KelvinDifference,
    Pure,
    Radian,
    Rate,
    Second,
    Volt,
    Whole,
)
from memsgyro_jax.loop.scenario import AbstractProfile, Chirp, Constant, Ramp, RandomWalk, Scenario, Sine, Step

from .paths import RelativePath
from .record import read_rate_record, read_temperature_record


Value = TypeVar("Value")
Slope = TypeVar("Slope")
Growth = TypeVar("Growth")


class Steady(FileSection, Generic[Value]):
    """`{ kind = "constant", level }`, or the level alone."""

    kind: Literal["constant"]
    level: Value

    def build(self) -> AbstractProfile:
        """The profile."""
        return Constant(self.level)


class Jump(FileSection, Generic[Value]):
    """`{ kind = "step", at, after, before }`; `before` is zero when left out."""

    kind: Literal["step"]
    at: Second
    after: Value
    before: Value | None = None

    def build(self) -> AbstractProfile:
        """The profile."""
        return Step(self.at, self.after, self.before or 0.0)


class Slide(FileSection, Generic[Value, Slope]):
    """`{ kind = "ramp", at, slope, start }`; `at` and `start` are zero when left out."""

    kind: Literal["ramp"]
    at: Second = 0.0
    slope: Slope
    start: Value | None = None

    def build(self) -> AbstractProfile:
        """The profile."""
        return Ramp(self.at, self.slope, self.start or 0.0)


class Wave(FileSection, Generic[Value]):
    """`{ kind = "sine", amplitude, frequency, phase }`."""

    kind: Literal["sine"]
    amplitude: Value
    frequency: Hertz
    phase: Radian = 0.0

    def build(self) -> AbstractProfile:
        """The profile."""
        return Sine(self.amplitude, self.frequency, self.phase)


class Swept(FileSection, Generic[Value]):
    """`{ kind = "chirp", amplitude, low, high, duration }`."""

    kind: Literal["chirp"]
    amplitude: Value
    low: Annotated[float, Field(ge=0.0), In("Hz")]
    high: Hertz
    duration: Duration

    def build(self) -> AbstractProfile:
        """The profile."""
        return Chirp(self.amplitude, self.low, self.high, self.duration)


class Wander(FileSection, Generic[Value, Growth]):
    """`{ kind = "random_walk", intensity, duration, start, realisation, rows }`; variance grows by `intensity` per s.

    A spread over `scenario.rate.realisation`, uniform from 0 to 1, gives each die a walk of its own, straight between
    its `rows` points; more of them than samples only cost time.
    """

    kind: Literal["random_walk"]
    intensity: Annotated[Growth, Field(ge=0.0)]
    duration: Duration
    start: Value | None = None
    realisation: Annotated[float, Field(ge=0.0, lt=1.0), In("1")] = 0.5
    rows: Annotated[Whole, Field(ge=2)] = RandomWalk.rows

    def build(self) -> AbstractProfile:
        """The profile."""
        return RandomWalk(self.intensity, self.duration, self.start or 0.0, self.realisation, self.rows)


class Record(FileSection):
    """`{ kind = "record", file }`: a recorded rate; the file name starts at the folder of the study file."""

    kind: Literal["record"]
    file: RelativePath

    @classmethod
    def content(cls, file: Path) -> AbstractProfile:
        """What a file tells."""
        return read_rate_record(file)

    @field_validator("file")
    @classmethod
    def _readable(cls, file: Path) -> Path:
        cls.content(file)
        return file

    def build(self) -> AbstractProfile:
        """The profile."""
        return self.content(self.file)


class WarmthRecord(Record):
    """`{ kind = "record", file }`: a recorded temperature; the file name starts at the folder of the study file."""

    @classmethod
    def content(cls, file: Path) -> AbstractProfile:
        """What a file tells."""
        return read_temperature_record(file)


def _spelled_out(given: Any) -> Any:
    """A level alone stands for a constant; a single profile for a list of one."""
    many = given if isinstance(given, list | tuple) else [given]
    is_level = [
        not isinstance(one, FileSection | dict) or (isinstance(one, dict) and set(one) == {"value", "unit"})
        for one in many
    ]
    return tuple(
        {"kind": "constant", "level": one} if level else one for one, level in zip(many, is_level, strict=True)
    )


_RateSlope = Annotated[float, In("rad/s^2")]
_VoltSlope = Annotated[float, In("V/s")]
_KelvinSlope = Annotated[float, In("K/s")]
_PureSlope = Annotated[float, In("1/s")]
_Jerk = Annotated[float, In("m/s^3")]
_RateGrowth = Annotated[float, In("rad^2/s^3")]
_VoltGrowth = Annotated[float, In("V^2/s")]
_KelvinGrowth = Annotated[float, In("K^2/s")]
_PureGrowth = Annotated[float, In("1/s")]
_Turn = Steady[Rate] | Jump[Rate] | Slide[Rate, _RateSlope] | Wave[Rate] | Swept[Rate] | Wander[Rate, _RateGrowth]
_Drift = Steady[Volt] | Jump[Volt] | Slide[Volt, _VoltSlope] | Wave[Volt] | Swept[Volt] | Wander[Volt, _VoltGrowth]
_Warmth = (
    Steady[Kelvin] | Jump[Kelvin] | Slide[Kelvin, _KelvinSlope] | Wave[KelvinDifference] | Wander[Kelvin, _KelvinGrowth]
)
_Change = Steady[Pure] | Jump[Pure] | Slide[Pure, _PureSlope] | Wave[Pure] | Swept[Pure] | Wander[Pure, _PureGrowth]
_Shake = (
    Steady[Acceleration] | Jump[Acceleration] | Slide[Acceleration, _Jerk] | Wave[Acceleration] | Swept[Acceleration]
)

_ByKind, _Spelled = Field(discriminator="kind"), BeforeValidator(_spelled_out)
_Else = Also(one=True, quantity=True)
MainRate = Annotated[tuple[Annotated[_Turn | Record, _ByKind], ...], _Spelled, _Else]
CrossRate = Annotated[tuple[Annotated[_Turn, _ByKind], ...], _Spelled, _Else]
Drift = Annotated[tuple[Annotated[_Drift, _ByKind], ...], _Spelled, _Else]
Warmth = Annotated[tuple[Annotated[_Warmth | WarmthRecord, _ByKind], ...], _Spelled, _Else]
Change = Annotated[tuple[Annotated[_Change, _ByKind], ...], _Spelled, _Else]
Shaking = Annotated[tuple[Annotated[_Shake, _ByKind], ...], _Spelled, _Else]


class Offsets(FileSection):
    """Change of the read-out offsets of x and y."""

    x: Drift = ()
    y: Drift = ()


class DampingChange(FileSection):
    """Relative change of the damping coefficients."""

    dxx: Change = ()
    dyy: Change = ()
    dxy: Change = ()


class CrossRates(FileSection):
    """Rates about x and y; they act on devices with `rotating_frame = true`."""

    x: CrossRate = ()
    y: CrossRate = ()


class Shake(FileSection):
    """Acceleration of the frame along x and y; it acts on devices with `rotating_frame = true`."""

    x: Shaking = ()
    y: Shaking = ()


class Surroundings(FileSection):
    """Section `[scenario]`; what is left out is zero, and temperature and bias voltage those at which the numbers of
    the device hold. Several profiles in a list add.
    """

    rate: MainRate = ()
    offset_drift: Offsets = Offsets()
    damping_change: DampingChange = DampingChange()
    cross_rate: CrossRates = CrossRates()
    acceleration: Shake = Shake()
    temperature: Warmth = ()
    bias_voltage: Drift = ()

    def build(self) -> Scenario:
        """The scenario."""
        alone = {name: _sum(profiles) for name, profiles in self if isinstance(profiles, tuple) and profiles}
        groups = {name: tuple(_sum(p) for _, p in group) for name, group in self if isinstance(group, FileSection)}
        return Scenario(**alone, **groups)


def _sum(profiles: tuple) -> AbstractProfile:
    made = [profile.build() for profile in profiles] or [Constant()]
    total = made[0]
    for profile in made[1:]:
        total = total + profile
    return total
