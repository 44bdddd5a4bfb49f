"""Fewer rows of a record that is longer than it needs to be: phasors over time by means, waveforms behind a low pass,
other rows as they are.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy import ndimage, signal

from memsgyro_jax.base.errors import InputError

from .clock import is_even
from .column_meaning import Meaning
from .formats import SourceColumn, SourceTable
from .noise import RAYLEIGH, noise_over_time
from .outliers import interpolation_misfit


FEWEST = 5  # rows that a period of the vibration must keep
PLENTY = 2000  # rows of phasors over time that are kept, where nothing is said
BEND = 0.1  # of the noise of a mean: so far it may lie off for the curve that its rows run along
ALONE = 6.0  # standard deviations from which a row is left out of its mean
SELDOM, HALF = 0.05, 0.5  # of all rows, more of which do not stand alone; of a mean, which must keep it


def thinned(
    table: SourceTable, meaning: Meaning, rows: Mapping[str, SourceColumn], every: int | None, assumed: list[str]
) -> dict[str, SourceColumn]:
    """One row of `every` [1 or more]: columns of waveforms go through a low pass without delay before, those of phasors
    over time are means. `None` takes of a long ringing by phasors as few as tell all that its rows do, and else all.

    Raises `InputError` where rows between are needed: of a sweep with a clock, of stamps that are not even, and of a
    vibration that would keep fewer than five rows in a period.
    """
    rings = not meaning.swept and {"t", "I", "Q"} <= {*rows} and not {"signal", "rate", "drive"} & {*rows}
    rings = rings and is_even(rows["t"].values)
    if every is None:
        every = _as_many_as_need_be(rows) if rings else 1
    if rings and every > 1:
        return _means(rows, every, assumed)
    if every == 1:
        return dict(rows)
    waveform = not meaning.swept and "signal" in rows
    if meaning.swept and "t" in rows:
        _refuse(table, "a sweep with a clock, whose rows begin where the row before ended; leave `t` out by --map")
    if waveform:
        _check(table, rows, every)
        assumed.append(f"one row of {every} is kept, behind a low pass")
    else:
        assumed.append(f"one row of {every} is kept")
    return {role: replace(column, values=_fewer(column.values, every, waveform and role != "t"))
            for role, column in rows.items()}  # fmt: skip


def _fewer(values: np.ndarray, every: int, smooth: bool) -> np.ndarray:
    if not smooth:
        return values[::every]
    return signal.decimate(np.asarray(values, float), every, ftype="fir", zero_phase=True)


def _check(table: SourceTable, rows: Mapping[str, SourceColumn], every: int) -> None:
    """That stamps are even, and that the strongest line of the signal keeps rows enough in a period."""
    if "t" in rows and not is_even(rows["t"].values):
        _refuse(table, "stamps that jitter or rows that are lost")
    values = np.asarray(rows["signal"].values, float)
    lines = np.abs(np.fft.rfft((values - np.mean(values)) * np.hanning(len(values))))
    period = len(values) / max(int(np.argmax(lines)), 1)
    if period < FEWEST * every:
        most = int(period / FEWEST)
        remedy = f"at most --every {most} leaves {FEWEST}" if most > 1 else f"it has {period:.3g} rows in a period now"
        _refuse(table, f"a vibration that keeps fewer than {FEWEST} rows in a period ({remedy})")


def _refuse(table: SourceTable, what: str) -> None:
    raise InputError(f"{table.path}: `--every` must not thin {what}.")


_PARTS = (("I", "Q"), ("y_I", "y_Q"))


def _phasors(rows: Mapping[str, SourceColumn]) -> list[tuple[tuple[str, str], np.ndarray, float]]:
    """Roles of each channel's parts, its phasors (n,) turned back to near rest, and by which angle a row turns."""
    out = []
    for pair in _PARTS:
        if {*pair} <= {*rows}:
            seen = np.asarray(rows[pair[0]].values, float) + 1j * np.asarray(rows[pair[1]].values, float)
            turn = float(np.angle(np.sum(seen[1:] * seen[:-1].conj())))
            out.append((pair, seen * np.exp(-1j * turn * np.arange(len(seen))), turn))
    return out


def _as_many_as_need_be(rows: Mapping[str, SourceColumn]) -> int:
    """How many rows may become one mean: it lies off by a part of its noise at most, and enough of them are left."""
    count = len(rows["t"].values)
    most = count // PLENTY
    if most < 2:
        return 1
    window = count // 20 | 1
    for _, still, _ in _phasors(rows):
        noise = noise_over_time(still[:, None])
        parts = (signal.savgol_filter(part, window, 4, deriv=2) for part in (still.real, still.imag))
        bend = max(float(np.max(np.abs(part))) for part in parts)  # of the curve, row by row
        most = min(most, int((24.0 * BEND * noise / max(bend, 1e-300)) ** 0.4))
    return max(most, 1)


def _means(rows: Mapping[str, SourceColumn], every: int, assumed: list[str]) -> dict[str, SourceColumn]:
    """Means of `every` rows, of phasors as they stand beside their usual turn, without rows that stand alone."""
    count, lost = len(rows["t"].values) // every, 0

    def cut(values: np.ndarray) -> np.ndarray:
        return np.asarray(values)[: count * every].reshape(count, every)

    middle = every * np.arange(count) + (every - 1) / 2
    out = {role: replace(c, values=cut(np.asarray(c.values, float)).mean(axis=1)) for role, c in rows.items()}
    for pair, still, turn in _phasors(rows):
        block, kept = cut(still), cut(_in_line(still))
        kept |= kept.mean(axis=1, keepdims=True) < HALF
        lost += int((~kept).sum())
        mean = np.sum(block * kept, axis=1) / np.sum(kept, axis=1) * np.exp(1j * turn * middle)
        out |= {role: replace(rows[role], values=part) for role, part in zip(pair, (mean.real, mean.imag), strict=True)}
    told = f", of which {lost} readings that stand alone are left out" if lost else ""
    assumed.append(f"each row is the mean of {every}{told} (`--every 1` keeps all)")
    return out


def _in_line(still: np.ndarray) -> np.ndarray:
    """Which of some phasors (n,) are what their neighbours on both sides lead to, as nearly all must be."""
    off = np.abs(interpolation_misfit(np.arange(len(still), dtype=float), still[:, None])[:, 0])
    usual = np.median(off) / RAYLEIGH
    nearby = ndimage.maximum_filter1d(off, 5)  # one that stands alone leads its neighbours astray too
    lone = (off > ALONE * usual) & (off >= nearby)
    return ~lone | (lone.mean() > SELDOM)
