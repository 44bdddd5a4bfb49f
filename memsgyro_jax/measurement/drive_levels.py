"""The drives of a case: which levels its sweeps show, and the case of the lowest of them alone."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from memsgyro_jax.base.errors import InputError

from .case import Case
from .experiments import AbstractRecord


CLEAR = 20.0  # standard deviations from which a sweep tells the device
ALIKE = 0.05  # of a drive: within it sweeps have the same


def clear_drives(case: Case, axis: int | None = None) -> list[float]:
    """The drive levels [N], of a resonator [V], of sweeps that may be fitted and stand clear of their noise, from the
    lowest; one of several that are alike. Of one driven `axis`, or of all.
    """
    sweeps: list[Any] = [r for r in case.records if hasattr(r, "setting") and r.role != "validation"]
    sweeps = [r for r in sweeps if axis in (None, r.axis)]
    clear = [
        float(np.mean(r.setting[rows]))
        for r in sweeps
        for rows in r.sweeps
        if np.max(np.abs(r.readings[rows, r.axis])) > CLEAR * r.noise_levels[r.axis]
    ]
    return levels_apart(clear)


def levels_apart(drives: Iterable[float]) -> list[float]:
    """From the lowest, one of several that are alike."""
    levels: list[float] = []
    for level in sorted(drives):
        if not levels or level > (1 + ALIKE) * levels[-1]:
            levels.append(level)
    return levels


def goes_one_way(record: AbstractRecord) -> bool:
    """Whether the drive of a record with a clock rises from sweep to sweep and never falls, or the other way round."""
    level, time, sweeps = (getattr(record, name, None) for name in ("setting", "time", "sweeps"))
    if level is None or time is None or sweeps is None:
        return False
    in_order = sorted(sweeps, key=lambda rows: time[rows][0])
    steps = np.diff(np.log([np.mean(level[rows]) for rows in in_order]))
    rises, falls = bool(np.any(steps > ALIKE)), bool(np.any(steps < -ALIKE))
    return rises != falls


def lowest_drives(case: Case, count: int) -> Case:
    """The case as it was measured with so many of its lowest drive levels: without sweeps that are driven harder, and
    without other records that are; of a free decay without what is louder than those sweeps. What is driven sample by
    sample stays.

    Raises `InputError` unless there are more levels than that, and at least one is asked for.
    """
    levels = clear_drives(case)
    if not 1 <= count < len(levels):
        told = f"{len(levels)} clear drive level" + "s" * (len(levels) != 1)
        remedy = f"choose 1 to {len(levels) - 1}" if len(levels) > 1 else "none can be left out"
        raise InputError(f"The {count} lowest drives cannot be taken by themselves: the sweeps have {told}; {remedy}.")
    kept = [_up_to(record, (1 + ALIKE) * levels[count - 1]) for record in case.records]
    sweeps: list[Any] = [record for record in kept if record is not None and hasattr(record, "setting")]
    loudest = max(float(np.max(np.abs(record.readings))) for record in sweeps)
    kept = [record if record is None else record.no_louder_than(loudest) for record in kept]
    return replace(case, records=tuple(record for record in kept if record is not None))


def _up_to(record: AbstractRecord, level: float) -> AbstractRecord | None:
    """The rows of a record that are driven no harder; `None` where none is."""
    drive = getattr(record, "setting", getattr(record, "drive_force", None))  # of each row, or of all
    if drive is None:
        return record
    keep = np.broadcast_to(np.abs(drive) <= level, record.rows)
    if keep.all() or not record.stepped:
        return record if keep.all() else None
    return record.only(keep) if keep.any() else None
