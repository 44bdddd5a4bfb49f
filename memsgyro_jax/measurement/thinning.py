"""Fewer rows of a record that is longer than it needs to be: waveforms behind a low pass, other rows as they are."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy import signal

from memsgyro_jax.base.errors import InputError

from .clock import is_even
from .column_meaning import Meaning
from .formats import SourceColumn, SourceTable


FEWEST = 5  # rows that a period of the vibration must keep


def thinned(
    table: SourceTable, meaning: Meaning, rows: Mapping[str, SourceColumn], every: int, assumed: list[str]
) -> dict[str, SourceColumn]:
    """One row of `every` [1 or more]; columns of waveforms go through a low pass without delay before.

    Raises `InputError` where rows between are needed: of a sweep with a clock, of stamps that are not even, and of a
    vibration that would keep fewer than five rows in a period.
    """
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
