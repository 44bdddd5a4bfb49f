"""How good the records of a case are: noise, peak over noise, outliers, and whether the device had settled."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import singledispatch

import numpy as np

from memsgyro_jax.base.text import aligned

from .outliers import interpolation_misfit, lone_rows
from .records import (
    AbstractRecord,
    Case,
    DesignValue,
    FrequencySweepRecord,
    RateTableRecord,
    RingDownRecord,
    TimeRecord,
)


_BANDS = 32  # of the spectrum: white noise is told by its quiet ones
_NORMAL = 1.4826  # median absolute value to standard deviation, of a normal variable
_RAYLEIGH = 1.1774  # median of the modulus of a complex normal variable over the standard deviation of each part
_EXCHANGED = 3.0  # times the driven channel: more than a coupling within a design's tolerances makes
_DISAGREE = 2.0  # factor between declared and estimated noise that is worth a sentence


@dataclass(frozen=True)
class RecordQuality:
    """What the rows of one record tell of its quality.

    Args:
        record: the record.
        noise: estimated standard deviation of each real reading, in the record unit.
        peak: largest reading.
        warnings: one sentence each, with file and line where there is one.
    """

    record: AbstractRecord
    noise: float
    peak: float
    warnings: tuple[str, ...]

    @property
    def ratio(self) -> float:
        """Peak over noise, the declared one where there is one; infinite without noise."""
        noise = self.record.noise_std or self.noise
        return self.peak / noise if noise > 0 else np.inf


@dataclass(frozen=True)
class CaseQuality:
    """The quality of all records; printed as a table with the warnings below it."""

    case: Case
    records: tuple[RecordQuality, ...]

    @property
    def warnings(self) -> tuple[str, ...]:
        """Those of all records."""
        return tuple(warning for quality in self.records for warning in quality.warnings)

    def __str__(self) -> str:
        unit = "" if self.case.readout.unit == "1" else f" {self.case.readout.unit}"
        head = ("experiment", "peak", "noise", "declared", "peak/noise", "warnings")
        rows = [
            (
                q.record.name,
                f"{q.peak:.3g}{unit}",
                f"{q.noise:.2g}{unit}",
                f"{q.record.noise_std:.2g}{unit}" if q.record.noise_std else "-",
                f"{q.ratio:.0f}",
                str(len(q.warnings)),
            )
            for q in self.records
        ]
        return "\n".join([aligned([head, *rows]), *(f"Warning: {warning}" for warning in self.warnings)])


def assess(case: Case) -> CaseQuality:
    """The quality of each record of a case."""
    return CaseQuality(case, tuple(_assess(record, case) for record in case.records))


def _assess(record: AbstractRecord, case: Case) -> RecordQuality:
    noise = estimated_noise(record)
    declared = record.noise_std
    warnings = [
        *_lone(record, noise if declared is None else declared, case),
        *_settling(record, _decay(case.design)),
        *_exchanged(record),
    ]
    if declared is not None and noise > 0 and not 1 / _DISAGREE < noise / declared < _DISAGREE:
        warnings.append(
            f"{record.file}: the declared noise of {declared:.2g} {case.readout.unit} is not that of the rows, about "
            f"{noise:.2g} {case.readout.unit}; estimates and their uncertainty follow the declared one."
        )
    return RecordQuality(record, noise, float(np.max(np.abs(record.readings))), tuple(warnings))


@singledispatch
def estimated_noise(record: AbstractRecord) -> float:
    """Standard deviation of the white noise of each real reading, told by the rows alone.

    Signals only add to what the quiet part of the spectrum and the misfit of neighbours show: the lesser is believed.
    """
    misfit = interpolation_misfit(np.arange(record.rows, dtype=float), record.readings)[2:-2]
    near = np.median(np.abs(misfit), axis=0) if len(misfit) else np.full(record.readings.shape[1], np.inf)
    near = near / _RAYLEIGH if np.iscomplexobj(misfit) else near * _NORMAL
    quiet = [_quiet_level(channel) for channel in record.readings.T]
    return float(np.median(np.minimum(near, quiet)))


@estimated_noise.register
def _(record: FrequencySweepRecord) -> float:
    misfits = [
        interpolation_misfit(record.frequency[rows], record.phasors[rows])[2:-2]
        for rows in record.sweeps
        if rows.stop - rows.start >= 7
    ]
    if not misfits:
        return 0.0
    # A resonance bends some rows away from their neighbours: noise is what the lesser half of all rows shows.
    return float(np.min(np.median(np.abs(np.concatenate(misfits)), axis=0))) / _RAYLEIGH


def _quiet_level(channel: np.ndarray) -> float:
    """White noise below a signal that leaves part of the spectrum free: the level of the quiet bands."""
    rows = len(channel)
    window = np.hanning(rows + 2)[1:-1]
    values = (channel - channel.mean()) * window
    spectrum = np.fft.fft(values) if np.iscomplexobj(channel) else np.fft.rfft(values)
    power = np.abs(spectrum) ** 2 / np.sum(window**2)
    count = max(1, min(_BANDS, len(power) // 16))
    levels = [np.median(band) / np.log(2) for band in np.array_split(power, count)]
    quiet = float(np.sqrt(np.quantile(levels, 0.2)))
    return quiet / np.sqrt(2) if np.iscomplexobj(channel) else quiet


def _lone(record: AbstractRecord, noise: float, case: Case) -> list[str]:
    """A sentence for each row that stands alone among its neighbours."""
    pieces = record.sweeps if isinstance(record, FrequencySweepRecord) else (slice(0, record.rows),)
    place = record.frequency if isinstance(record, FrequencySweepRecord) else np.arange(record.rows, dtype=float)
    sentences = []
    for name, values, floor in _judged(record, noise):
        for piece in pieces:
            for row, sigmas in lone_rows(place[piece], values[piece], floor):
                sentences.append(
                    f"{record.file}, line {record.lines[piece][row]}: {name} lies {_far(sigmas)} off "
                    "its neighbours; is a digit wrong?"
                )
    return sentences


def _far(sigmas: float) -> str:
    return f"{sigmas:.0f} standard deviations" if np.isfinite(sigmas) else "far"


def _judged(record: AbstractRecord, noise: float) -> list[tuple[str, np.ndarray, float]]:
    """Name, values and standard deviation of noise of what is looked at for outliers."""
    names = [f"channel {'xy'[c]}" for c in range(record.readings.shape[1])]
    judged = [(name, column, noise) for name, column in zip(names, record.readings.T, strict=True)]
    if isinstance(record, TimeRecord):
        judged += [(f"the input {'xy'[a]}", column, 0.0) for a, column in enumerate(record.forces.T)]
    if isinstance(record, RateTableRecord | TimeRecord):
        judged.append(("the rate", record.rate, 0.0))
    return judged


def _decay(design: Mapping[str, DesignValue]) -> float:
    """Longest time constant of the amplitude [s] that the design allows."""
    if "quality_factor" in design:
        return 2 * design["quality_factor"].high / design["resonance"].low
    return 2 * design["mass"].high / min(design["dxx"].low, design["dyy"].low)


def _exchanged(record: AbstractRecord) -> list[str]:
    """A sentence where the electrode at rest moves much more than the driven one."""
    if not isinstance(record, FrequencySweepRecord | RingDownRecord) or record.readings.shape[1] < 2:
        return []
    peaks = np.max(np.abs(record.readings - record.readings.mean(axis=0)), axis=0)
    driven, other = peaks[record.axis], peaks[1 - record.axis]
    if other <= _EXCHANGED * driven:
        return []
    sentence = (
        f"{record.file}: axis {'xy'[record.axis]} is driven, but the other reads {other / driven:.0f} times as much; "
        "are the channels and `drive_axis` as labelled?"
    )
    return [sentence]


@singledispatch
def _settling(record: AbstractRecord, decay: float) -> list[str]:
    """Sentences on whether the record waits for, or shows, the decay of the device [s]."""
    return []


@_settling.register
def _(record: FrequencySweepRecord, decay: float) -> list[str]:
    if record.time is None or not record.settled:
        return []
    dwell = float(np.median(np.diff(record.time)))
    if dwell >= 5 * decay:
        return []
    sentence = (
        f"{record.file}: rows are declared settled, but follow each other after {dwell:.3g} s, less than 5 time "
        f"constants of up to {decay:.3g} s."
    )
    return [sentence]


@_settling.register
def _(record: RingDownRecord, decay: float) -> list[str]:
    sentences = []
    if record.drive_duration < 5 * decay:
        sentences.append(
            f"{record.file}: the drive of {record.drive_duration:.3g} s lasts less than 5 time constants of up to "
            f"{decay:.3g} s, so the decay starts from a transient."
        )
    if record.period * record.rows < decay:
        sentences.append(
            f"{record.file}: the record of {record.period * record.rows:.3g} s is shorter than the time constant of up "
            f"to {decay:.3g} s, so that the damping shows little."
        )
    return sentences
