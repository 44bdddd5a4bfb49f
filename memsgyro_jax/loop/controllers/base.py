"""The controller port, and the auxiliary tones that several controllers add."""

import abc
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeAlias, TypeVar

import equinox as eqx
import jax.numpy as jnp

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.fields import AbstractVar
from memsgyro_jax.base.text import excerpt
from memsgyro_jax.device.gyro import Pair, Scalar, number
from memsgyro_jax.device.propagate import once

from ..observers.base import Clock, Estimate


State = TypeVar("State")


class AbstractController(Displayed, Generic[State]):
    """Gives the force for the coming sample from the estimate and the clock.

    One that sees the read-out's volts as well, not only what an observer makes of them, takes them in `measured`; one
    that measures the rate by itself gives it out in `output`. `usually_tuned` names the fields that tuning frees when
    nothing else is asked for and the observer names none, `sets_bandwidth` what may limit how fast a rate that it gives
    out follows the true one: in words, with the fields that move together.
    """

    usually_tuned: ClassVar[tuple[str, ...]] = ()
    sets_bandwidth: ClassVar[Mapping[str, tuple[str, ...]]] = {}

    @abc.abstractmethod
    def init(self) -> State:
        """The controller's own state before the first sample; `()` for a static law."""

    @abc.abstractmethod
    def command(self, state: State, estimate: Estimate, clock: Clock) -> tuple[Pair, State]:
        """Forces (x, y) in N, held until the next sample, and the new state."""

    def measured(self, state: State, volts: Pair, clock: Clock) -> State:
        """The own state once the volts [V] of the sample that ends at `clock` are known: as it was."""
        return state

    def output(self, state: State, estimate: Estimate) -> Estimate:
        """What the loop gives out beside the observer's `estimate`: nothing."""
        return estimate


class AbstractLinearController(AbstractController[tuple[()]]):
    """A controller without memory whose force is linear in the estimated motion and in its tones, whatever the
    coefficients. A loop can then be advanced by blocks: it reads the law off `command`.

    `frequencies` [Hz] are those besides the tones' at which the mass swings under it, other than its own.
    """

    if TYPE_CHECKING:  # a member's field may stand in the place of a property, not of a class variable

        @property
        def tones(self) -> "Tones": ...

    else:
        tones: AbstractVar["Tones"]

    @property
    def frequencies(self) -> tuple[Scalar, ...]:
        """None."""
        return ()

    def init(self) -> tuple[()]:
        """Nothing to remember."""
        return ()


class Tone(Displayed):
    """`amplitude * sin(2π frequency t + phase)`; frequency in Hz, phase in rad, amplitude in the unit of its user; zero
    means silent.
    """

    frequency: Scalar = number("Hz")
    amplitude: Scalar = number()
    phase: Scalar = number("rad", default=0.0)

    def value(self, time: Scalar) -> Scalar:
        """The tone at `time` [s]."""
        return self.amplitude * jnp.sin(2.0 * jnp.pi * self.frequency * time + self.phase)


Tones = tuple[tuple[Tone, ...], tuple[Tone, ...]]
GivenTones: TypeAlias = Any  # becomes `Tones`: a tone for both axes, or a pair of tones or of tuples of them


def tones_field() -> GivenTones:
    """A field of auxiliary tones per axis: none, one for both axes, or a pair whose entries are tones or tuples of
    tones.
    """
    return eqx.field(converter=_as_tones, default=((), ()))


def _as_tones(given: GivenTones) -> Tones:
    pair = (given, given) if isinstance(given, Tone) else given
    if not isinstance(pair, tuple | list):
        raise _no_tone(pair)
    if len(pair) != 2:
        raise InputError(
            f"Argument `tones` must be one tone for both axes or a pair (x, y), but has {len(pair)} entries; put "
            "several tones of an axis into a tuple of their own."
        )
    axes = tuple(tuple(axis) if isinstance(axis, tuple | list) else (axis,) for axis in pair)
    for tone in (*axes[0], *axes[1]):
        if not isinstance(tone, Tone):
            raise _no_tone(tone)
    return axes[0], axes[1]


def _no_tone(given: object) -> InputError:
    return InputError(
        "Argument `tones` must be a `Tone(frequency, amplitude)`, or a pair (x, y) of tones or of tuples of them, but "
        f"holds {excerpt(given)} of type {type(given).__name__}."
    )


def tone_values(tones: Tones, time: Scalar) -> Pair:
    """Sum of the tones of each axis at `time` [s]."""
    return once(time, tuple(sum((tone.value(time) for tone in axis), 0.0) for axis in tones))


def swing(tones: Tones, time: Scalar) -> tuple[Pair, Pair, Pair]:
    """Displacement, velocity and acceleration of both axes at `time` [s] when each is the sum of its tones, in m."""
    parts = [[_moving(tone, time) for tone in axis] for axis in tones]
    return once(time, tuple(tuple(sum((part[i] for part in axis), 0.0) for axis in parts) for i in range(3)))


def _moving(tone: Tone, time: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    omega = 2.0 * jnp.pi * tone.frequency
    angle = omega * time + tone.phase
    place = tone.amplitude * jnp.sin(angle)
    return place, omega * tone.amplitude * jnp.cos(angle), -(omega**2) * place
