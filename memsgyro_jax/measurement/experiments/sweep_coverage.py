"""What single frequency sweeps do not show of their resonance, for warnings."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from memsgyro_jax.base.text import spoken


_FALL = 0.3  # of the largest reading: a change from row to row that may be a fall from branch to branch
_SUDDEN = 3.0  # times the changes beside it
_ALONE, _AROUND = 1.5, 8  # times each other change within so many rows: readings that are held change again
_CHANGED = np.log(1.5)  # a factor from row to row that may be a gain that was changed
_TURNS = np.radians(20.0)  # from row to row beside a resonance; a fall turns by several times that
_ALIKE = 0.02  # of a drive: within it sweeps have the same
_WEAK = 5.0  # standard deviations that the highest of some tens of rows of mere noise stays within
_SETTLED = 5.0  # time constants between rows


def place_in_band(hertz: np.ndarray, row: int) -> str:
    """The frequency of a row with as many digits as tell it from the next."""
    step = float(np.median(np.abs(np.diff(hertz)))) or hertz[row]
    return spoken(hertz[row], "Hz", max(4, int(np.ceil(np.log10(hertz[row] / step))) + 1))


@dataclass(frozen=True)
class Way:
    """A sweep that was taken: at which level of the drive, up or down, and over which band [Hz]."""

    level: float
    rising: bool
    band: tuple[float, float]

    def passes(self, level: float, rising: bool, place: float) -> bool:
        """Whether it goes that way over a frequency, at a level of the drive."""
        return (
            abs(self.level - level) <= _ALIKE * abs(level)
            and self.rising == rising
            and self.band[0] <= place <= self.band[1]
        )


def ways_swept(hertz: np.ndarray, setting: np.ndarray, sweeps: Sequence[slice]) -> list[Way]:
    """The sweeps of a record."""
    return [
        Way(float(setting[rows][0]), bool(hertz[rows][-1] > hertz[rows][0]), (hertz[rows].min(), hertz[rows].max()))
        for rows in sweeps
    ]


def swept_elsewhere(record: Any, declared: Any) -> list[Way]:
    """The sweeps along the same axis in all records of its kind, where what is `declared` is a whole case."""
    same = [r for r in getattr(declared, "records", ()) if isinstance(r, type(record)) and r.axis == record.axis]
    return [way for r in same for way in ways_swept(r.frequency / (2 * np.pi), r.setting, r.sweeps)]


def peaks_not_seen(
    file: str,
    hertz: np.ndarray,
    read: np.ndarray,
    setting: np.ndarray,
    sweeps: Sequence[slice],
    elsewhere: Sequence[Way] = (),
) -> list[str]:
    """A sentence for each sweep that ends before its peak, for each whose gain changes on the way, and for each that
    falls from branch to branch and is not taken in both directions, neither in this record nor `elsewhere` in the case.

    Args:
        file: to be named.
        hertz: (n,) frequencies.
        read: (n,) or (n, channels) phasors, or amplitudes alone where these are real.
        setting: (n,) of the drive.
        sweeps, elsewhere: single sweeps of this record, and those of others.
    """
    said, channels = [], np.reshape(read, (len(hertz), -1))
    size = np.max(np.abs(channels), axis=1)
    ways = [*ways_swept(hertz, setting, sweeps), *elsewhere]
    for rows in sweeps:
        values, places = size[rows], hertz[rows]
        rising, end = places[-1] > places[0], int(np.argmax(values))
        if end in (0, len(values) - 1) and np.all(np.isfinite(values)):
            higher = places[end] == places.max()
            beyond = "higher" if higher else "lower"
            said.append(
                f"{file}: the largest reading of a sweep is at the end of its band, {place_in_band(places, end)}: a "
                f"sweep on to {beyond} frequencies shows its peak."
            )
        elif (row := sudden_fall(values)) is not None and _at_one_phase(channels[rows], row):
            factor, where = values[row + 1] / values[row], place_in_band(places, row)
            said.append(
                f"{file}: near {where} the reading becomes {factor:.3g} times as large from row to row, at one "
                "phase, as when a range or a gain is changed: split the file there, or put its readings right."
            )
        elif row is not None and not any(way.passes(setting[rows][0], not rising, places[row]) for way in ways):
            back = "down" if rising else "up"
            said.append(
                f"{file}: the reading changes at once near {place_in_band(places, row)}, as a bent resonance does from "
                f"branch to branch; that is no fault of it, and a sweep {back} would show the other branch as well."
            )
    return said


def sudden_fall(size: np.ndarray) -> int | None:
    """The row after which readings (n,) of a sweep change at once: by a third of the largest, by several times the
    changes beside it, and by more than any other near; `None` where none does.
    """
    steps = np.abs(np.diff(size))
    beside = np.maximum(steps[:-2], steps[2:])
    falls = np.flatnonzero((steps[1:-1] > _FALL * np.nanmax(size)) & (steps[1:-1] > _SUDDEN * beside))
    for row in falls + 1:
        others = np.concatenate([steps[max(row - _AROUND, 0) : row], steps[row + 1 : row + 1 + _AROUND]])
        if steps[row] > _ALONE * np.nanmax(others):
            return int(row)
    return None


def at_one_gain(response: np.ndarray) -> np.ndarray:
    """Phasors (n,) in the order of a sweep as they would be had no gain changed on the way: those behind each change by
    a factor that turns none, and is far larger than the changes beside it, as before it.
    """
    steps = np.diff(np.log(np.maximum(np.abs(response), 1e-300)))
    beside = np.maximum(
        np.abs(np.concatenate([steps[:1], steps[:-1]])), np.abs(np.concatenate([steps[1:], steps[-1:]]))
    )
    changes = (np.abs(steps) > _CHANGED) & (np.abs(steps) > _SUDDEN * beside)
    changes &= np.abs(np.angle(response[1:] * np.conj(response[:-1]))) < _TURNS
    return response * np.exp(-np.concatenate([[0.0], np.cumsum(np.where(changes, steps, 0.0))]))


def _at_one_phase(channels: np.ndarray, row: int) -> bool:
    """Whether a change behind a row turns no phasor, as a fall from branch to branch does; amplitudes do not tell."""
    if not np.iscomplexobj(channels):
        return False
    largest = int(np.argmax(np.abs(channels[row])))
    return bool(abs(np.angle(channels[row + 1, largest] * np.conj(channels[row, largest]))) < _TURNS)


def weak_sweeps(file: str, lines: Sequence[np.ndarray], peaks: Sequence[float]) -> list[str]:
    """A sentence on each sweep, of the lines of its file, whose largest reading over noise shows little else."""
    weak = [rows for rows, peak in zip(lines, peaks, strict=True) if peak < _WEAK]
    return [
        f"{file}, lines {rows[0]} to {rows[-1]}: the sweep hardly rises above its noise, so that it tells little; it "
        "is used."
        for rows in weak
    ]


def hasty(file: str, time: np.ndarray | None, decay: float) -> list[str]:
    """A sentence where rows that are declared settled, if times are given, follow each other sooner than a device comes
    to rest.
    """
    if time is None:
        return []
    dwell, needed = float(np.median(np.diff(time))), _SETTLED * decay
    said = (
        f"{file}: rows are declared settled, but follow each other after {dwell:.3g} s, less than the {needed:.3g} s "
        f"that are {_SETTLED:g} time constants of the most damped device within the design."
    )
    return [said] if dwell < needed else []
