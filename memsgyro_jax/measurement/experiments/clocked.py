"""Records whose rows follow each other in time at one period, and among them waveforms."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import Any, ClassVar

import numpy as np

from ..columns import Columns, signal_columns
from ..declared import Declared, Environment
from ..noise import freedom_over_time, noise_over_time
from ..one_place import away_from
from ..standing_line import StandingLine, standing_lines
from ..tracking import Track, tracked
from .clipping import clipped
from .deviation import Band, Deviation, Known, Overlay, Series, Variable, View, segments
from .missing_force import TimeForce, force_over_time
from .record import AbstractRecord, Watched
from .sweep_readings import scattered, steadied


REACH = (0.5, 2.0)  # times the design's resonances: where a vibration is looked for
CONDITIONS = ("T", "V_bias")  # columns that tell the surroundings of a record
_AROUND = 0.1  # of a mode's frequency that counts as "at" it in a spectrum


@dataclass(frozen=True, eq=False, kw_only=True)
class ClockedRecord(AbstractRecord):
    """A record with a clock.

    Args:
        time: (n,) of each row [s], uniform.
        temperature: (n,) [K]; `None` where the record does not tell its surroundings, which are then those declared.
        bias_voltage: (n,) of the electrodes [V], likewise.
        thermometer: by how much readings of the temperature scattered from row to row [K], which was taken off them.
    """

    time: np.ndarray
    temperature: np.ndarray | None = None
    bias_voltage: np.ndarray | None = None
    thermometer: float = 0.0

    @property
    def period(self) -> float:
        """Mean time from row to row [s]."""
        return float(self.time[-1] - self.time[0]) / (self.rows - 1)

    @property
    def duration(self) -> float:
        return float(self.time[-1])

    @property
    def span(self) -> str:
        """How long and how fast, for people."""
        return f"{self.time[-1] - self.time[0] + self.period:.4g} s at {1 / self.period:.6g} Hz"

    def noise_told_by(self, channels: Sequence[int]) -> tuple[float | None, float]:
        seen = self.readings[:, channels]
        return noise_over_time(seen), freedom_over_time(seen)

    def watched(self, noise: np.ndarray) -> list[Watched]:
        return [self.in_time(f"channel {'xy'[c]}", self.readings[:, c], float(noise[c])) for c in self.channels]

    def in_time(self, name: str, values: np.ndarray, noise: float = 0.0) -> Watched:
        """A column of the record to be watched for wrong digits."""
        return Watched(name, values, noise, np.arange(self.rows, dtype=float), (slice(None),))

    def known(self, declared: Declared) -> tuple[Known, ...]:
        time = Known("time", self.time, "s", set=False)
        if self.temperature is None or self.bias_voltage is None:
            return (time,)
        return time, Known("temperature", self.temperature, "K"), Known("bias voltage", self.bias_voltage, "V")

    def warnings(self, declared: Declared) -> list[str]:
        return scattered(self.file, self.thermometer)

    # ---- surroundings

    def surrounded(self, at: Callable[[np.ndarray], Any]) -> dict[str, Any]:
        """Temperature and bias voltage, by name, as `at` makes them of those of the rows; nothing where the record does
        not tell them.
        """
        told = {"temperature": self.temperature, "bias_voltage": self.bias_voltage}
        return {name: at(values) for name, values in told.items() if values is not None}

    def away(self, around: Environment) -> np.ndarray:
        """(n,) how far the surroundings of each row are from those declared, if it tells them."""
        still = np.zeros(self.rows)
        if self.temperature is None or self.bias_voltage is None:
            return still
        return away_from(around, self.temperature, self.bias_voltage, still)

    @property
    def told_columns(self) -> dict[str, np.ndarray]:
        """What the record tells of its surroundings, as columns of a file."""
        names = {"temperature": "T [K]", "bias_voltage": "V_bias [V]"}
        return {names[name]: values for name, values in self.surrounded(np.asarray).items()}

    def overlay(self, base: Deviation, final: Deviation) -> Overlay:
        """The residual of every channel over time."""
        what = "lock-in phasors" if np.iscomplexobj(self.readings) else "waveforms"
        views = tuple(View(c, "time [s]", self.time, slice(None)) for c in self.channels)
        return Overlay(f"residual of its {what} over time", views)


@dataclass(frozen=True, eq=False, kw_only=True)
class WaveformRecord(ClockedRecord):
    """Raw signals, sample by sample.

    Args:
        signals: (n, channels) in the record unit.
    """

    signals: np.ndarray
    reference_frequency: ClassVar[float | None] = None  # of phasors; `None` for waveforms
    uneven: ClassVar[bool] = False

    @property
    def readings(self) -> np.ndarray:
        return self.signals

    def warnings(self, declared: Declared) -> list[str]:
        told = [*super().warnings(declared), *lines_told(self, declared)]
        if np.iscomplexobj(self.signals):
            return told
        unit = "" if declared.readout.unit == "1" else f" {declared.readout.unit}"
        ends = (clipped(self.file, f"channel {'xy'[c]}", self.signals[:, c], unit) for c in self.channels)
        return [*told, *chain.from_iterable(ends)]

    @property
    def offset(self) -> np.ndarray | None:
        late = self.signals[self.rows // 2 :]  # where what a large motion rectifies has decayed most
        # A plain mean holds a part of the vibration, of which there are no whole number of periods.
        return np.average(late, axis=0, weights=np.hanning(len(late) + 2)[1:-1])

    def columns(self, declared: Declared) -> dict[str, np.ndarray]:
        signals = signal_columns(self.signals, declared, self.channels)
        return {"t [s]": self.time, **self.told_columns, **signals}

    def track(self, declared: Declared, channel: int, rows: int = 0) -> Track:
        """Amplitude, frequency and decay rate of the strongest vibration of a channel, over windows of some rows."""
        low, high = declared.resonances
        asked = (REACH[0] * low, REACH[1] * high), channel, rows
        if asked not in self._tracks:
            band, reference = asked[0], self.reference_frequency or 0.0
            self._tracks[asked] = tracked(self.time, self.signals[:, channel], band, reference=reference, rows=rows)
        return self._tracks[asked]

    @cached_property
    def _tracks(self) -> dict[tuple, Track]:
        """What has been tracked, by what was asked: each is asked for again and again, and takes its time."""
        return {}

    def interference(self, declared: Declared) -> tuple[StandingLine, ...]:
        """Lines that stand in it; stamps that are not even hide them."""
        asked = declared.resonances, declared.readout.order
        if asked not in self._standing:
            self._standing[asked] = () if self.uneven else self.standing_lines(declared)
        return self._standing[asked]

    @cached_property
    def _standing(self) -> dict[tuple, tuple[StandingLine, ...]]:
        """The lines that were found, by what was asked."""
        return {}

    def standing_lines(self, declared: Declared) -> tuple[StandingLine, ...]:
        """Lines in even rows of what is left alone, beside the vibrations that die out."""
        usual = [self.track(declared, channel).usual for channel in self.channels]
        beside = np.array([omega for omega, _ in usual]) - (self.reference_frequency or 0.0)
        return standing_lines(self.time, self.signals, beside, min(decay for _, decay in usual))

    def series(self, deviation: Deviation) -> Series:
        motion, white = deviation.motion(self.period), deviation.white
        speed = np.gradient(motion, self.period, axis=0)
        modes = deviation.model.device.resonances() * self.period / (2 * np.pi)
        low, high = (1 - _AROUND) * modes[0], (1 + _AROUND) * modes[-1]
        names = ("x", "y") if len(deviation.channels) == 2 else ("",)
        variables = [Variable(f"displacement {n}".strip(), motion[:, i]) for i, n in enumerate(names)]
        variables += [Variable(f"velocity {n}".strip(), speed[:, i]) for i, n in enumerate(names)]
        bands = (Band("below resonance", 0.0, low), Band("at resonance", low, high), Band("above resonance", high, 0.5))
        return Series(
            self.name, deviation.channels, white, white, (slice(None),), segments(self.time), bands, tuple(variables)
        )

    def missing_force(self, deviation: Deviation) -> TimeForce | None:
        if len(self.channels) < self.readings.shape[1]:
            return None
        return force_over_time(self.name, deviation, self.time, self.noise_levels)


def lines_told(record: AbstractRecord, declared: Declared) -> list[str]:
    """A sentence for each line that stands in a record."""
    reference, unit = getattr(record, "reference_frequency", None), declared.readout.unit
    stands = "stands in the whole record, beside what the device does: interference"
    return [f"{record.file}: {line.said(reference, unit)} {stands}." for line in record.interference(declared)]


def surroundings_told(columns: Columns, around: Environment) -> dict[str, Any]:
    """What columns tell of the surroundings of a record, by the name of its fields; nothing where there are none."""
    if not any(columns.has(name) for name in CONDITIONS):
        return {}
    temperature = columns.optional("T", "K", around.temperature)
    temperature, scatter = steadied(temperature, (slice(0, len(temperature)),))
    bias = columns.optional("V_bias", "V", around.bias_voltage)
    return {"temperature": temperature, "bias_voltage": bias, "thermometer": scatter}
