"""What an instrument does to a record: nuisance terms, tried before any mechanical effect, no part of the catalogue.

Each has one number per group of rows, chosen by the record and by the single sweep within it. The table `entry`
(records, sweeps, k) says how much of each of the k numbers a row takes: a one where it belongs to that group, nothing
in the row of a group that serves as the reference.
"""

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.fields import AbstractVar

from .base import DriveEffect, Effect, ForceEffect, LockInEffect, LockInRow, Moment, ReadoutEffect, strength


class InstrumentTerm(Effect):
    """An effect of the instrument with one number per group of rows.

    Args:
        strength: (k,) zero where the instrument is as declared.
        entry: (records, sweeps, k) how much of each number a row takes.

    `prior` is the standard deviation that each number has before anything is measured, `None` where nothing is known.
    `of` says which rows share a number where a term may have it both ways: empty for one number for all.
    """

    of_instrument: ClassVar[bool] = True
    prior: ClassVar[float | None] = None
    entry: AbstractVar[Array]

    @property
    def where(self) -> str:
        """Which rows share a number, where that is left open."""
        return getattr(self, "of", "")

    def chosen(self, now: Moment | LockInRow) -> Array:
        """The number of the group that a row belongs to."""
        table = self.entry[jnp.asarray(now.record, int), jnp.asarray(now.sweep, int)]
        return table @ self.strength


def _fixed(default: Any) -> Array:
    """A field that says which number a row takes, or when a record was taken."""
    return eqx.field(converter=lambda value: jnp.asarray(value, float), default=default)


class DriveLevel(InstrumentTerm, DriveEffect):
    """u → (1 + s_k)·u, one s_k per drive level. Zero: the level is the declared one. Attenuators and shunts hold it to
    about 5 %.
    """

    name, unit, law = "drive_level", "1", "u → (1 + s_k)·u"
    prior = 0.05
    strength: Array = strength((0.0,), low=-0.2, high=0.2)
    entry: Array = _fixed((((0.0,),),))

    def applied(self, command: Array, now: Moment) -> Array:
        return command + self.chosen(now) * command


class RecordGain(InstrumentTerm, ReadoutEffect):
    """V → (1 + s_k)·V, one s_k per record. Zero: the gain is that of the first record."""

    name, unit, law = "record_gain", "1", "V → (1 + s_k)·V"
    prior = 0.05
    strength: Array = strength((0.0,), low=-0.2, high=0.2)
    entry: Array = _fixed((((0.0,),),))

    def signal(self, volts: Array, now: Moment) -> Array:
        return volts + self.chosen(now) * volts


class FrequencyOffset(InstrumentTerm, ForceEffect):
    """The frequency of the device, on the clock of a record, is (1 + s_k) times that of the first. Zero: the same."""

    name, unit, law = "frequency_offset", "1", "f0 → (1 + s_k)·f0"
    prior = 1e-6
    strength: Array = strength((0.0,), low=-4e-6, high=4e-6)
    entry: Array = _fixed((((0.0,),),))

    def force(self, now: Moment) -> Array:
        return _pulled(now, self.chosen(now))


class ClockedTerm(InstrumentTerm):
    """A term that grows evenly over the clock of each record, s_k·(t − t_begin)/(t_end − t_begin) − s_k/2.

    Args:
        begin, span: (records,) first time, and time from the first to the last row [s].
    """

    begin: AbstractVar[Array]
    span: AbstractVar[Array]

    def grown(self, now: Moment | LockInRow) -> Array:
        """The term at the time of a row."""
        record = jnp.asarray(now.record, int)
        return self.chosen(now) * ((now.time - self.begin[record]) / self.span[record] - 0.5)


class FrequencyDrift(ClockedTerm, ForceEffect):
    """The frequency of the device grows by s_k of itself over a record. Zero: it stays."""

    name, unit, law = "frequency_drift", "1", "f0 → (1 + s_k·(t/T − ½))·f0"
    strength: Array = strength((0.0,), low=-1e-2, high=1e-2)
    entry: Array = _fixed((((0.0,),),))
    begin: Array = _fixed((0.0,))
    span: Array = _fixed((1.0,))

    def force(self, now: Moment) -> Array:
        return _pulled(now, self.grown(now))


class DampingDrift(ClockedTerm, ForceEffect):
    """The damping grows by s_k of itself over a record, as the surroundings change. Zero: it stays."""

    name, unit, law = "damping_drift", "1", "d → (1 + s_k·(t/T − ½))·d"
    strength: Array = strength((0.0,), low=-0.5, high=0.5)
    entry: Array = _fixed((((0.0,),),))
    begin: Array = _fixed((0.0,))
    span: Array = _fixed((1.0,))

    def force(self, now: Moment) -> Array:
        return -self.grown(now) * (now.device.damping_matrix @ now.velocity) / now.device.mobility


class GainDrift(ClockedTerm, ReadoutEffect):
    """The gain grows by s_k over a record. Zero: it stays."""

    name, unit, law = "gain_drift", "1", "V → (1 + s_k·(t/T − ½))·V"
    strength: Array = strength((0.0,), low=-0.2, high=0.2)
    entry: Array = _fixed((((0.0,),),))
    begin: Array = _fixed((0.0,))
    span: Array = _fixed((1.0,))

    def signal(self, volts: Array, now: Moment) -> Array:
        return volts + self.grown(now) * volts


class PhaseDrift(ClockedTerm, LockInEffect):
    """The reference of the lock-in turns by s_k rad over a record. Zero: it stays."""

    name, unit, law = "phase_drift", "rad", "V → V·exp(i·s_k·(t/T − ½))"
    strength: Array = strength((0.0,), low=-1.0, high=1.0)
    entry: Array = _fixed((((0.0,),),))
    begin: Array = _fixed((0.0,))
    span: Array = _fixed((1.0,))

    def phasors(self, values: Complex[Array, " axes"], row: LockInRow) -> Complex[Array, " axes"]:
        return values * jnp.exp(1j * self.grown(row))


class ReferencePhase(InstrumentTerm, LockInEffect):
    """The reference of the lock-in is turned by s_k rad, in all records or in each. Zero: it is the drive itself."""

    name, unit, law = "reference_phase", "rad", "V → V·exp(i·s_k)"
    strength: Array = strength((0.0,), low=-1.0, high=1.0)
    entry: Array = _fixed((((0.0,),),))
    of: str = eqx.field(static=True, default="")

    def phasors(self, values: Complex[Array, " axes"], row: LockInRow) -> Complex[Array, " axes"]:
        return values * jnp.exp(1j * self.chosen(row))


class LockInBackground(InstrumentTerm, LockInEffect):
    """A phasor that is there without a drive: V → V + s, real and imaginary part of each channel. Zero: none."""

    name, unit, law = "lock_in_background", "V", "V → V + s_k"
    strength: Array = strength((0.0,))
    entry: Array = _fixed((((0.0,),),))

    def phasors(self, values: Complex[Array, " axes"], row: LockInRow) -> Complex[Array, " axes"]:
        return values + _pairs(self.strength)


class LockInFeedthrough(InstrumentTerm, LockInEffect):
    """A phasor in proportion to the drive: V → V + s·u, real and imaginary part of each channel, u the electrode that
    is driven. Zero: none.
    """

    name, unit, law = "lock_in_feedthrough", "V/N", "V → V + s_k·u"
    strength: Array = strength((0.0,))
    entry: Array = _fixed((((0.0,),),))

    def phasors(self, values: Complex[Array, " axes"], row: LockInRow) -> Complex[Array, " axes"]:
        return values + _pairs(self.strength) * jnp.sum(row.force)


class LockInMemory(InstrumentTerm, LockInEffect):
    """The filter of the lock-in still shows the part s of the row before: V_n → V_n + s_k·(seen_{n−1} − V_n). Zero: it
    has settled. A filter with one time constant τ, read a dwell D after the step, has s = exp(−D/τ).

    Libbrecht, Black and Hirata, "A basic lock-in amplifier experiment for the undergraduate laboratory", Am. J. Phys.
    71 (2003) 1208.
    """

    name, unit, law = "lock_in_memory", "1", "V_n → V_n + s_k·(V_{n−1} − V_n)"
    reference = "Libbrecht, Black and Hirata, Am. J. Phys. 71 (2003) 1208"
    last: ClassVar[bool] = True
    strength: Array = strength((0.0,), low=0.0, high=0.9)
    entry: Array = _fixed((((0.0,),),))
    of: str = eqx.field(static=True, default="")

    def phasors(self, values: Complex[Array, " axes"], row: LockInRow) -> Complex[Array, " axes"]:
        return values + self.chosen(row) * (row.before - values)


TERMS: tuple[type[InstrumentTerm], ...] = (
    *(LockInMemory, ReferencePhase, LockInBackground, LockInFeedthrough),
    *(DriveLevel, RecordGain, FrequencyOffset),
    *(FrequencyDrift, DampingDrift, GainDrift, PhaseDrift),
)


def _pulled(now: Moment, shift: Array) -> Float[Array, " axes"]:
    """The force [N] that moves the frequencies of the device by a small part of themselves."""
    return -2.0 * shift * (now.device.stiffness_matrix @ now.displacement) / now.device.mobility


def _pairs(parts: Float[Array, " k"]) -> Complex[Array, " axes"]:
    return parts[0::2] + 1j * parts[1::2]
