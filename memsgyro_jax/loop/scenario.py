"""What happens to the gyro during a run: rate, drifting offsets, changing damping.

A profile is a number as a function of time; profiles add with `+`.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.arguments import quantity, whole
from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.plainly import at_once
from memsgyro_jax.base.text import excerpt
from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.device.gyro import Scalar, check_not_negative, check_positive, number

from .noise import normal_pair


WALK_STREAM = 1  # stream of `noise.normal_pair`; the measurement noise of a run is stream 0


class AbstractProfile(Displayed):
    """A scalar quantity over time. A new kind gives `value`.

    **Raises:** `InputError` where one of its numbers is NaN or infinite, but for a time `at`, which may never come;
    traced ones pass.
    """

    def __check_init__(self):
        for name, value in vars(self).items():
            if not (eqx.is_inexact_array(value) and is_concrete(value)):
                continue
            now = np.asarray(value)
            if np.any(np.isnan(now)):
                raise InputError(f"Argument `{name}` of a {type(self).__name__} must be a number, but is NaN.")
            if name != "at" and np.any(np.isinf(now)):
                raise InputError(f"Argument `{name}` of a {type(self).__name__} must be finite, but is infinite.")

    @abc.abstractmethod
    def value(self, time: Scalar) -> Scalar:
        """The value at `time` [s]."""

    def __add__(self, other: "AbstractProfile") -> "Sum":
        return Sum((self, other))


class Constant(AbstractProfile):
    """`level` at all times; zero is the undisturbed case."""

    level: Scalar = number(default=0.0)

    def value(self, time: Scalar) -> Scalar:
        """The level."""
        return self.level + 0.0 * time


class Step(AbstractProfile):
    """`before` until `at` [s], `after` from then on."""

    at: Scalar = number("s")
    after: Scalar = number()
    before: Scalar = number(default=0.0)

    def value(self, time: Scalar) -> Scalar:
        """The level before or after."""
        return jnp.where(time < self.at, self.before, self.after)


class Ramp(AbstractProfile):
    """`start` until `at` [s], then `slope` [1/s] on top."""

    at: Scalar = number("s")
    slope: Scalar = number()
    start: Scalar = number(default=0.0)

    def value(self, time: Scalar) -> Scalar:
        """start + slope * (time - at) once begun."""
        return self.start + self.slope * jnp.maximum(time - self.at, 0.0)


class Sine(AbstractProfile):
    """`amplitude * sin(2π frequency t + phase)`; frequency in Hz, phase in rad."""

    amplitude: Scalar = number()
    frequency: Scalar = number("Hz")
    phase: Scalar = number("rad", default=0.0)

    def value(self, time: Scalar) -> Scalar:
        """The sine."""
        return self.amplitude * jnp.sin(2.0 * jnp.pi * self.frequency * time + self.phase)


class Chirp(AbstractProfile):
    """A sine whose frequency rises linearly from `low` to `high` [Hz] during `duration` [s], and stays there."""

    amplitude: Scalar = number()
    low: Scalar = number("Hz")
    high: Scalar = number("Hz")
    duration: Scalar = number("s")

    def __check_init__(self):
        check_positive("duration", self.duration)

    def value(self, time: Scalar) -> Scalar:
        """The swept sine; its phase is continuous."""
        swept = jnp.minimum(time, self.duration)
        phase = self.low * swept + 0.5 * (self.high - self.low) * swept**2 / self.duration
        return self.amplitude * jnp.sin(2.0 * jnp.pi * (phase + self.high * (time - swept)))


class Recorded(AbstractProfile):
    """Linear interpolation of a record; the end values hold outside. `times` [s] must rise strictly."""

    times: Float[Array, " samples"] = number("s")
    values: Float[Array, " samples"] = number()

    def __check_init__(self):
        if not is_concrete(self.times, self.values):
            return
        times, values = np.asarray(self.times), np.asarray(self.values)
        if times.ndim != 1 or times.shape != values.shape or times.size < 2:
            raise InputError(
                f"A record must have two equally long columns of at least 2 rows, "
                f"but {times.shape}, {values.shape} were given."
            )
        if not (np.all(np.isfinite(times)) and np.all(np.isfinite(values))):
            raise InputError("A record must hold finite numbers only; remove the rows with NaN or infinity.")
        if not np.all(np.diff(times) > 0.0):
            row = int(np.argmax(np.diff(times) <= 0.0)) + 1
            raise InputError(
                f"The times of a record must rise strictly, but row {row + 1} ({times[row]:g} s) does not; "
                "sort or remove it."
            )

    def value(self, time: Scalar) -> Scalar:
        """Linear between rows."""
        return jnp.interp(time, self.times, self.values)


class RandomWalk(AbstractProfile):
    """A random walk from `start`, its variance growing by `intensity` [unit²/s]; level after `duration` [s].

    `realisation`, a number from 0 to 1, names one walk out of all: a spread over it (uniform from 0 to 1) gives each
    die a walk of its own. It is straight between `rows` points: with fewer than samples it is smoother than a walk, and
    a filter that expects one is too careful (NEES 12.5 of 14 with a tenth of the samples).
    """

    intensity: Scalar = number()
    duration: Scalar = number("s")
    start: Scalar = number(default=0.0)
    realisation: Scalar = number(default=0.5)
    rows: int = eqx.field(static=True, default=10_000, converter=lambda given: whole("rows", given, 2))

    def __check_init__(self):
        check_not_negative("intensity", self.intensity)
        check_positive("duration", self.duration)

    @at_once
    def value(self, time: Scalar) -> Scalar:
        """Linear between the points of the walk."""
        spacing = self.duration / self.rows
        steps = jnp.sqrt(self.intensity * spacing) * self._normal()
        levels = jnp.concatenate([jnp.zeros_like(steps[:1]), jnp.cumsum(steps, axis=0)])
        place = jnp.clip(time / spacing, 0.0, self.rows)
        before = jnp.minimum(jnp.floor(place).astype(int), self.rows - 1)
        return self.start + levels[before] + (place - before) * (levels[before + 1] - levels[before])

    def _normal(self) -> Float[Array, "rows *lanes"]:
        key = (jnp.asarray(self.realisation * 2.0**32, jnp.uint32), jnp.zeros_like(self.realisation, jnp.uint32))
        half = jnp.arange(-(-self.rows // 2)).reshape((-1,) + (1,) * jnp.ndim(self.realisation))
        return jnp.concatenate(normal_pair(key, half, WALK_STREAM))[: self.rows]


class Sum(AbstractProfile):
    """Several profiles at once."""

    parts: tuple[AbstractProfile, ...]

    def value(self, time: Scalar) -> Scalar:
        """The sum of the parts."""
        return sum((part.value(time) for part in self.parts), 0.0)


class Scenario(Displayed):
    """Profiles of everything that varies during a run; each defaults to zero (undisturbed).

    `rate` Ωz in rad/s; `offset_drift` of the x and y read-out in V; `damping_change` relative change of (dxx, dyy,
    dxy); `cross_rate` (Ωx, Ωy) in rad/s and `acceleration` of the frame in m/s² act on devices with
    `rotating_frame=True`. Effects of the device see `temperature` in K and `bias_voltage` of the electrodes in V; None
    is that at which the device's numbers hold.

    **Raises:** `InputError` for what is no profile where one belongs, a plain number say.
    """

    rate: AbstractProfile = eqx.field(default_factory=Constant)
    offset_drift: tuple[AbstractProfile, AbstractProfile] = eqx.field(default_factory=lambda: _constants(2))
    damping_change: tuple[AbstractProfile, AbstractProfile, AbstractProfile] = eqx.field(
        default_factory=lambda: _constants(3)
    )
    cross_rate: tuple[AbstractProfile, AbstractProfile] = eqx.field(default_factory=lambda: _constants(2))
    acceleration: tuple[AbstractProfile, AbstractProfile] = eqx.field(default_factory=lambda: _constants(2))
    temperature: AbstractProfile | None = None
    bias_voltage: AbstractProfile | None = None

    def __check_init__(self):
        for name in ("rate", "temperature", "bias_voltage"):
            if name == "rate" or getattr(self, name) is not None:
                _check_profiles(f"Argument `{name}`", (getattr(self, name),), 1)
        for name, count in _SEVERAL.items():
            _check_profiles(f"Argument `{name}`", getattr(self, name), count)

    def at(self, time: Scalar) -> Conditions:
        """Everything at `time` [s]; the angular acceleration is the slope of the rate. The true rate of a run is no
        reading of a table, yet what effects add to it is as unknown as there: `rate_trusted` is zero.
        """
        rate, slope = jax.jvp(self.rate.value, (jnp.asarray(time, float),), (jnp.ones((), float),))
        around = (None if profile is None else profile.value(time) for profile in (self.temperature, self.bias_voltage))
        temperature, bias_voltage = around
        return Conditions(
            rate=rate,
            angular_acceleration=slope,
            rate_trusted=None,
            temperature=temperature,
            bias_voltage=bias_voltage,
            time=None,
            progress=None,
            record=None,
            sweep=None,
            cross_rate=_values(self.cross_rate, time),
            acceleration=_values(self.acceleration, time),
            damping_change=_values(self.damping_change, time),
            offset_drift=_values(self.offset_drift, time),
        )


_SEVERAL = {"offset_drift": 2, "damping_change": 3, "cross_rate": 2, "acceleration": 2}  # profiles of each


def _check_profiles(what: str, given: object, count: int) -> None:
    """Raise `InputError` unless these are so many profiles."""
    if count > 1 and not (isinstance(given, tuple | list) and len(given) == count):
        found = f"has {len(given)}" if isinstance(given, tuple | list) else f"is of type {type(given).__name__}"
        raise InputError(f"{what} must be a tuple of {count} profiles, but {found}.")
    for profile in given if isinstance(given, tuple | list) else ():
        if not isinstance(profile, AbstractProfile):
            raise InputError(
                f"{what} must be a profile over time, `Constant(1.0)` say, but is {excerpt(profile)} of type "
                f"{type(profile).__name__}."
            )


def _constants(count: int) -> tuple[Constant, ...]:
    return (Constant(),) * count


def _values(profiles: tuple[AbstractProfile, ...], time: Scalar) -> tuple[Scalar, ...]:
    return tuple(profile.value(time) for profile in profiles)


def as_scenario(given: "Scenario | AbstractProfile | float | str") -> Scenario:
    """A scenario from itself, from a rate profile, or from a constant rate in rad/s or as text with its unit."""
    if isinstance(given, Scenario):
        return given
    if isinstance(given, list | tuple) or np.ndim(given) > 0:
        raise InputError(
            "Argument `scenario` must be a `Scenario`, a profile of the rate or one rate, but is of "
            f"{np.size(given)} numbers; a rate over time is `mg.Recorded(times, rates)`, one for each die of a batch "
            "`mg.Constant(rates)`."
        )
    return Scenario(
        rate=given if isinstance(given, AbstractProfile) else Constant(quantity("scenario", given, "rad/s"))
    )
