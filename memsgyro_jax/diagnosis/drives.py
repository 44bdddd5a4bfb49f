"""Rows of sweeps left out of what is fitted, and fits that follow a device from its lowest drive to its highest."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.measurement.case import AbstractRecord, Case
from memsgyro_jax.measurement.drive_levels import ALIKE, clear_drives
from memsgyro_jax.measurement.experiments import Readings
from memsgyro_jax.measurement.least_squares import gate

from .joint_residual import Joint
from .optimum import Optimum, optimise


FAR = 100.0  # χ² per degree of freedom from which a fit to all drives may have missed its valley
FALL = 0.3  # of the largest reading: a change across one row that may be a fall from branch to branch
SUDDEN = 3.0  # times the changes beside it
BRINK = 3  # rows to each side of a fall: nearer to a fold than that a little change of the device ends the branch
ELSEWHERE = 0.5  # of the misfit: where as much is left without the rows of a brink, they are not what is wrong
NOBODY = -1  # in place of a record: rows that belong to none
Rows = Mapping[int, tuple[int, ...]]


def without_rows(readings: Sequence[Readings], left_out: Rows) -> tuple[Readings, ...]:
    """The same readings, in which some rows of some records belong to none and have no weight."""
    return tuple(_without(one, left_out) for one in readings)


def _without(readings: Readings, left_out: Rows) -> Readings:
    absent = gone(readings, left_out)
    return without_weight(readings, absent) if absent.any() and not absent.all() else readings


def without_weight(readings: Readings, absent: np.ndarray) -> Readings:
    """The same readings, of which some rows (n,) belong to no record and have no weight."""
    std = getattr(readings.experiment.noise, "std", None)
    if std is None:
        return readings
    wide = jnp.where(absent[:, None], jnp.inf, std)
    experiment = eqx.tree_at(lambda e: e.noise.std, readings.experiment, wide)
    whole = readings.whole
    if whole is None and experiment.rows_stand_alone:
        whole = readings.experiment
    return replace(readings, experiment=experiment, record=np.where(absent, NOBODY, readings.record), whole=whole)


def gone(readings: Readings, left_out: Rows) -> np.ndarray:
    """Which rows of an experiment are left out."""
    out = np.zeros(readings.record.size, bool)
    for number, rows in left_out.items():
        out |= (readings.record == number) & np.isin(readings.row, rows)
    return out


def calm(case: Case, readings: Sequence[Readings]) -> tuple[Readings, ...]:
    """The same readings without rows of sweeps at another temperature or bias voltage than the case's, or on a table
    that turns.
    """
    apart = {
        k: tuple(np.flatnonzero(~r.calm(case.environment)).tolist())
        for k, r in enumerate(case.records)
        if hasattr(r, "calm")
    }
    return tuple(_without(r, apart) for r in readings if not _all_gone(r, apart))


def driven_axes(readings: Sequence[Readings]) -> np.ndarray:
    """(r,) the axis along which the device is driven where each number of a residual is read; `NOBODY` where no one
    drive makes it.
    """
    axes = []
    for one in readings:
        rows, force = one.record.size, np.abs(np.asarray(getattr(one.experiment, "force", np.zeros((0, 1)))))
        whole = force.shape in ((one.axes,), (rows, one.axes))
        driven = np.broadcast_to(np.argmax(force, axis=-1) if whole else NOBODY, rows)
        axes.append(np.repeat(driven, one.size // rows))
    return np.concatenate(axes)


def stages(case: Case, fitted: Sequence[Readings]) -> list[tuple[Readings, ...]]:
    """The sweeps that are fitted, up to each drive of clear ones in turn, and at last all that is; none without a clear
    sweep.
    """
    records: list[tuple[int, Any]] = list(enumerate(case.records))
    sweeps = [(k, r) for k, r in records if hasattr(r, "setting") and r.role != "validation"]
    levels = clear_drives(case)
    if not levels:
        return []
    theirs = {number for number, _ in sweeps}
    swept = tuple(r for r in fitted if (known := {*r.record.tolist()} - {NOBODY}) and known <= theirs)
    if not swept:  # sweeps that are fitted together with what is none
        return [tuple(fitted)]
    louder = [
        {k: tuple(np.flatnonzero(r.setting > (1 + ALIKE) * level).tolist()) for k, r in sweeps} for level in levels[:-1]
    ]
    upto = [some for rows in louder if (some := tuple(_without(r, rows) for r in swept if not _all_gone(r, rows)))]
    return [*upto, *([swept] if len(swept) < len(fitted) else []), tuple(fitted)]


def past_the_brink(case: Case, joint: Joint, end: Optimum) -> Optimum:
    """A fit that goes on without the rows on the brink of a fall from branch to branch, and then with all of them; the
    same where that leaves more, or noise was left alone. What is not yet right cannot pass such rows: beyond there is
    no such branch. What is wrong at most others too will not pass them.
    """
    if end.chi2 <= gate(end.dof) * end.dof:
        return end
    brink = {k: rows for k, r in enumerate(case.records) if hasattr(r, "setting") and (rows := _on_the_brink(r))}
    if not brink:
        return end
    most = ELSEWHERE * end.chi2
    near = optimise(joint, end.vector, end.free, without_rows(joint.fitted, brink), beat=most)
    if near.chi2 >= most:
        return end
    return min(end, optimise(joint, near.vector, end.free, joint.fitted), key=lambda one: one.chi2)


def _on_the_brink(record: AbstractRecord) -> tuple[int, ...]:
    """Rows near a fall from one branch of a bent resonance to another."""
    near = np.add.outer(falls(record), np.arange(-BRINK, BRINK + 1))
    return tuple(np.unique(near[(near >= 0) & (near < record.rows)]).tolist())


def falls(record: AbstractRecord) -> np.ndarray:
    """Rows of a sweep across which the reading changes at once, and hardly beside them."""
    return falls_of(record.readings)


def falls_of(readings: np.ndarray) -> np.ndarray:
    """The same of phasors (n, channels), read or predicted; none of real readings."""
    if not np.iscomplexobj(readings):
        return np.empty(0, int)
    size = np.max(np.abs(readings), axis=1)
    steps, across = np.abs(np.diff(size)), np.abs(size[2:] - size[:-2])[1:-1]  # a row that stands alone comes back
    sudden = across > SUDDEN * np.maximum(steps[:-3], steps[3:])
    return 2 + np.flatnonzero(sudden & (across > FALL * np.nanmax(size)))


def _all_gone(readings: Readings, left_out: Rows) -> bool:
    return bool(np.all(gone(readings, left_out) | (readings.record == NOBODY)))


def up(joint: Joint, vector: np.ndarray, places: np.ndarray, steps: Sequence[tuple[Readings, ...]]) -> Optimum:
    """A fit to the first of `steps` from a vector, from its end to the next, and so on to the last."""
    end = optimise(joint, vector, places, steps[0])
    for step in steps[1:]:
        end = optimise(joint, end.vector, places, step)
    return end
