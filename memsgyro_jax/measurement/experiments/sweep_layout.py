"""Rows of frequency sweeps laid together as experiments."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from memsgyro_jax.device.conditions import Conditions

from ..declared import Declared
from ..lock_in import RowsBefore
from .base import AmplitudeNoise, CartesianNoise, Readings
from .harmonic_sweep import HarmonicSweep


REMEMBERED = 24  # rows back that the filter of a lock-in may still show: four poles of two dwells each, to a thousandth


def halves(declared: Declared, records: Sequence[tuple[int, Any]]) -> list[Readings]:
    """What is fitted and what is not, of one shape."""
    if not records:
        return []
    record = np.concatenate([np.full(r.rows, number) for number, r in records])
    row = np.concatenate([np.arange(r.rows) for _, r in records])
    chosen = np.concatenate([np.arange(r.rows) % 2 == 0 if r.role is None else np.full(r.rows, r.role == "fit")
                             for _, r in records])  # fmt: skip
    groups = [np.flatnonzero(chosen), np.flatnonzero(~chosen)]
    size = max(map(len, groups))
    every = joined_rows(declared, records, np.arange(row.size), np.ones(row.size, bool))
    out = []
    for rows, fitted in zip(groups, (True, False), strict=True):
        if rows.size:
            padded = np.concatenate([rows, np.full(size - rows.size, rows[-1])])
            real = np.arange(size) < rows.size
            real &= ~np.concatenate([_begins_unknown(r) for _, r in records])[padded]
            experiment = joined_rows(declared, records, padded, real)
            if every.rows_before is not None:
                experiment = replace(experiment, rows_before=None, every=every, place=jnp.asarray(padded))
            out.append(Readings(experiment, np.where(real, record[padded], -1), row[padded], fitted))
    return out


def joined_rows(
    declared: Declared, records: Sequence[tuple[int, Any]], rows: np.ndarray, real: np.ndarray
) -> HarmonicSweep:
    """Rows of all records, in their order, as one experiment; those that are not `real` have no weight."""

    def joined(values) -> np.ndarray:
        return np.concatenate([np.asarray(values(number, r)) for number, r in records])[rows]

    measured = joined(lambda _, r: r.readings)
    count = sum(r.rows for _, r in records)
    follow = len(rows) == count and np.array_equal(rows, np.arange(count))
    clocked = any(r.time is not None and r.phase_known for _, r in records)
    noise = joined(lambda _, r: r.noise_of_rows)
    return HarmonicSweep(
        name="frequency sweeps",
        frequency=jnp.asarray(joined(lambda _, r: r.frequency)),
        force=jnp.asarray(joined(lambda _, r: np.outer(r.drive, np.eye(declared.channels)[r.axis])) + 0j),
        measured=jnp.asarray(measured),
        noise=(CartesianNoise if np.iscomplexobj(measured) else AmplitudeNoise)(np.where(real[:, None], noise, np.inf)),
        surroundings=Conditions(
            rate=joined(lambda _, r: r.rate),
            temperature=joined(lambda _, r: r.temperature),
            bias_voltage=joined(lambda _, r: r.bias_voltage),
            time=joined(lambda _, r: np.zeros(r.rows) if r.time is None else r.time),
            record=joined(lambda number, r: np.full(r.rows, float(number))),
            sweep=joined(lambda _, r: np.repeat(np.arange(len(r.sweeps)), [s.stop - s.start for s in r.sweeps])),
        ).rows(len(rows)),
        near=jnp.asarray(joined(lambda _, r: r.motion(declared))),
        direction=jnp.asarray(joined(lambda _, r: r.directions)),
        before=jnp.asarray(joined(lambda _, r: r.phasors[np.maximum(np.arange(r.rows) - 1, 0)])),
        dwell=jnp.asarray(joined(lambda _, r: _dwell(r))) if clocked else None,
        unsettled=jnp.asarray(joined(lambda _, r: np.full(r.rows, float(not r.settled))))
        if clocked and not all(r.settled for _, r in records)
        else None,
        rows_before=_rows_before([r for _, r in records]) if clocked and follow else None,
    )


def _rows_before(records: Sequence[Any]) -> RowsBefore:
    """Of each row of records one after the other; a record knows no row of another, and nothing without a clock."""
    rows, ages, first = [], [], 0
    for record in records:
        here = np.arange(record.rows)[:, None] - np.arange(1, REMEMBERED + 1)
        before = np.maximum(here, 0)
        known = (here >= 0) & (record.time is not None)
        since = np.zeros(here.shape) if record.time is None else record.time[:, None] - record.time[before]
        rows.append(first + before)
        ages.append(np.where(known, since, np.inf))
        first += record.rows
    return RowsBefore(jnp.asarray(np.concatenate(rows)), jnp.asarray(np.concatenate(ages)))


def _dwell(record: Any) -> np.ndarray:
    """(n,) time since the row before [s], infinite for the first and without a clock."""
    return np.full(record.rows, np.inf) if record.time is None else np.diff(record.time, prepend=-np.inf)


def _begins_unknown(record: Any) -> np.ndarray:
    """(n,) rows that begin in a motion that was not recorded, and have not settled since."""
    return (np.arange(record.rows) == 0) & (not record.settled and record.time is not None and record.phase_known)
