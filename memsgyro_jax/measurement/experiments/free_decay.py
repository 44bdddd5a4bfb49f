"""Free decay: a vibration that dies out, whatever made it; how it began is solved for."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import jax.numpy as jnp
import numpy as np
from pydantic import Field, StrictBool
from scipy.signal import hilbert

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table

from ..clock import check_period, usual_period
from ..columns import phasor_columns
from ..declared import Declared, si
from ..modes_apart import modes_apart
from ..noise import freedom_over_time, noise_beside_tone
from ..section import ExperimentSection, Frequency, Seconds
from ..tracking import Track, tracked
from .base import CartesianNoise, Readings, RealNoise, surroundings
from .checks import check_sampling
from .clocked import CONDITIONS, REACH, WaveformRecord, surroundings_told
from .converter_steps import lost_in_steps
from .decay_pieces import FreeDecay
from .deviation import Deviation, Series, in_phase, segments
from .missing_force import TimeForce
from .sheet import Sheet
from .unknown_start import put_back


NEARBY = 1.2  # of the frequency that a channel shows most: as high vibrates what shows less in it
PHASE_STEP = 0.06  # of the highest mode per integration step [rad], in the frame of phasors, and between uneven stamps
WAVE_STEP = 0.2  # the same of even waveforms; where that moves a reading, steps become shorter
TURN = 4.0  # phase by which a vibration may turn in the time of a piece, between its lowest and highest frequency [rad]
CYCLES, ROWS = 4, 24  # in a piece at least
GAP = 0.25  # of a piece without a row, over which none reaches


class FreeDecaySection(ExperimentSection):
    """`kind = "free_decay"`: a vibration left alone, however it began."""

    begin: Seconds | None = Field(default=None, alias="from")
    """Time in the file from which rows count; left out, the first."""
    end: Seconds | None = Field(default=None, alias="to")
    """Time in the file until which rows count; left out, the last."""
    reference_frequency: Frequency | None = None
    """Frequency of the lock-in's reference, whose phasors the rows are; left out, they are waveforms."""
    uneven: StrictBool = False
    """Whether its stamps are right though they follow no clock of one period, or rows are lost."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FreeDecayRecord(WaveformRecord):
    """A device left alone, from any motion: start amplitude and phase are unknown.

    Without a role the earlier half is fitted where no other kind is, and the later half validates.

    Args:
        time: (n,) uniform [s], unless `uneven`.
        signals: (n, channels) in the record unit; complex phasors of e^{iωt} from a lock-in.
        reference_frequency: of the phasors [rad/s]; `None` for waveforms.
        uneven: whether the stamps jitter or have gaps.
    """

    kind: ClassVar[str] = "free_decay"
    section: ClassVar[type[ExperimentSection]] = FreeDecaySection
    last_resort: ClassVar[bool] = True
    driven: ClassVar[bool] = False
    reference_frequency: float | None = None
    uneven: bool = False

    @property
    def period(self) -> float:
        return usual_period(self.time) if self.uneven else super().period

    @property
    def extent(self) -> str:
        return f"{self.span}, from an unknown start at {self.time[0]:.4g} s"

    @classmethod
    def read(cls, sheet: Sheet) -> Self:
        columns, entry = sheet.columns, sheet.entry
        reference = None if entry.reference_frequency is None else sheet.frequency("reference_frequency")
        ends = ("",) if reference is None else ("_I", "_Q", "_amp", "_phase")
        columns.refuse_others(["t", *CONDITIONS, *columns.signal_names(*ends)])
        time = columns.time()
        kept = np.ones(len(time), bool)
        for key, name, inside in (("from", "begin", np.greater_equal), ("to", "end", np.less_equal)):
            given = getattr(entry, name)
            if given is not None:
                with sheet.source.section("experiment", sheet.number, key):
                    kept &= inside(time, si(given, "s", positive=False))
                    if kept.sum() < ROWS:
                        raise InputError(f"must leave {ROWS} rows or more, but leaves {kept.sum()}")
        whole = cls(
            **sheet.common(),
            **surroundings_told(columns, sheet.declared.environment),
            time=time,
            signals=columns.signals() if reference is None else columns.phasors(),
            reference_frequency=reference,
            uneven=entry.uneven,
        )
        return whole if kept.all() else whole.only(kept)

    def check(self, table: Table, declared: Declared) -> None:
        if len(self.channels) < declared.channels:
            raise InputError(
                f"{table.path}, header: must have the readings of both axes, as a decay begins in an unknown motion of "
                "each; with the drive before it, a ring-down may do without one."
            )
        if not self.uneven:
            check_period(table, None, " (where the stamps are right, say `uneven = true`)")
        if self.reference_frequency is None:
            check_sampling(self.period, self.rows, declared.resonances, table)

    def keys(self, declared: Declared) -> dict[str, Any]:
        keys: dict[str, Any] = {"uneven": True} if self.uneven else {}
        if self.reference_frequency is not None:
            keys["reference_frequency"] = {"value": self.reference_frequency, "unit": "rad/s"}
        return keys

    def columns(self, declared: Declared) -> dict[str, np.ndarray]:
        if self.reference_frequency is None:
            return super().columns(declared)
        return {"t [s]": self.time, **self.told_columns, **phasor_columns(self.signals, declared)}

    # ---- pieces

    def piece_rows(self, declared: Declared) -> int:
        """Rows of a piece: so few that the frequency, where it changes with the amplitude or in time, turns the
        vibration little within one; at most half of the record. Longer pieces tell more, as each loses its start.

        Of two channels both vibrations may show in each, and turn it though neither frequency changes: what turns
        less counts, the channels or the vibrations.
        """
        cycle, half = 2 * np.pi / declared.resonances[0] / self.period, self.rows // 2
        least, reference = max(ROWS, int(np.ceil(CYCLES * cycle))), self.reference_frequency or 0.0
        channels = [self.track(declared, channel).seen for channel in range(declared.channels)]
        ways = [channels, *([self._modes(declared)] if len(channels) > 1 and not self.uneven else [])]
        pieces = 1  # of the half: whole numbers of them leave no row over
        while half // pieces > least and (
            min(max(track.turned(half // pieces * self.period, reference) for track in tracks) for tracks in ways)
            > TURN
        ):
            pieces += 1 + pieces // 4
        return max(1, min(half, max(least, half // pieces)))

    def _modes(self, declared: Declared) -> list[Track]:
        """The vibrations of two channels, each by itself, where they are seen."""
        asked = ("modes", declared.resonances)
        if asked not in self._tracks:
            reference, louder = self.reference_frequency or 0.0, max(self.free_modes(declared))[1]
            rows = max(1, int(CYCLES * 2 * np.pi / louder / self.period))
            apart = modes_apart(self.time, self.signals, louder - reference, rows)
            band = REACH[0] * declared.resonances[0], REACH[1] * declared.resonances[1]
            self._tracks[asked] = [tracked(self.time, mode, band, reference=reference).seen for mode in apart.T]
        return self._tracks[asked]

    def _whole(self, rows: int) -> np.ndarray:
        """Numbers of the rows that whole pieces of `rows` hold, none of which reaches over a long gap."""
        gaps = np.flatnonzero(np.diff(self.time) > GAP * rows * self.period) + 1 if self.uneven else ()
        runs = np.split(np.arange(self.rows), gaps)
        return np.concatenate([run[len(run) % rows :] for run in runs])

    def experiment(self, declared: Declared, number: int) -> FreeDecay:
        rows = self.piece_rows(declared)
        return self._experiment(declared, number, self._whole(rows), rows)

    @classmethod
    def laid_out(cls, declared: Declared, records: Sequence[tuple[int, Self]], alone: bool) -> list[Readings]:
        out = []
        for number, record in records:
            rows = record.piece_rows(declared)
            whole = record._whole(rows)
            parts = [(whole, record.role == "fit")]
            if record.role is None and alone:
                half = whole.size // rows // 2 * rows
                parts = [(whole[:half], True), (whole[-half:], False)]
            for part, fitted in parts:
                experiment = record._experiment(declared, number, part, rows)
                out.append(Readings(experiment, np.full(part.size, number), part, fitted))
        return out

    def _experiment(self, declared: Declared, number: int, part: np.ndarray, rows: int) -> FreeDecay:
        """Of some rows, in pieces of `rows`."""
        few = self.only(part)
        noise, stepped = self.noise_of_rows[part], self.reference_frequency is None and not self.uneven
        most = WAVE_STEP if stepped else PHASE_STEP
        step = min(self.period, most / self._distance(declared))
        spans = np.ptp(few.time.reshape(-1, rows), axis=1)
        return FreeDecay(
            name="free decays",
            measured=jnp.asarray(few.signals),
            noise=RealNoise(noise) if self.reference_frequency is None else CartesianNoise(noise),
            start=jnp.asarray(few._starts(declared, rows)),
            period=jnp.asarray(self.period),
            surroundings=surroundings(declared, number, part.size, time=few.time, **few.surrounded(np.asarray)),
            frequency=jnp.asarray(self.reference_frequency or 0.0),
            substeps=int(np.ceil(self.period / step)),
            nodes=1 + int(np.ceil(spans.max() / step)) if self.uneven else 0,
        )

    def _distance(self, declared: Declared) -> float:
        """How fast at most the vibration turns in the frame of the record [rad/s].

        The record shows it itself; what a design leaves open may be a thousand times as wide.
        """
        reference = self.reference_frequency or 0.0
        seen = [self.track(declared, channel).seen for channel in range(declared.channels)]
        if away := [float(np.max(np.abs(track.omega - reference))) for track in seen if track.time.size]:
            return (2.0 if reference else NEARBY) * max(away)
        return max(abs(omega - reference) for omega in declared.resonances)

    def _starts(self, declared: Declared, rows: int) -> np.ndarray:
        """Displacement and velocity at the beginning of each piece, as its strongest vibration has them."""
        columns = []
        for channel in range(declared.channels):
            first, reference = self.time[::rows], self.reference_frequency or 0.0
            begin, omega = _at(first, self.track(declared, channel, rows), reference)
            # Windows as long as a piece lose a frequency that moves by their own width within them.
            short = self.track(declared, channel).seen
            if short.time.size > 1:
                near = np.min(np.abs(np.subtract.outer(first, short.time)), axis=1) <= np.diff(short.time).min()
                begin, omega = np.where(near, _at(first, short, reference), (begin, omega))
            begin = declared.readout.motion(begin[:, None], omega.real)[:, 0]
            columns.append((begin.real, (1j * omega.real * begin).real))
        return np.stack([c[0] for c in columns] + [c[1] for c in columns], axis=1)

    # ---- start, noise, misfit and overlay

    def no_louder_than(self, loudest: float) -> "FreeDecayRecord | None":
        constant = 0.0 if self.offset is None else self.offset
        louder = np.flatnonzero(np.max(np.abs(self.readings - constant), axis=1) > loudest)
        begin = int(louder[-1]) + 1 if louder.size else 0
        return self.only(np.arange(begin, self.rows)) if self.rows - begin >= ROWS else None

    def free_modes(self, declared: Declared) -> list[tuple[float, float, float]]:
        """Per channel: amplitude, angular frequency [rad/s] and decay rate [1/s] of its strongest vibration, as means
        weighted with the squared amplitude.
        """
        found = []
        for channel in range(declared.channels):
            track = self.track(declared, channel)
            found.append((float(track.amplitude.max()), *track.usual))
        return found

    @property
    def offset(self) -> np.ndarray | None:
        return super().offset if self.reference_frequency is None else None  # a lock-in sees no constant

    def noise_told_by(self, channels: Sequence[int]) -> tuple[float | None, float]:
        if not self.uneven:
            return super().noise_told_by(channels)
        reference, fastest = self.reference_frequency or 0.0, np.pi / self.period
        slowest = reference - fastest if reference else 8 * np.pi / (self.time[-1] - self.time[0])
        levels = []
        for signal in self.signals[:, channels].T:
            track = tracked(self.time, signal, (slowest, reference + fastest), reference=reference)
            omega = np.interp(self.time, track.time, track.omega) - reference
            levels.append(noise_beside_tone(self.time, signal[:, None], omega))
        return float(np.median(levels)), freedom_over_time(self.signals[:, channels])

    def _with_starts(self, deviation: Deviation) -> Deviation:
        """As far from the model as readings are whose starts were known."""
        white, predicted = deviation.white.copy(), np.nan_to_num(deviation.predicted)
        if self.reference_frequency is None:
            predicted = hilbert(predicted - np.asarray(deviation.model.offset), axis=0)
        waves = np.where(np.isfinite(white).all(axis=-1), predicted / self.noise_of_rows, 0.0)
        for readings in deviation.readings:
            pieces = readings.row.reshape(len(readings.experiment.start), -1)
            white[pieces] = put_back(white[pieces], waves[pieces])
        return replace(deviation, white=white)

    def series(self, deviation: Deviation) -> Series:
        deviation = self._with_starts(deviation)
        if self.reference_frequency is None:
            return super().series(deviation)
        turned = in_phase(deviation.white, deviation.predicted)
        return Series(self.name, deviation.channels, deviation.white, turned, (slice(None),), segments(self.time))

    def missing_force(self, deviation: Deviation) -> TimeForce | None:
        even = self.reference_frequency is None and not self.uneven
        return super().missing_force(deviation) if even else None

    def decay(self, declared: Declared, channel: int) -> Track:
        return self.track(declared, channel)

    def warnings(self, declared: Declared) -> list[str]:
        loud = [self.track(declared, channel).seen.time.size for channel in range(declared.channels)]
        silent = f"{self.file}: nothing that vibrates stands clear of the noise; is `from` right?"
        told = [*super().warnings(declared), *([] if max(loud) > 0 else [silent])]
        return told if np.iscomplexobj(self.signals) else told + self._hidden()

    def _hidden(self) -> list[str]:
        """A sentence where the vibration goes on below the steps in which it was read."""
        every = [lost_in_steps(signal) for signal in self.signals.T]
        end, step = max(every)
        if end == self.rows:
            return []
        at = f"{self.time[end - 1]:.6g}"
        below = f"from {at} s on the decay is smaller than four steps of {step:.3g}, in which it was read, and which"
        return [f'{self.file}: {below} hide what is smaller; end it there by `to = {{ value = {at}, unit = "s" }}`.']


def _at(time: np.ndarray, track: Track, reference: float) -> tuple[np.ndarray, np.ndarray]:
    """Phasor at each of some times [s], turned on and decayed from the nearest window, and its frequency [rad/s]."""
    near = np.argmin(np.abs(np.subtract.outer(time, track.time)), axis=1)
    since, omega = time - track.time[near], track.omega[near]
    drift = np.gradient(track.omega, track.time)[near] if track.time.size > 1 else 0.0
    turned = (1j * (omega - reference + 0.5 * drift * since) - track.decay[near]) * since
    return track.phasor[near] * np.exp(turned), omega + drift * since
