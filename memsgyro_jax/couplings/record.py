"""Reading what a laboratory recorded: a CSV whose header names each column with its unit, checked so that nothing is
silently wrong.

A frequency sweep has `f [Hz]`, both channels either as `Vx_I [V]`, `Vx_Q [V]`, `Vy_I [V]`, `Vy_Q [V]` or as `Vx_amp
[1]`, `Vx_phase [deg]`, `Vy_amp [1]`, `Vy_phase [deg]`, and where known the condition columns `F_x [N]` or `F_y [N]`
(drive level, which also names the driven electrode), `T [degC]`, `V_bias [V]`, `rate [deg/s]`, `t [s]`. Any unit that
pint knows will do. Phasors follow e^{+iωt}: behind a resonance the phase of the driven channel falls.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table, read_table


_TWO_PI = 2 * np.pi


@dataclass(frozen=True)
class SweepRecord:
    """A frequency sweep as recorded.

    Args:
        name: of the file.
        frequency: angular frequency per row [rad/s].
        phasors: complex (n, 2), channels x and y, convention e^{+iωt}.
        axis: driven electrode, 0 = x, 1 = y.
        drive: level per row; 1 where the file does not say.
        start: frequency at which the sweep of each row began [rad/s].
        rate: angular rate per row [rad/s], zero where the file does not say.
        polar: whether the file holds amplitude and phase.
        elapsed: time per row since the first [s], or `None`.
        unit: of the phasors.
        notes: what the reader assumed, one sentence each.
        lines: of the file, per row.
    """

    name: str
    frequency: np.ndarray
    phasors: np.ndarray
    axis: int
    drive: np.ndarray
    start: np.ndarray
    rate: float
    polar: bool
    elapsed: np.ndarray | None
    unit: str
    notes: tuple[str, ...] = ()
    lines: np.ndarray | None = None


def read_sweep(path: str | Path, *, axis: int | None = None, conjugated: bool = False) -> SweepRecord:
    """Reads and checks one frequency sweep (see the head of this module for the columns).

    Args:
        path: the CSV file.
        axis: the driven electrode, 0 = x or 1 = y, for a file without `F_x` and `F_y`; x if not given.
        conjugated: the phasors follow e^{-iωt} and are conjugated while reading.

    **Raises:** `InputError`: one sentence with file, line and column, and what to do.
    """
    table = read_table(path)
    polar = _check_names(table)
    frequency = _angular_frequency(table)
    if np.any(frequency <= 0):
        raise table.at(int(np.argmax(frequency <= 0)), "f", "must be positive")
    if np.any(frequency > 1e100):
        raise table.at(int(np.argmax(frequency > 1e100)), "f", "must be one that a device has")
    phasors, unit = _phasors(table, polar)
    phasors = phasors.conj() if conjugated else phasors
    axis, drive, notes = _drive(table, axis)
    start = _starts(table, frequency, drive)
    _check_phase(table, frequency, phasors[:, axis] / drive, "xy"[axis], polar)
    return SweepRecord(
        name=table.path.name,
        frequency=frequency,
        phasors=phasors,
        axis=axis,
        drive=drive,
        start=start,
        rate=_one_rate(table),
        polar=polar,
        elapsed=_elapsed(table),
        unit=unit,
        notes=notes,
        lines=table.lines,
    )


_CONDITIONS = {"F_x": "N", "F_y": "N", "T": "degC", "V_bias": "V", "rate": "rad/s", "t": "s"}
_CARTESIAN = ("Vx_I", "Vx_Q", "Vy_I", "Vy_Q")
_POLAR = ("Vx_amp", "Vx_phase", "Vy_amp", "Vy_phase")


def _check_names(table: Table) -> bool:
    """Whether the file holds amplitude and phase; refuses unknown and missing columns."""
    names = set(table.columns)
    known = {"f", *_CARTESIAN, *_POLAR, *_CONDITIONS}
    for name in table.columns:
        if name not in known:
            raise InputError(
                f"{table.path}, line 1: column `{name}` is not known; a sweep has {', '.join(sorted(known))}."
            )
    polar = bool(names & set(_POLAR))
    if polar and names & set(_CARTESIAN):
        raise InputError(
            f"{table.path}, line 1: the file must hold either I and Q or amplitude and phase, but holds both."
        )
    for name in ("f", *(_POLAR if polar else _CARTESIAN)):
        if name not in names:
            raise InputError(
                f"{table.path}, line 1: column `{name}` is missing; the couplings need both channels, x and y."
            )
    return polar


def _angular_frequency(table: Table) -> np.ndarray:
    try:
        with np.errstate(over="ignore"):
            return _TWO_PI * table.si("f", "Hz")
    except InputError:
        return table.si("f", "rad/s")


def _phasors(table: Table, polar: bool) -> tuple[np.ndarray, str]:
    names = _POLAR if polar else _CARTESIAN
    for name in names:
        if re.fullmatch(r"(dB|Np|B)\w*", table.units[name]):
            raise InputError(
                f"{table.path}, line 1: the channels must share one linear unit such as V or 1, "
                f"but `{name}` is in {table.units[name]}; convert it."
            )
    signal, unit = None, ""
    for unit in ("V", "1", "m", "A", "C", "F"):
        try:
            signal = {name: table.si(name, unit) for name in names if not name.endswith("_phase")}
            break
        except InputError:
            continue
    if signal is None:
        units = ", ".join(f"{name} [{table.units[name]}]" for name in names if not name.endswith("_phase"))
        raise InputError(
            f"{table.path}, line 1: the channels must share one linear unit such as V or 1, but are {units}."
        )
    if not polar:
        both = [signal[f"V{a}_I"] + 1j * signal[f"V{a}_Q"] for a in "xy"]
    else:
        for name, values in signal.items():
            if np.any(values <= 0):
                raise table.at(int(np.argmax(values <= 0)), name, "must be a positive amplitude")
        both = [signal[f"V{a}_amp"] * np.exp(1j * _phase(table, f"V{a}_phase")) for a in "xy"]
    return np.stack(both, axis=1), unit


def _phase(table: Table, name: str) -> np.ndarray:
    """Phase [rad]; the range decides whether the label can be true."""
    phase = table.si(name, "rad")
    if np.ptp(phase) > 6 * _TWO_PI:
        raise InputError(
            f"{table.path}, column `{name}`: the phase covers {np.ptp(phase):.0f} rad, "
            "which no two-mode sweep does; is it in degrees?"
        )
    return phase


def _drive(table: Table, axis: int | None) -> tuple[int, np.ndarray, tuple[str, ...]]:
    present = [i for i, name in enumerate(("F_x", "F_y")) if name in table.columns and np.any(table.columns[name] != 0)]
    if len(present) == 2:
        raise InputError(
            f"{table.path}: one electrode must be driven at a time, but both F_x and F_y are non-zero; split the file."
        )
    if not present:
        note = (
            ()
            if axis is not None
            else (
                f"{table.path.name} names no drive (F_x, F_y): taken as the x electrode; `--drive-axis` says another.",
            )
        )
        return axis or 0, np.ones(len(table.lines)), note
    if axis is not None and axis != present[0]:
        raise InputError(
            f"{table.path}: the driven axis was given as {'xy'[axis]}, but column F_{'xy'[present[0]]} is non-zero."
        )
    name = ("F_x", "F_y")[present[0]]
    try:
        level = table.si(name, "N")
    except InputError:
        level = table.si(name, "V")
    if np.any(level <= 0):
        raise table.at(int(np.argmax(level <= 0)), name, "must be positive")
    return present[0], level, ()


def _starts(table: Table, frequency: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """First frequency of the sweep each row belongs to; a sweep ends where a condition changes and runs strictly up or
    strictly down.
    """
    for name in ("T", "V_bias"):
        if name in table.columns and np.ptp(table.columns[name]) > 0:
            raise InputError(
                f"{table.path}, column `{name}`: couplings are identified at one condition, "
                "but it changes; split the file by it."
            )
    new = np.concatenate([[True], np.diff(drive) != 0])
    first = np.flatnonzero(new)
    for begin, end in zip(first, [*first[1:], len(frequency)], strict=True):
        steps = np.diff(frequency[begin:end])
        if steps.size == 0:
            continue
        direction = np.sign(np.median(steps))
        wrong = np.flatnonzero(steps * direction <= 0) if direction else np.array([0])
        if wrong.size:
            row = begin + int(wrong[0]) + 1
            what = "repeats the one before" if frequency[row] == frequency[row - 1] else "goes back"
            raise table.at(row, "f", f"must run strictly up or strictly down within a sweep, but {what}")
    return frequency[first[np.cumsum(new) - 1]]


def _one_rate(table: Table) -> float:
    if "rate" not in table.columns:
        return 0.0
    rate = table.si("rate", "rad/s")
    if np.ptp(rate) > 0:
        raise InputError(
            f"{table.path}, column `rate`: a sweep must be taken at one rate, but it changes; split the file by it."
        )
    return float(rate[0])


def _elapsed(table: Table) -> np.ndarray | None:
    if "t" not in table.columns:
        return None
    time = table.si("t", "s")
    if np.any(np.diff(time) <= 0):
        raise table.at(int(np.argmax(np.diff(time) <= 0)) + 1, "t", "must increase")
    return time - time[0]


def _check_phase(table: Table, frequency: np.ndarray, driven: np.ndarray, axis: str, polar: bool) -> None:
    """The driven channel must turn by about −90° between its half-power points; what turns the other way, or not at
    all, was labelled wrongly.
    """
    order = np.argsort(frequency)
    response = driven[order]
    amplitude = np.abs(response)
    top = int(np.argmax(amplitude))
    low = amplitude < amplitude[top] / np.sqrt(2)
    if not low[:top].any() or not low[top:].any():
        return  # no full resonance in the band: nothing to check against
    left, right = int(np.flatnonzero(low[:top])[-1]), top + int(np.argmax(low[top:]))
    turn = np.angle(response[left + 1 : right + 1] / response[left:right]).sum()
    column = f"V{axis}_phase" if polar else f"V{axis}_Q"
    if turn > np.radians(30):
        raise InputError(
            f"{table.path}, column `{column}`: the phase rises by {np.degrees(turn):.0f}° "
            "across the resonance of the driven channel, "
            "but with e^{+iωt} it falls; if the file follows e^{-iωt}, read it as conjugated (`--conjugated`)."
        )
    if turn > -np.radians(30):
        hint = (
            "is the phase in radians?"
            if polar and "deg" in table.units[column]
            else "are I and Q those of the driven channel?"
        )
        raise InputError(
            f"{table.path}, column `{column}`: the phase turns by only {np.degrees(turn):.1f}° "
            "across the half-power width of the driven "
            f"channel, but a resonance turns it by about -90°; {hint}"
        )
