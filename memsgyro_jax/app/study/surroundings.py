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
    unit_of,
)
from memsgyro_jax.loop.scenario import AbstractProfile, Chirp, Constant, Ramp, RandomWalk, Scenario, Sine, Step

from .paths import RelativePath
from .record import read_rate_record, read_temperature_record


Value = TypeVar("Value")
Slope = TypeVar("Slope")
Growth = TypeVar("Growth")


class OverTime(FileSection):
    """A profile over time, called by its kind and the unit of its values: `Jump[rad/s]`."""

    @classmethod
    def model_parametrized_name(cls, params: tuple[Any, ...]) -> str:
        """The name of the class for one kind of values."""
        return f"{cls.__name__}[{unit_of(params[0])}]"


class Steady(OverTime, Generic[Value]):
    """`{ kind = "constant", level }`, or the level alone: a constant."""

    kind: Literal["constant"]
    level: Value
    """The value at all times."""

    def build(self) -> AbstractProfile:
        """The profile."""
        return Constant(self.level)


class Jump(OverTime, Generic[Value]):
    """`{ kind = "step", at, after, before }`: a step."""

    kind: Literal["step"]
    at: Second
    """Time of the step."""
    after: Value
    """Value from then on."""
    before: Value | None = None
    """Value until then; left out, zero."""

    def build(self) -> AbstractProfile:
        """The profile."""
        return Step(self.at, self.after, self.before or 0.0)


class Slide(OverTime, Generic[Value, Slope]):
    """`{ kind = "ramp", at, slope, start }`: a ramp without an end."""

    kind: Literal["ramp"]
    at: Second = 0.0
    """Time at which the ramp begins."""
    slope: Slope
    """Change per second from then on."""
    start: Value | None = None
    """Value until then; left out, zero."""

    def build(self) -> AbstractProfile:
        """The profile."""
        return Ramp(self.at, self.slope, self.start or 0.0)


class Wave(OverTime, Generic[Value]):
    """`{ kind = "sine", amplitude, frequency, phase }`: a sine."""

    kind: Literal["sine"]
    amplitude: Value
    """Amplitude (peak)."""
    frequency: Hertz
    """Frequency."""
    phase: Radian = 0.0
    """Phase of the sine at time zero."""

    def build(self) -> AbstractProfile:
        """The profile."""
        return Sine(self.amplitude, self.frequency, self.phase)


class Swept(OverTime, Generic[Value]):
    """`{ kind = "chirp", amplitude, low, high, duration }`: a sine whose frequency rises linearly."""

    kind: Literal["chirp"]
    amplitude: Value
    """Amplitude (peak)."""
    low: Annotated[float, Field(ge=0.0), In("Hz")]
    """Frequency at time zero."""
    high: Hertz
    """Frequency at the end of the rise, and from then on."""
    duration: Duration
    """Time of the rise."""

    def build(self) -> AbstractProfile:
        """The profile."""
        return Chirp(self.amplitude, self.low, self.high, self.duration)


class Wander(OverTime, Generic[Value, Growth]):
    """`{ kind = "random_walk", intensity, duration, start, realisation, rows }`: a random walk."""

    kind: Literal["random_walk"]
    intensity: Annotated[Growth, Field(ge=0.0)]
    """What the variance grows by per second; of a rate, K² of the rate random walk (IEEE 952)."""
    duration: Duration
    """Time of the walk, level afterwards."""
    start: Value | None = None
    """Value at time zero; left out, zero."""
    realisation: Annotated[float, Field(ge=0.0, lt=1.0), In("1")] = 0.5
    """Which walk out of all, from 0 to below 1. A spread over "scenario.rate.realisation", uniform from 0 to 1, gives
    each die a walk of its own."""
    rows: Annotated[Whole, Field(ge=2)] = RandomWalk.rows
    """Number of points between which the walk is straight: with fewer than samples it is smoother than a walk, more
    only cost time."""

    def build(self) -> AbstractProfile:
        """The profile."""
        return RandomWalk(self.intensity, self.duration, self.start or 0.0, self.realisation, self.rows)


class Record(FileSection):
    """`{ kind = "record", file }`: a recorded rate."""

    kind: Literal["record"]
    file: RelativePath
    """A CSV file with the columns `t [s]` and `rate [deg/s]`, of a temperature `T [degC]`, in any units, by its name
    from the folder of the study file."""

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
    """`{ kind = "record", file }`: a recorded temperature."""

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


def _or(level: Any) -> Also:
    """A profile, or a level, alone."""
    return Also(one=True, quantity=unit_of(level))


_ByKind, _Spelled = Field(discriminator="kind"), BeforeValidator(_spelled_out)
MainRate = Annotated[tuple[Annotated[_Turn | Record, _ByKind], ...], _Spelled, _or(Rate)]
CrossRate = Annotated[tuple[Annotated[_Turn, _ByKind], ...], _Spelled, _or(Rate)]
Drift = Annotated[tuple[Annotated[_Drift, _ByKind], ...], _Spelled, _or(Volt)]
Warmth = Annotated[tuple[Annotated[_Warmth | WarmthRecord, _ByKind], ...], _Spelled, _or(Kelvin)]
Change = Annotated[tuple[Annotated[_Change, _ByKind], ...], _Spelled, _or(Pure)]
Shaking = Annotated[tuple[Annotated[_Shake, _ByKind], ...], _Spelled, _or(Acceleration)]


class Offsets(FileSection):
    """Change of the read-out offsets of x and y."""

    x: Drift = ()
    """What is added to the output voltage of the x channel."""
    y: Drift = ()
    """What is added to the output voltage of the y channel."""


class DampingChange(FileSection):
    """Relative change of each damping coefficient."""

    dxx: Change = ()
    """Relative change of dxx: 0.1 is a tenth more."""
    dyy: Change = ()
    """Relative change of dyy."""
    dxy: Change = ()
    """Relative change of the cross damping, dxy and dyx; two masses have none."""


class CrossRates(FileSection):
    """Rates about x and y; they act on devices with `rotating_frame = true`."""

    x: CrossRate = ()
    """Rate about the x axis."""
    y: CrossRate = ()
    """Rate about the y axis."""


class Shake(FileSection):
    """Acceleration of the frame along x and y; it acts on devices with `rotating_frame = true`."""

    x: Shaking = ()
    """Acceleration of the frame along x."""
    y: Shaking = ()
    """Acceleration of the frame along y."""


class Surroundings(FileSection):
    """Section `[scenario]`: what varies during a run. Each is a level, a profile, or a list of profiles, which add;
    what is left out is zero.
    """

    rate: MainRate = ()
    """Input rate Ω about z, the input axis: what the gyro measures."""
    offset_drift: Offsets = Offsets()
    """Change of the offsets of the read-out, x and y."""
    damping_change: DampingChange = DampingChange()
    """Relative change of the damping coefficients."""
    cross_rate: CrossRates = CrossRates()
    """Rates about the cross axes x and y, for a device with `rotating_frame = true`."""
    acceleration: Shake = Shake()
    """Acceleration of the frame along x and y, for a device with `rotating_frame = true`."""
    temperature: Warmth = ()
    """Temperature that the effects of the device and its Brownian force see. Left out, the effects see that at which
    the numbers of the device hold, the force that of `[device]`."""
    bias_voltage: Drift = ()
    """Bias voltage of the electrodes that the effects of the device see; left out, that at which its numbers hold."""

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
