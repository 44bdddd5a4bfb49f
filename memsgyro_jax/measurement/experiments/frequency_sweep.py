"""Frequency sweep: settled lock-in phasors over drive frequency, of one or more sweeps under several conditions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Self, cast

import numpy as np
from pydantic import StrictBool

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table

from ..columns import amplitude_columns, phasor_columns
from ..declared import Declared, Environment, design_device
from ..moving_noise import as_settled, beside_motion
from ..noise import jitter_noise, told_over_frequency
from ..one_place import NEAR, away_from
from ..section import DrivenSection, ExperimentSection, Quantity
from .base import Phasors, Readings
from .checks import exchanged, near_resonance
from .deviation import Deviation, Known, Overlay, Series, Variable, View, around_modes, by_setting, in_phase
from .harmonic_sweep import HarmonicSweep
from .missing_force import SweepForce
from .record import AbstractRecord, Watched
from .rounded_frequency import rounded_frequencies
from .sheet import Sheet
from .sweep_coverage import hasty, peaks_not_seen, place_in_band, swept_elsewhere, weak_sweeps
from .sweep_layout import halves, joined_rows
from .sweep_readings import motion_of_amplitudes, scattered, steadied, varied
from .sweep_repeats import courses_of, not_repeats
from .sweep_rows import check_order, check_phase, levels_set, refuse_copies, single_sweeps


_TWO_PI = 2 * np.pi
_CURVES = 7  # sweeps in one picture
_ZOOM = 2.5  # full widths of the resonance to each side of a close-up
_CLEAR = 20.0  # standard deviations from which a sweep shows its resonance clearly
_AMPLE = 5.0  # standard deviations above which an amplitude scatters as each of its parts does
_SCATTER = 0.02  # of the drive that is a reading of one setting, and not another


class FrequencySweepSection(DrivenSection):
    """`kind = "frequency_sweep"`: settled lock-in phasors over the drive's frequency, of one or more sweeps."""

    settled: StrictBool = True
    """Whether transients had died away; if not, with a column `t`, each row begins where the one before ended."""
    drive_force: Quantity | None = None
    """Amplitude (peak) of the drive, a force, or in the unit that `[drive]` has for it; left out where a column has it,
    or where it is part of a resonator's gain."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FrequencySweepRecord(AbstractRecord):
    """Lock-in phasors over drive frequency: V(t) = Re[(I + iQ) e^{iωt}] for a drive F cos(ωt).

    Args:
        axis: driven electrode, 0 = x, 1 = y.
        settled: whether transients had died away; if not, and with times, each row begins where that before ended.
        frequency: (n,) angular frequency [rad/s].
        drive: (n,) amplitude of the force [N], of the input [V] for a resonator.
        temperature: (n,) [K].
        bias_voltage: (n,) of the electrodes [V].
        rate: (n,) angular rate [rad/s], zero where the record does not say.
        phasors: (n, channels) complex, in the record unit.
        time: (n,) when each row was recorded [s], or `None`.
        phase_known: whether phasors are more than amplitudes, which stand there with a phase of zero.
        thermometer: by how much readings of the temperature scattered from row to row [K], which was taken off them.
    """

    kind: ClassVar[str] = "frequency_sweep"
    stepped: ClassVar[bool] = True
    section: ClassVar[type[ExperimentSection]] = FrequencySweepSection
    axis: int
    settled: bool
    frequency: np.ndarray
    drive: np.ndarray
    temperature: np.ndarray
    bias_voltage: np.ndarray
    rate: np.ndarray
    phasors: np.ndarray
    time: np.ndarray | None = None
    phase_known: bool = True
    thermometer: float = 0.0

    @property
    def readings(self) -> np.ndarray:
        return self.phasors if self.phase_known else self.phasors.real

    @property
    def sweep_rate(self) -> float:
        """Of the quickest of its sweeps."""
        if self.time is None:
            return float("inf")
        if not self.settled:
            return 0.0
        steps = [np.diff(self.frequency[rows]) / np.diff(self.time[rows]) for rows in self.sweeps]
        return max((float(np.max(np.abs(step), initial=0.0)) for step in steps), default=0.0)

    @cached_property
    def sweeps(self) -> tuple[slice, ...]:
        """The rows of each single sweep: a new one begins where a condition is set anew or the frequency turns back."""
        largest = float(np.max(np.abs(self.rate), initial=0.0))
        # Each may be a reading: within 2 % of the drive, 1 K and 1 % of the largest rate it counts as one setting.
        within = (
            (np.log(self.drive), _SCATTER),
            (self.bias_voltage, 0.0),
            (self.temperature, 1.0),
            (self.rate, 0.01 * largest),
        )
        return single_sweeps(self.frequency, within)

    @cached_property
    def setting(self) -> np.ndarray:
        """(n,) drive that was set, of which `drive` may be a reading: the mean of all sweeps within 2 %."""
        return levels_set(self.drive, self.sweeps, _SCATTER)

    @cached_property
    def courses(self) -> tuple[np.ndarray, ...]:
        """Rows that ought to lie on one curve, in the order of frequency: of a sweep and its repeats the same way."""
        return courses_of(self)

    @property
    def extent(self) -> str:
        low, high = self.frequency.min() / _TWO_PI, self.frequency.max() / _TWO_PI
        return f"{len(self.sweeps)} sweeps of {'xy'[self.axis]}, {low:.6g} to {high:.6g} Hz"

    # ---- record

    @classmethod
    def read(cls, sheet: Sheet) -> Self:
        columns, around, axis = sheet.columns, sheet.declared.environment, sheet.axis
        drives = [name for group in columns.words.drives for name in group]
        conditions = ("T", "V_bias", "rate", "t")
        columns.refuse_others(["f", *columns.signal_names("_I", "_Q", "_amp", "_phase"), *drives, *conditions])
        record = cls(
            **sheet.common(),
            axis=axis,
            settled=sheet.entry.settled,
            drive=sheet.drive_levels(axis),
            frequency=columns.frequency(),
            temperature=columns.optional("T", "K", around.temperature),
            bias_voltage=columns.optional("V_bias", "V", around.bias_voltage),
            rate=columns.optional("rate", "rad/s", 0.0),
            phasors=columns.phasors() if columns.has_phase else columns.amplitudes() + 0j,
            time=columns.time() if columns.has("t") else None,
            phase_known=columns.has_phase,
        )
        temperature, scatter = steadied(record.temperature, record.sweeps)
        return replace(record, temperature=temperature, thermometer=scatter)

    def check(self, table: Table, declared: Declared) -> None:
        try:
            near_resonance(float(self.frequency.min()), float(self.frequency.max()), declared.resonances)
        except InputError as error:
            raise InputError(f"{table.path}, column `f`: the band {error}.") from error
        check_order(table, self.frequency, self.sweeps)
        refuse_copies(table)
        if not self.settled and len(self.channels) < declared.channels:
            raise InputError(
                f"{table.path}, header: must have the readings of both axes where rows had not settled, as each begins "
                "in the motion of the row before."
            )
        for rows in self.sweeps if self.phase_known and self.axis in self.channels else ():
            check_phase(table, rows, self.axis, self.frequency, self.phasors, self.noise_levels[self.axis])

    def keys(self, declared: Declared) -> dict[str, Any]:
        return {"drive_axis": "xy"[self.axis], "settled": self.settled}

    def columns(self, declared: Declared) -> dict[str, np.ndarray]:
        words = declared.words
        return {
            **({} if self.time is None else {"t [s]": self.time}),
            f"{words.drives[0][self.axis]} [{words.force}]": self.drive,
            "V_bias [V]": self.bias_voltage,
            "T [K]": self.temperature,
            "rate [rad/s]": self.rate,
            "f [rad/s]": self.frequency,
            **(phasor_columns if self.phase_known else amplitude_columns)(self.phasors, declared, self.channels),
        }

    # ---- predict

    def experiment(self, declared: Declared, number: int) -> HarmonicSweep:
        return joined_rows(declared, [(number, self)], np.arange(self.rows), np.ones(self.rows, bool))

    @classmethod
    def laid_out(cls, declared: Declared, records: Sequence[tuple[int, Self]], alone: bool) -> list[Readings]:
        """All rows of all sweeps as one experiment to fit and one, of the same shape, to validate; without a role every
        second row is fitted.
        """
        kinds = ([pair for pair in records if pair[1].phase_known == known] for known in (True, False))
        return [one for pairs in kinds for one in halves(declared, pairs)]

    @property
    def frequencies(self) -> np.ndarray:
        return self.frequency

    @property
    def directions(self) -> np.ndarray:
        """(n,) +1 in sweeps whose frequency rises, −1 in those where it falls."""
        falls = [self.frequency[rows][-1] < self.frequency[rows][0] for rows in self.sweeps]
        return np.repeat(np.where(falls, -1.0, 1.0), [rows.stop - rows.start for rows in self.sweeps])

    def away(self, around: Environment) -> np.ndarray:
        """(n,) how far the surroundings of each row are from those declared."""
        return away_from(around, self.temperature, self.bias_voltage, self.rate)

    def calm(self, around: Environment) -> np.ndarray:
        """(n,) which rows were measured at rest and in the surroundings that the case declares."""
        return self.away(around) == 0.0

    # ---- start

    def starting_phasors(self, declared: Declared) -> Phasors | None:
        seen = len(self.channels) if self.phase_known else 1
        if (alone := seen < declared.channels) and self.axis not in self.channels:
            return None
        # The lowest drive is the most linear, and what is nearest to the declared conditions is one device.
        readout, away = declared.readout, self.away(declared.environment)
        clear = [rows for rows in self.sweeps if self._peak(rows) > _CLEAR] or self.sweeps
        lowest = min(self.setting[rows][0] for rows in clear)
        lowest = lowest if clear is not self.sweeps else self.setting.max()
        calm = np.abs(self.setting - lowest) <= 1e-9 * lowest
        calm &= away <= np.min(away[calm]) + NEAR
        force = np.outer(self.drive, np.eye(declared.channels)[self.axis])[calm]
        motion, omega = readout.motion(self.phasors, self.frequency)[calm], self.frequency[calm]
        weight = abs(readout.scale) * omega**readout.order / as_settled(self)
        own, axis = ([self.axis], self.axis) if alone else (self.channels, None)
        other = np.abs(motion[:, 1 - axis]) if axis is not None and 1 - axis in self.channels else None
        return Phasors(omega, motion[:, own], force[:, own] + 0j, weight, not self.phase_known, axis, beside=other)

    def motion(self, declared: Declared) -> np.ndarray:
        """(n, axes) displacement phasors that were seen; where no phase was, those of the device as designed."""
        motion = declared.readout.motion(self.phasors, self.frequency)
        known = self.frequency, self.drive, self.axis, design_device(declared), self.sweeps
        return motion if self.phase_known else motion_of_amplitudes(motion, *known)

    def _peak(self, rows: slice) -> float:
        """Highest reading over noise of the driven channel within a sweep; of the other where it was not recorded."""
        channel = self.axis if self.axis in self.channels else self.channels[0]
        return float(np.max(np.abs(self.phasors[rows, channel])) / (self.noise_levels[channel] or 1e-300))

    # ---- noise and quality

    def noise_told_by(self, channels: Sequence[int]) -> tuple[float | None, float]:
        told = told_over_frequency(self.frequency, self.readings[:, channels], self.sweeps, self.courses)
        return told if self.settled else beside_motion(told, self, channels)

    @property
    def noise_by_channel(self) -> bool:
        if self.phase_known:
            return True
        # An amplitude that noise alone makes scatters by less than each of its parts.
        size = np.median(np.abs(self.phasors[:, self.channels]), axis=0)
        return bool(np.all(size > _AMPLE * (self.noise_told_by(self.channels)[0] or 0.0)))

    @cached_property
    def noise_of_rows(self) -> np.ndarray:
        white = super().noise_of_rows
        if self.noise_std:
            return white
        # Noise that differs between channels is no jitter, which is then looked for in each alone.
        for seen in [[c] for c in self.channels] if self.told_noise.levels else [slice(None)]:
            jitter = jitter_noise(self.frequency, self.readings[:, seen], self.courses)
            white[:, seen] = white[:, seen] if jitter is None else np.hypot(white[:, seen], jitter)
        return white

    def watched(self, noise: np.ndarray) -> list[Watched]:
        every = [(f"channel {'xy'[c]}", self.phasors[:, c], float(noise[c])) for c in self.channels]
        return [Watched(*one, self.frequency, self.sweeps, True) for one in every]

    def warnings(self, declared: Declared) -> list[str]:
        read, hertz = self.phasors[:, self.channels], self.frequency / _TWO_PI
        seen = read if self.phase_known else np.abs(read), self.setting, self.sweeps, swept_elsewhere(self, declared)
        found = exchanged(self.file, self.axis, read) + peaks_not_seen(self.file, hertz, *seen)
        near = hertz, read, self.sweeps, self.noise_std or self.estimated_noise(), declared.readout.unit
        found += weak_sweeps(self.file, [self.lines[rows] for rows in self.sweeps], [*map(self._peak, self.sweeps)])
        found += scattered(self.file, self.thermometer) + rounded_frequencies(self.file, *near)
        found += not_repeats(self, declared.words.force)
        return found + hasty(self.file, self.time if self.settled else None, declared.shortest_decay)

    # ---- misfit and overlay

    def known(self, declared: Declared) -> tuple[Known, ...]:
        out = (
            Known("frequency", self.frequency, "rad/s", set=False),
            Known("drive", self.setting, declared.words.force),
            Known("temperature", self.temperature, "K"),
            Known("bias voltage", self.bias_voltage, "V"),
            Known("rate", self.rate, "rad/s"),
        )
        return out if self.time is None else (*out, Known("time", self.time, "s", set=False))

    def series(self, deviation: Deviation) -> Series:
        motion = np.abs(deviation.model.motion(deviation.predicted, self.frequency)[:, self.axis])
        turned = in_phase(deviation.white, deviation.predicted) if self.phase_known else deviation.white
        known = self.known(deviation.declared)
        parts = [part for one in known if one.set for part in by_setting(one, self.sweeps)]
        variables = [Variable("displacement", motion), *(Variable(one.name, one.values) for one in known)]
        return Series(
            self.name, deviation.channels, deviation.white, turned, self.sweeps,
            (*parts, *around_modes(self.frequency, deviation)), (), tuple(variables),
        )  # fmt: skip

    def at(self, row: int) -> str:
        return f"near {place_in_band(self.frequency / _TWO_PI, row)}"

    def overlay(self, base: Deviation, final: Deviation) -> Overlay:
        """Every channel over frequency, and the neighbourhood in which the base model is worst."""
        hertz, white = self.frequency / _TWO_PI, base.size
        row, worst = np.unravel_index(int(np.nanargmax(white)), white.shape)
        width = _ZOOM * float(np.max(np.diag(np.asarray(base.model.device.damping_matrix)))) / _TWO_PI
        closest = next(piece for piece in self.sweeps if piece.start <= row < piece.stop)
        near = np.zeros(self.rows, bool)
        near[closest] = np.abs(hertz[closest] - hertz[row]) <= width

        def curves(pieces: Sequence[slice | np.ndarray]) -> tuple[np.ndarray, ...]:
            rows = [np.arange(self.rows)[piece] for piece in pieces]
            return tuple(piece[np.argsort(hertz[piece], kind="stable")] for piece in rows)

        drawn = curves(self.sweeps[:: -(-len(self.sweeps) // _CURVES)])
        views = [View(c, "frequency [Hz]", hertz, slice(None), drawn) for c in self.channels]
        if near.sum() > 4:
            views.append(View(int(worst), "frequency [Hz]", hertz, near, curves((near,)), near=True))
        return Overlay(f"driven on {'xy'[self.axis]}{varied(self.known(base.declared), self.sweeps)}", tuple(views))

    def missing_force(self, deviation: Deviation) -> SweepForce | None:
        """The missing force of every row, fitted or not; none from amplitudes alone, or without the driven channel."""
        if not self.phase_known or self.axis not in self.channels:
            return None
        pieces, model = [], deviation.model
        for readings in deviation.readings:
            mine = readings.record == deviation.number
            rows, sweep = readings.row[mine], cast(HarmonicSweep, readings.experiment)
            pieces.append((rows, *sweep.missing(model, mine, deviation.predicted[rows])))
        seen = np.concatenate([piece[0] for piece in pieces])  # all but a first row that began nobody knows how
        rows = seen[order := np.argsort(seen)]
        motion, force, gain = (np.concatenate([piece[k] for piece in pieces])[order] for k in (1, 2, 3))
        omega = self.frequency[rows]
        noise = self.noise_levels / np.abs(np.asarray(model.scale)) / omega[:, None] ** model.order
        std = np.full(force.shape, np.inf)  # of a channel that was not recorded, which moves as the model has it
        own = self.channels
        std[:, own] = np.sqrt(np.einsum("nij,nj->ni", gain[:, own][:, :, own] ** 2, noise[:, own] ** 2))
        return SweepForce(
            self.name, self.axis, omega, self.drive[rows], self.temperature[rows], self.bias_voltage[rows],
            motion[:, self.axis], force, std,
        )  # fmt: skip
