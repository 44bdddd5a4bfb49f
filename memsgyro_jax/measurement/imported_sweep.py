"""A frequency sweep from the columns of an instrument's table: columns in the words of a case, keys, what is read."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from memsgyro_jax.base.units import to_si

from .formats import SourceColumn, SourceTable
from .imported_columns import (
    add_surroundings,
    angle_column,
    is_same_kind,
    reading_column,
    time_column,
    with_usual_unit,
)
from .two_channels import said_of_channels


NO_LEVEL = "the drive is 1 V, as the file does not say (`--drive`)"
PEAK = "amplitudes are peak values, not rms (`Vrms` in a header, or `--rms`, says so)"
_CLEAR = 30.0  # degrees around which the phase at resonance tells what is read
_UNTOLD = "the read-out is taken for what other files show, for displacement where none does"
_INSIDE = 0.01  # of the band, from its ends: where a largest reading is that of a resonance
_LEVEL = re.compile(r"(?<![A-Za-z0-9.])(\d+(?:[.p]\d+)?)[ _]?([nuµm]?[VAN])(?:pk|p)?(?![A-Za-z])")


def columns_of_sweep(
    table: SourceTable,
    rows: Mapping[str, SourceColumn],
    drive: tuple[float, str] | None,
    axis: str,
    assumed: list[str],
) -> tuple[dict[str, SourceColumn], dict[str, Any], str]:
    """Columns and keys of a sweep, and what is read where it shows.

    Args:
        table: as read.
        rows: role to column; with "y_I", "y_amp" and so on where there are two channels.
        drive: level that was given, and its unit.
        axis: that was driven, of two; empty where it is not known.
        assumed: gets one sentence each.
    """
    columns = {"f": with_usual_unit(rows["f"], "Hz", "frequency", assumed)}
    if "t" in rows and rows["t"].unit == "ticks":
        assumed.append(f"`{rows['t'].name}` is left out, as it counts ticks of a clock that is not named")
    elif "t" in rows and np.all(np.diff(rows["t"].values) > 0):
        columns["t"] = time_column(table, rows["t"], assumed)
    elif "t" in rows:
        assumed.append(f"`{rows['t'].name}` is left out, as it does not rise from row to row")
    form = ("I", "Q") if "I" in rows else ("amp", "phase")
    parts = {f"V{a}_{p}": rows[own + p] for a, own in (("x", ""), ("y", "y_")) for p in form if own + p in rows}
    if len({name[:2] for name in parts}) == 2:
        assumed.append(said_of_channels(rows))
    for name, column in parts.items():
        columns[name] = angle_column(column, assumed) if "phase" in name else reading_column(column, assumed)
    if not any("peak amplitude" in sentence for sentence in assumed):
        assumed.append(PEAK)
    quantity = _conventions(columns, table, axis or "x", assumed)
    keys: dict[str, Any] = {"settled": "t" not in columns}
    assumed.append(
        "a row begins where the row before ended and rings down from there, as the clock says (`settled = false`)"
        if "t" in columns
        else "every row was read after its transient had died away (`settled`)"
    )
    if "drive" in rows:
        columns[f"F_{axis or 'x'}"] = reading_column(rows["drive"], assumed, "drive")
    else:
        keys["drive_force"] = _level(table, drive, assumed)
    add_surroundings(columns, rows)
    return columns, keys, quantity


def _conventions(columns: dict[str, SourceColumn], table: SourceTable, axis: str, assumed: list[str]) -> str:
    """Turns the phasors to e^{+iωt} where they run the other way; what is read, as the phase at resonance has it, in
    the channel of the driven axis.
    """
    own = f"V{axis}"
    known = read_as(columns[f"{own}_I" if f"{own}_I" in columns else f"{own}_amp"].unit)
    known = known or table.attributes.get("reads", "")
    if f"{own}_I" in columns:
        phasors = columns[f"{own}_I"].values + 1j * columns[f"{own}_Q"].values
    elif f"{own}_phase" in columns:
        phase = columns[f"{own}_phase"]
        phasors = columns[f"{own}_amp"].values * np.exp(1j * to_si(phase.values, phase.unit, "rad", ""))
    else:
        return known
    frequency = columns["f"].values
    turn = phasors[1:] * phasors[:-1].conj()
    if np.sum(np.sign(np.diff(frequency)) * turn.imag) > 0.2 * np.sum(np.abs(turn.imag)):
        for second in [name for name in columns if name.endswith(("_Q", "_phase"))]:
            columns[second] = SourceColumn("", columns[second].unit, -columns[second].values)
        phasors = phasors.conj()
        assumed.append("the phase rises across the resonance, so the file follows e^{-iωt}: it is negated")
    if known:
        return known
    largest = int(np.argmax(np.abs(phasors)))
    angle = np.degrees(np.angle(phasors[largest]))
    if min(frequency[largest] - frequency.min(), frequency.max() - frequency[largest]) < _INSIDE * np.ptp(frequency):
        assumed.append(f"{_UNTOLD}; the largest reading ends the band, so its phase does not tell")
        return ""
    away = abs((angle + 90) % 180 - 90)  # from 0° or 180°
    if away < _CLEAR:
        assumed.append(
            f"the read-out shows velocity: at resonance its phase is {angle:+.0f}°, nearer 0° or 180° than ±90°"
        )
        return "velocity"
    if away > 90 - _CLEAR:
        assumed.append(
            f"the read-out shows displacement: at resonance its phase is {angle:+.0f}°, nearer ±90° than 0° or 180°"
        )
        return "displacement"
    assumed.append(f"{_UNTOLD}; its phase at resonance, {angle:+.0f}°, does not tell")
    return ""


def read_as(unit: str) -> str:
    """What a reading in such a unit shows of the motion; empty where it does not tell."""
    measured = {"m": "displacement", "m/s": "velocity", "m/s**2": "acceleration"}
    return next((what for base, what in measured.items() if is_same_kind(unit, base)), "")


def _level(table: SourceTable, drive: tuple[float, str] | None, assumed: list[str]) -> dict[str, Any]:
    """The drive level that no column holds."""
    if drive is not None:
        return {"value": drive[0], "unit": drive[1]}
    if found := _LEVEL.search(table.path.stem):
        value, unit = float(found[1].replace("p", ".")), found[2]
        assumed.append(f"the drive is {value:g} {unit}, as the file's name says")
        return {"value": value, "unit": unit}
    assumed.append(NO_LEVEL)
    return {"value": 1.0, "unit": "V"}
