"""What a lock-in does to the phasors of a record: terms of the instrument that act on rows as they are read."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.linalg import inverse

from .base import LockInEffect, LockInRow, strength
from .instrument import (
    BY_RECORD,
    ClockedTerm,
    DampingDrift,
    DriveLevel,
    FrequencyDrift,
    FrequencyOffset,
    FrequencyWander,
    GainDrift,
    InstrumentTerm,
    RecordGain,
    RecordTemperature,
    SeenRows,
    row_field,
)
from .lock_in_poles import LockInFilter


_PARTS = ("in phase", "quadrature")


class PhaseDrift(ClockedTerm, LockInEffect):
    """The reference of the lock-in turns by s_k rad over a record. Zero: it stays."""

    name, unit, law = "phase_drift", "rad", "V → V·exp(i·s_k·(t/T − ½))"
    strength: Array = strength((0.0,), low=-1.0, high=1.0)
    entry: Array = row_field((((0.0,),),))
    begin: Array = row_field((0.0,))
    span: Array = row_field((1.0,))

    def phasors(self, values: Complex[Array, " axes"], row: LockInRow) -> Complex[Array, " axes"]:
        return values * jnp.exp(1j * self.grown(row))

    def moved(self, seen: SeenRows) -> np.ndarray:
        return 1j * seen.values


class ReferencePhase(InstrumentTerm, LockInEffect):
    """The reference of the lock-in is turned by s_k rad, in all records or in each. Zero: it is the drive itself."""

    name, unit, law = "reference_phase", "rad", "V → V·exp(i·s_k)"
    ways: ClassVar[tuple[str, ...]] = (BY_RECORD,)
    in_proportion: ClassVar[bool] = True
    of_every_phasor: ClassVar[bool] = True
    turns: ClassVar[bool] = True
    strength: Array = strength((0.0,))
    entry: Array = row_field((((0.0,),),))
    of: str = eqx.field(static=True, default="")

    def phasors(self, values: Complex[Array, " axes"], row: LockInRow) -> Complex[Array, " axes"]:
        return values * jnp.exp(1j * self.chosen(row))

    def moved(self, seen: SeenRows) -> np.ndarray:
        return 1j * seen.values


class LockInBackground(InstrumentTerm, LockInEffect):
    """A phasor that is there without a drive: V → V + s, real and imaginary part of each channel. Zero: none."""

    name, unit, law = "lock_in_background", "V", "V → V + s_k"
    parts: ClassVar[tuple[str, ...]] = _PARTS
    of_every_phasor: ClassVar[bool] = True
    imitates: ClassVar[str] = "readout_delay"
    strength: Array = strength((0.0,))
    entry: Array = row_field((((0.0,),),))

    def phasors(self, values: Complex[Array, " axes"], row: LockInRow) -> Complex[Array, " axes"]:
        return values + _pairs(self.strength)

    def moved(self, seen: SeenRows) -> np.ndarray:
        return np.ones_like(seen.values)

    def slopes(self, seen: SeenRows) -> np.ndarray:
        return _each_part(self.moved(seen))


class InterferingLine(InstrumentTerm, LockInEffect):
    """A line that stands in a record, of the mains or another instrument: V → V + s·e^{iω(t − t₀)}, real and imaginary
    part of each channel, line by line; of a waveform what is real of it. Zero: none.

    Args:
        omega: (k,) angular frequency of the line of each number, of phasors beside their reference [rad/s].
        middle: (k,) t₀, amid the record of each [s]: there its phase does not hang on how well ω is known.
    """

    name, unit, law = "interfering_line", "V", "V → V + s_k·exp(iω_k·(t − t_0))"
    parts: ClassVar[tuple[str, ...]] = _PARTS
    of_every_phasor: ClassVar[bool] = True
    beside_any_motion: ClassVar[bool] = True
    strength: Array = strength((0.0,))
    entry: Array = row_field((((0.0,),),))
    omega: Array = row_field((0.0,))
    middle: Array = row_field((0.0,))

    def phasors(self, values: Array, row: LockInRow) -> Array:
        taken = self.entry[jnp.asarray(row.record, int), jnp.asarray(row.sweep, int)]
        numbers = taken * self.strength * jnp.exp(1j * self.omega * (row.time - self.middle))
        lines = numbers.reshape(-1, values.size, 2)
        turning = jnp.sum(lines[..., 0] + 1j * lines[..., 1], axis=0)
        return values + (turning if jnp.iscomplexobj(values) else turning.real)

    def moved(self, seen: SeenRows) -> np.ndarray:
        return np.ones_like(seen.values)

    def slopes(self, seen: SeenRows) -> np.ndarray:
        omega, middle = (np.broadcast_to(part, self.strength.shape) for part in (self.omega, self.middle))
        turned = self.taken(seen) * np.exp(1j * omega * (seen.time[:, None] - middle))
        lines = self.strength.size // (2 * seen.values.shape[1])
        return np.tile(_each_part(self.moved(seen)), lines) * turned[:, None, :]


class LockInFeedthrough(InstrumentTerm, LockInEffect):
    """A phasor in proportion to the drive: V → V + s·u, real and imaginary part of each channel, u the electrode that
    is driven. Zero: none.
    """

    name, unit, law = "lock_in_feedthrough", "V/N", "V → V + s_k·u"
    in_proportion: ClassVar[bool] = True
    parts: ClassVar[tuple[str, ...]] = _PARTS
    of_every_phasor: ClassVar[bool] = True
    imitates: ClassVar[str] = "readout_delay"
    strength: Array = strength((0.0,))
    entry: Array = row_field((((0.0,),),))

    def phasors(self, values: Complex[Array, " axes"], row: LockInRow) -> Complex[Array, " axes"]:
        return values + _pairs(self.strength) * jnp.sum(row.force)

    def moved(self, seen: SeenRows) -> np.ndarray:
        return np.ones_like(seen.values) * seen.force[:, None]

    def slopes(self, seen: SeenRows) -> np.ndarray:
        return _each_part(self.moved(seen))


class CapacitiveFeedthrough(InstrumentTerm, LockInEffect):
    """A phasor in proportion to the drive and to its frequency, as of the current through a capacitance beside the
    device: V → V + s·ω·u, real and imaginary part of each channel. Zero: none.

    It takes the place of `lock_in_feedthrough`, the same at all frequencies, where sweeps tell the two apart: over a
    band a share b of the frequency they differ by b.
    """

    name, unit, law = "capacitive_feedthrough", "V·s/N", "V → V + s_k·ω·u"
    in_proportion: ClassVar[bool] = True
    parts: ClassVar[tuple[str, ...]] = _PARTS
    strength: Array = strength((0.0,))
    entry: Array = row_field((((0.0,),),))

    def phasors(self, values: Complex[Array, " axes"], row: LockInRow) -> Complex[Array, " axes"]:
        return values + _pairs(self.strength) * row.frequency * jnp.sum(row.force)

    def moved(self, seen: SeenRows) -> np.ndarray:
        return np.ones_like(seen.values) * (seen.frequency * seen.force)[:, None]

    def slopes(self, seen: SeenRows) -> np.ndarray:
        return _each_part(self.moved(seen))


class LateReadings(InstrumentTerm, LockInEffect):
    """All that is read comes late by s, what leaks past the device too, as behind a converter that takes many periods:
    V → V·exp(−i(ω − ω₀)·s). Zero: at once. What turns all frequencies alike is `reference_phase`, so that whole periods
    do not count; a `readout_delay` is the device's alone.

    Args:
        middle: ω₀, amid the frequencies that were swept [rad/s].
    """

    name, unit, law = "late_readings", "s", "V → V·exp(−i(ω − ω₀)·s)"
    in_proportion: ClassVar[bool] = True
    strength: Array = strength((0.0,))
    entry: Array = row_field((((0.0,),),))
    middle: Array = row_field(0.0)

    def phasors(self, values: Complex[Array, " axes"], row: LockInRow) -> Complex[Array, " axes"]:
        return values * jnp.exp(-1j * (row.frequency - self.middle) * self.chosen(row))

    def moved(self, seen: SeenRows) -> np.ndarray:
        return -1j * (seen.frequency - np.asarray(self.middle))[:, None] * seen.values


class LockInMemory(InstrumentTerm, LockInEffect):
    """The filter of the lock-in still shows the part s of the row before: V_n → V_n + s_k·(seen_{n−1} − V_n). Zero: it
    has settled. A filter with one time constant τ, read a dwell D after the step, has s = exp(−D/τ).

    Libbrecht, Black and Hirata, "A basic lock-in amplifier experiment for the undergraduate laboratory", Am. J. Phys.
    71 (2003) 1208.
    """

    name, unit, law = "lock_in_memory", "1", "V_n → V_n + s_k·(V_{n−1} − V_n)"
    ways: ClassVar[tuple[str, ...]] = (BY_RECORD,)
    reference = "Libbrecht, Black and Hirata, Am. J. Phys. 71 (2003) 1208"
    last: ClassVar[bool] = True
    strength: Array = strength((0.0,), low=0.0, high=0.5)
    entry: Array = row_field((((0.0,),),))
    of: str = eqx.field(static=True, default="")

    def phasors(self, values: Complex[Array, " axes"], row: LockInRow) -> Complex[Array, " axes"]:
        return values + self.chosen(row) * (row.before - values)

    def moved(self, seen: SeenRows) -> np.ndarray:
        return seen.before - seen.values


class UnsettledRows(InstrumentTerm, LockInEffect):
    """The motion of a row begins where that of the row before ended and rings down to its own: of what is then left of
    the difference, e^{−Bt} after the dwell t, the part s is seen. Zero: rows have settled; one: the ring-down of the
    device, known from its frequency and damping and from the clock of the record.
    """

    name, unit, law = "unsettled_rows", "1", "V_n → V_n + s·e^{−Bt}·(V_{n−1} − V_n)"
    last: ClassVar[bool] = True
    rings: ClassVar[bool] = True
    strength: Array = strength((0.0,), low=0.0, high=1.2)
    entry: Array = row_field((((0.0,),),))

    def phasors(self, values: Complex[Array, " axes"], row: LockInRow) -> Complex[Array, " axes"]:
        return values + self.chosen(row) * (row.left @ (row.before - values))

    def moved(self, seen: SeenRows) -> np.ndarray:
        return seen.ringing


class LockInTime(InstrumentTerm, LockInEffect):
    """The filter of the lock-in, of one time constant s, lags behind a motion that rings down from row to row itself:
    e^{−Bt} becomes (1 − sB)⁻¹·(e^{−Bt} − sB·e^{−t/s}). Zero: it follows at once.
    """

    name, unit, law = "lock_in_time", "s", "e^{−Bt} → (1 − s·B)⁻¹·(e^{−Bt} − s·B·e^{−t/s})"
    last: ClassVar[bool] = True
    rings: ClassVar[bool] = True
    strength: Array = strength((0.0,), low=0.0)
    entry: Array = row_field((((0.0,),),))

    def phasors(self, values: Complex[Array, " axes"], row: LockInRow) -> Complex[Array, " axes"]:
        lag, still = self.chosen(row), jnp.eye(values.size)
        held = jnp.exp(-row.dwell / jnp.where(lag > 0, lag, 1.0)) * (lag > 0)
        # Of the way from the row before to where this one settles, e^{−Bt} is left in `values` already.
        way = inverse(still - row.left) @ (row.before - values)
        behind = inverse(still - lag * row.decay) @ (row.left - lag * held * row.decay)
        return values + (behind - row.left) @ way

    def moved(self, seen: SeenRows) -> np.ndarray:
        return seen.turning


TERMS: tuple[type[InstrumentTerm], ...] = (
    *(UnsettledRows, LockInTime, LockInMemory, LockInFilter, ReferencePhase, LockInBackground, InterferingLine),
    *(LockInFeedthrough, CapacitiveFeedthrough, LateReadings, DriveLevel, RecordGain, RecordTemperature),
    *(FrequencyOffset, FrequencyDrift, FrequencyWander, DampingDrift, GainDrift, PhaseDrift),
)


def _each_part(values: np.ndarray) -> np.ndarray:
    """(n, axes, 2·axes) real and imaginary part of each channel on its own."""
    return values[..., None] * np.kron(np.eye(values.shape[1]), [1.0, 1j])


def _pairs(parts: Float[Array, " k"]) -> Complex[Array, " axes"]:
    return parts[0::2] + 1j * parts[1::2]
