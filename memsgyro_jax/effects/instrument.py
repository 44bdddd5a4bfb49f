"""What an instrument does to a record: nuisance terms, tried before any mechanical effect, no part of the catalogue.

Each has one number per group of rows, chosen by the record and by the single sweep within it. The table `entry`
(records, sweeps, k) says how much of each of the k numbers a row takes: a one where it belongs to that group, nothing
in the row of a group that serves as the reference.
"""

import abc
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.arguments import in_unit
from memsgyro_jax.base.fields import AbstractVar
from memsgyro_jax.base.linalg import product

from .base import DriveEffect, Effect, ForceEffect, LockInRow, Moment, ReadoutEffect, SurroundingsEffect, strength


BY_RECORD = "by record"  # of a term that each record has for itself
THROUGHOUT = "throughout"  # of a term that goes on from record to record, by one clock


class SeenRows(NamedTuple):
    """What rows show and how it moves with the device, in numbers: enough to say what a term does to first order.

    Args:
        values: (n, axes) predicted readings [V].
        by_frequency, by_damping: (n, axes) their derivatives by the logarithm of all frequencies and of all dampings.
        force: (n,) command of the electrode that is driven [N].
        frequency: (n,) of that command [rad/s]; zero where none is known.
        record, sweep, time: (n,) as in a `Moment`.
        ringing, turning: (n, axes) what is left of the row before, minus this one's readings, after its dwell, and the
            rate at which that goes on changing [V/s], negated; zero where rows have settled.
        before: (n, axes) readings of the row before.
    """

    values: np.ndarray
    by_frequency: np.ndarray
    by_damping: np.ndarray
    force: np.ndarray
    frequency: np.ndarray
    record: np.ndarray
    sweep: np.ndarray
    time: np.ndarray
    ringing: np.ndarray
    turning: np.ndarray
    before: np.ndarray


class InstrumentTerm(Effect):
    """An effect of the instrument with one number per group of rows.

    Args:
        strength: (k,) zero where the instrument is as declared.
        entry: (records, sweeps, k) how much of each number a row takes.

    `prior` is the standard deviation that each number has before anything is measured, `None` where nothing is known.
    `in_proportion` says whether what it adds grows as the drive or the readings do, at all levels by the same factor;
    `of_every_phasor` whether it does the same to each phasor, whichever came before.
    `parts` are the names of its numbers, where it has as many. `turns` says whether these are angles of readings, of
    which whole turns are not seen. `imitates` names an effect of fewer numbers that over a narrow band looks the same.
    `of` says which rows share a number where a term may have it both ways: empty, or one of `ways`.
    """

    of_instrument: ClassVar[bool] = True
    in_proportion: ClassVar[bool] = False
    of_every_phasor: ClassVar[bool] = False
    prior: ClassVar[float | None] = None
    parts: ClassVar[tuple[str, ...]] = ()
    turns: ClassVar[bool] = False
    imitates: ClassVar[str] = ""
    ways: ClassVar[tuple[str, ...]] = ()
    entry: AbstractVar[Array]

    @property
    def where(self) -> str:
        """Which rows share a number, where that is left open."""
        return getattr(self, "of", "")

    @property
    def known_to(self) -> np.ndarray | None:
        """(k,) the standard deviation that each number has before anything is measured, `None` where nothing is
        known.
        """
        return None if self.prior is None else np.full(self.strength.size, self.prior)

    def chosen(self, now: Moment | LockInRow) -> Array:
        """The number of the group that a row belongs to."""
        table = self.entry[jnp.asarray(now.record, int), jnp.asarray(now.sweep, int)]
        return table @ self.strength

    @abc.abstractmethod
    def moved(self, seen: SeenRows) -> np.ndarray:
        """(n, axes) how rows of a linear device move with the number that they take."""

    def slopes(self, seen: SeenRows) -> np.ndarray:
        """(n, axes, k) how rows of a linear device move with each number, at zero: what a program would derive."""
        return self.moved(seen)[..., None] * self.taken(seen)[:, None, :]

    def taken(self, seen: SeenRows) -> np.ndarray:
        """(n, k) how much of each number a row takes."""
        return np.asarray(self.entry)[np.asarray(seen.record, int), np.asarray(seen.sweep, int)]


def row_field(default: Any) -> Array:
    """A field that says which number a row takes, or when a record was taken: of a case, not of the instrument."""
    return eqx.field(converter=in_unit("", float), default=default, metadata={"of_rows": True})


class DriveLevel(InstrumentTerm, DriveEffect):
    """u → (1 + s_k)·u, one s_k per drive level. Zero: the level is the declared one. Attenuators and shunts hold it to
    about 5 %.
    """

    name, unit, law = "drive_level", "1", "u → (1 + s_k)·u"
    prior = 0.05
    strength: Array = strength((0.0,), low=-0.2, high=0.2)
    entry: Array = row_field((((0.0,),),))

    def applied(self, command: Array, now: Moment) -> Array:
        return command + self.chosen(now) * command

    def moved(self, seen: SeenRows) -> np.ndarray:
        return seen.values


class RecordGain(InstrumentTerm, ReadoutEffect):
    """V → (1 + s_k)·V, one s_k per record. Zero: the gain is that of the first record."""

    name, unit, law = "record_gain", "1", "V → (1 + s_k)·V"
    prior = 0.05
    strength: Array = strength((0.0,), low=-0.2, high=0.2)
    entry: Array = row_field((((0.0,),),))

    def signal(self, volts: Array, now: Moment) -> Array:
        return volts + self.chosen(now) * volts

    def moved(self, seen: SeenRows) -> np.ndarray:
        return seen.values


class FrequencyOffset(InstrumentTerm, ForceEffect):
    """The frequency of the device, on the clock of a record, is (1 + s_k) times that of the first. Zero: the same."""

    name, unit, law = "frequency_offset", "1", "f0 → (1 + s_k)·f0"
    prior = 1e-6
    strength: Array = strength((0.0,), low=-4e-6, high=4e-6)
    entry: Array = row_field((((0.0,),),))

    def force(self, now: Moment) -> Array:
        return _pulled(now, self.chosen(now))

    def moved(self, seen: SeenRows) -> np.ndarray:
        return seen.by_frequency


class RecordTemperature(InstrumentTerm, SurroundingsEffect):
    """T → T + s_k, one s_k per record, and per temperature within it, as an oven may be off its set point. Zero: the
    temperature is the declared one.

    A case that declares `temperature_std` has it in every fit. Of another it is tried beside effects of the device that
    were found and depend on the temperature.

    Args:
        spread: (k,) standard deviation of each number, as declared [K]; zero would hold the temperature, and is refused
            where a case is read.
    """

    name, unit, law = "record_temperature", "K", "T → T + s_k"
    strength: Array = strength((0.0,), low=-100.0, high=100.0)
    entry: Array = row_field((((0.0,),),))
    spread: Array = row_field((1.0,))

    @property
    def known_to(self) -> np.ndarray:
        return np.broadcast_to(np.asarray(self.spread), self.strength.shape)

    def warmer(self, now: Moment) -> Array:
        return self.chosen(now)

    def moved(self, seen: SeenRows) -> np.ndarray:
        """Nothing, as a device that no temperature moves."""
        return np.zeros_like(seen.values)


class ClockedTerm(InstrumentTerm):
    """A term that grows evenly over the clock of each record, s_k·(t − t_begin)/(t_end − t_begin) − s_k/2.

    Args:
        begin, span: (records,) first time, and time from the first to the last row [s].
    """

    begin: AbstractVar[Array]
    span: AbstractVar[Array]

    def course(self, past: Any) -> Any:
        """(..., k), or one for all, how much of each number has come at a share of the time that is past (...)."""
        return past[..., None] - 0.5

    def grown(self, now: Moment | LockInRow) -> Array:
        """The term at the time of a row."""
        record = jnp.asarray(now.record, int)
        course = self.course((now.time - self.begin[record]) / self.span[record])
        return (self.entry[record, jnp.asarray(now.sweep, int)] * course) @ self.strength

    def taken(self, seen: SeenRows) -> np.ndarray:
        record = np.asarray(seen.record, int)
        return super().taken(seen) * self.course(
            (seen.time - np.asarray(self.begin)[record]) / np.asarray(self.span)[record]
        )


class FrequencyDrift(ClockedTerm, ForceEffect):
    """The frequency of the device grows by s_k of itself over a record, or by one s over all of them that follow each
    other by one clock (`throughout`). Zero: it stays.
    """

    name, unit, law = "frequency_drift", "1", "f0 → (1 + s_k·(t/T − ½))·f0"
    ways: ClassVar[tuple[str, ...]] = (THROUGHOUT,)
    strength: Array = strength((0.0,), low=-1e-2, high=1e-2)
    entry: Array = row_field((((0.0,),),))
    begin: Array = row_field((0.0,))
    span: Array = row_field((1.0,))
    of: str = eqx.field(static=True, default="")

    def force(self, now: Moment) -> Array:
        return _pulled(now, self.grown(now))

    def moved(self, seen: SeenRows) -> np.ndarray:
        return seen.by_frequency


class FrequencyWander(ClockedTerm, ForceEffect):
    """The frequency of the device wanders over records that follow each other by one clock: T_k are the polynomials of
    Chebyshev, of degree 1 to k over the whole time. Zero: it stays.

    A smooth course needs few of them, as Mason and Handscomb, "Chebyshev Polynomials" (2003), section 5.3, show.
    """

    name, unit, law = "frequency_wander", "1", "f0 → (1 + Σ s_k·T_k(2t/T − 1))·f0"
    strength: Array = strength((0.0,), low=-1e-1, high=1e-1)
    entry: Array = row_field((((0.0,),),))
    begin: Array = row_field((0.0,))
    span: Array = row_field((1.0,))

    def course(self, past: Any) -> Any:
        place, ways = 2.0 * past - 1.0, [1.0 + 0.0 * past, 2.0 * past - 1.0]
        for _ in range(1, self.strength.size):
            ways.append(2.0 * place * ways[-1] - ways[-2])
        return (jnp if isinstance(past, jnp.ndarray) else np).stack(ways[1:], axis=-1)

    def force(self, now: Moment) -> Array:
        return _pulled(now, self.grown(now))

    def moved(self, seen: SeenRows) -> np.ndarray:
        return seen.by_frequency


class DampingDrift(ClockedTerm, ForceEffect):
    """The damping grows by s_k of itself over a record, as the surroundings change. Zero: it stays."""

    name, unit, law = "damping_drift", "1", "d → (1 + s_k·(t/T − ½))·d"
    strength: Array = strength((0.0,), low=-0.5, high=0.5)
    entry: Array = row_field((((0.0,),),))
    begin: Array = row_field((0.0,))
    span: Array = row_field((1.0,))

    def force(self, now: Moment) -> Array:
        return -self.grown(now) * product(now.device.damping_matrix, now.velocity) / now.device.mobility

    def moved(self, seen: SeenRows) -> np.ndarray:
        return seen.by_damping


class GainDrift(ClockedTerm, ReadoutEffect):
    """The gain grows by s_k over a record. Zero: it stays."""

    name, unit, law = "gain_drift", "1", "V → (1 + s_k·(t/T − ½))·V"
    strength: Array = strength((0.0,), low=-0.2, high=0.2)
    entry: Array = row_field((((0.0,),),))
    begin: Array = row_field((0.0,))
    span: Array = row_field((1.0,))

    def signal(self, volts: Array, now: Moment) -> Array:
        return volts + self.grown(now) * volts

    def moved(self, seen: SeenRows) -> np.ndarray:
        return seen.values


def _pulled(now: Moment, shift: Array) -> Float[Array, " axes"]:
    """The force [N] that moves the frequencies of the device by a small part of themselves."""
    return -2.0 * shift * product(now.device.stiffness_matrix, now.displacement) / now.device.mobility
