"""What a measurement case holds, as immutable objects in SI."""

import abc
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import aligned


Role = Literal["fit", "validation"]
_TWO_PI = 2 * np.pi


@dataclass(frozen=True)
class DesignValue:
    """A design parameter: what the maker meant, and the interval in which the die may lie, in SI."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Readout:
    """The declared read-out: record = scale · displacement + an unknown offset.

    Args:
        scale: record unit per unit of displacement, V/m (single mass) or V/V (resonator).
        adc_range: the converter's largest reading, ± this much in the record unit; `None` where it is not declared.
        unit: of the records, "V" or "1" (digital units).
    """

    scale: float
    adc_range: float | None = None
    unit: str = "V"


@dataclass(frozen=True)
class Environment:
    """Where records do not say otherwise: temperature [K] and electrode bias [V]."""

    temperature: float = 298.15
    bias_voltage: float = 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class AbstractRecord(abc.ABC):
    """One experiment.

    Args:
        name: unique within the case.
        file: CSV file below the folder of the case.
        lines: (n,) line of each row in that file, from 1.
        role: "validation" is never fitted; `None` where the case does not say.
        note: free text.
        noise_std: of each real reading (each of I and Q for phasors), in the record unit; `None` asks to estimate it.
    """

    kind: ClassVar[str]
    name: str
    file: str
    lines: np.ndarray
    role: Role | None = None
    note: str = ""
    noise_std: float | None = None

    @property
    def rows(self) -> int:
        """How many rows the record has."""
        return len(self.lines)

    @property
    @abc.abstractmethod
    def readings(self) -> np.ndarray:
        """(n, channels) what was read, real or complex, in the record unit."""

    @property
    @abc.abstractmethod
    def extent(self) -> str:
        """What the record spans, for people."""

    def __str__(self) -> str:
        return f"{self.name}: {self.kind}, {self.rows} rows, {self.extent}"


@dataclass(frozen=True, eq=False, kw_only=True)
class FrequencySweepRecord(AbstractRecord):
    """Lock-in phasors over drive frequency: V(t) = Re[(I + iQ) e^{iωt}] for a drive F cos(ωt).

    Args:
        axis: driven electrode, 0 = x, 1 = y.
        settled: whether each row was recorded after the transient had died away.
        frequency: (n,) angular frequency [rad/s].
        drive: (n,) amplitude of the force [N], of the input [V] for a resonator.
        temperature: (n,) [K].
        bias_voltage: (n,) of the electrodes [V].
        rate: (n,) angular rate [rad/s], zero where the record does not say.
        phasors: (n, channels) complex, in the record unit.
        time: (n,) when each row was recorded [s], or `None`.
    """

    kind: ClassVar[str] = "frequency_sweep"
    axis: int
    settled: bool
    frequency: np.ndarray
    drive: np.ndarray
    temperature: np.ndarray
    bias_voltage: np.ndarray
    rate: np.ndarray
    phasors: np.ndarray
    time: np.ndarray | None = None

    @property
    def readings(self) -> np.ndarray:
        return self.phasors

    @property
    def sweeps(self) -> tuple[slice, ...]:
        """The rows of each single sweep: a new one begins where a condition is set anew or the frequency turns back.

        Temperature and rate may be readings: within 1 K and 1 % of the largest rate they count as one setting.
        """
        settings = (
            (self.drive, 0.0),
            (self.bias_voltage, 0.0),
            (self.temperature, 1.0),
            (self.rate, 0.01 * float(np.max(np.abs(self.rate), initial=0.0))),
        )
        new = np.zeros(self.rows, bool)
        for values, within in settings:
            new |= _settings_begin(values, within)
        steps = np.sign(np.diff(self.frequency))
        begins, direction = [0], 0.0
        for row in range(1, self.rows):
            if new[row] or (direction and steps[row - 1] != direction):
                begins.append(row)
                direction = 0.0
            else:
                direction = steps[row - 1]
        return tuple(slice(a, b) for a, b in zip(begins, [*begins[1:], self.rows], strict=True))

    @property
    def extent(self) -> str:
        low, high = self.frequency.min() / _TWO_PI, self.frequency.max() / _TWO_PI
        return f"{len(self.sweeps)} sweeps of {'xy'[self.axis]}, {low:.6g} to {high:.6g} Hz"


def _settings_begin(values: np.ndarray, within: float) -> np.ndarray:
    """Where `values` leave the value of the current setting by more than `within`."""
    begins, held = np.zeros(len(values), bool), values[0]
    for row in np.flatnonzero(np.diff(values) != 0) + 1:
        if abs(values[row] - held) > within:
            begins[row], held = True, values[row]
    return begins


class _Clocked(AbstractRecord):
    """A record whose rows follow each other in time at one period."""

    time: np.ndarray

    @property
    def period(self) -> float:
        """Mean time from row to row [s]."""
        return float(self.time[-1] - self.time[0]) / (self.rows - 1)

    @property
    def _span(self) -> str:
        return f"{self.period * self.rows:.4g} s at {1 / self.period:.6g} Hz"


@dataclass(frozen=True, eq=False, kw_only=True)
class RingDownRecord(_Clocked):
    """Free decay: from rest the axis is driven with F cos(ωt) for the whole number of cycles nearest below
    `drive_duration`; the force is removed at t = 0.

    Args:
        axis: driven electrode, 0 = x, 1 = y.
        drive_force: amplitude [N], of the input [V] for a resonator.
        drive_frequency: [rad/s].
        drive_duration: [s].
        time: (n,) uniform [s].
        signals: (n, channels) in the record unit.
    """

    kind: ClassVar[str] = "ring_down"
    axis: int
    drive_force: float
    drive_frequency: float
    drive_duration: float
    time: np.ndarray
    signals: np.ndarray

    @property
    def readings(self) -> np.ndarray:
        return self.signals

    @property
    def extent(self) -> str:
        return f"{self._span} after driving {'xy'[self.axis]} at {self.drive_frequency / _TWO_PI:.6g} Hz"


@dataclass(frozen=True, eq=False, kw_only=True)
class RateTableRecord(_Clocked):
    """Lock-in phasors over time on a rate table, open loop, settled before t = 0.

    Args:
        axis: driven electrode, 0 = x, 1 = y.
        drive_force: amplitude [N], of the input [V] for a resonator.
        drive_frequency: [rad/s].
        lock_in_cycles: drive cycles over which each row averages; rows follow each other without a gap.
        rate_calibrated: the rate comes from a calibrated reference, not from the setting of the table.
        has_rate: the file has a rate column; without it the table stands still.
        time: (n,) middle of each block [s].
        rate: (n,) angular rate [rad/s], zeros without the column.
        phasors: (n, channels) complex, in the record unit.
    """

    kind: ClassVar[str] = "rate_table"
    axis: int
    drive_force: float
    drive_frequency: float
    lock_in_cycles: int
    rate_calibrated: bool
    has_rate: bool
    time: np.ndarray
    rate: np.ndarray
    phasors: np.ndarray

    @property
    def readings(self) -> np.ndarray:
        return self.phasors

    @property
    def extent(self) -> str:
        return f"{self._span}, rate up to {np.degrees(np.max(np.abs(self.rate))):.4g} deg/s"


@dataclass(frozen=True, eq=False, kw_only=True)
class TimeRecord(_Clocked):
    """Raw signals under known forces.

    Args:
        hold: how the force runs between rows: "zero_order", "linear" or "band_limited".
        start: "rest" or "unknown" motion at the first row.
        time: (n,) uniform [s].
        forces: (n, axes) [N], the input [V] for a resonator.
        signals: (n, channels) in the record unit.
        rate: (n,) angular rate [rad/s], zeros where the record does not say.
    """

    kind: ClassVar[str] = "time_record"
    hold: Literal["zero_order", "linear", "band_limited"]
    start: Literal["rest", "unknown"]
    time: np.ndarray
    forces: np.ndarray
    signals: np.ndarray
    rate: np.ndarray

    @property
    def readings(self) -> np.ndarray:
        return self.signals

    @property
    def extent(self) -> str:
        return f"{self._span}, {self.hold} input, start {self.start}"


@dataclass(frozen=True, eq=False)
class Case:
    """Everything a laboratory recorded of one device.

    Args:
        folder: where the case was read from.
        name: of the case.
        description: free text.
        device: "single_mass" (two axes) or "resonator" (one).
        design: single mass: mass [kg], kxx, kyy, kxy [N/m], dxx, dyy, dxy [N s/m]; resonator: resonance [rad/s],
            quality_factor [1], static_gain [record unit per input unit].
        readout: what is declared about the read-out.
        environment: what holds where a record does not say otherwise.
        conventions: free text by topic.
        records: the experiments, in the order of the file.
    """

    folder: Path
    name: str
    description: str
    device: Literal["single_mass", "resonator"]
    design: Mapping[str, DesignValue]
    readout: Readout
    environment: Environment
    conventions: Mapping[str, str]
    records: tuple[AbstractRecord, ...]

    @property
    def channels(self) -> int:
        """Two for a single mass, one for a resonator."""
        return 2 if self.device == "single_mass" else 1

    def record(self, name: str) -> AbstractRecord:
        """The experiment of that name; raises `InputError` where there is none."""
        for record in self.records:
            if record.name == name:
                return record
        names = ", ".join(record.name for record in self.records)
        raise InputError(f"Argument `name` must be one of the experiments {names}, but is {name!r}.")

    def __str__(self) -> str:
        heading = f"{self.name}: {self.device}" + (f", {self.description}" if self.description else "")
        head = ("experiment", "kind", "role", "rows", "noise", "extent")
        rows = [
            (r.name, r.kind, r.role or "-", str(r.rows), _noise(r.noise_std, self.readout.unit), r.extent)
            for r in self.records
        ]
        return f"{heading}\n{aligned([head, *rows])}"


def _noise(std: float | None, unit: str) -> str:
    return "-" if std is None else f"{std:.3g} {unit}".removesuffix(" 1")
