"""A frequency sweep from the columns of an instrument's table: columns in the words of a case, keys, what is read."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.units import to_si

from .formats import SourceColumn, SourceTable
from .immittance import PER_VOLT
from .imported_columns import (
    add_noise,
    add_surroundings,
    angle_column,
    is_same_kind,
    reading_column,
    time_column,
    with_usual_unit,
)
from .outliers import lone_rows
from .told_beside import level_of, level_of_ratio
from .two_channels import said_of_channels


TURNED = "the phase rises across the resonance, so the file follows e^{-iωt}: it is negated"
PEAK = "amplitudes are peak values, not rms (`Vrms` in a header, or `--rms`, says so)"
OPPOSITE = "the read-out shows displacement with an inverted sign, or acceleration"
OPPOSITE_TAKEN = 'displacement is taken, `quantity = "acceleration"` in [readout] says the other'
_CLEAR = 30.0  # degrees around which the phase at resonance tells what is read
_NEAR = 10.0  # degrees that need no number of their own
_UNTOLD = "the read-out is taken for what other files show, for displacement where none does"
_SETTLED = 2.0  # ring times of a step, of which what rang before it is turned by little
_HEARD, _TURNS = 0.1, 1.5 * np.pi  # of the largest reading; rad, where settled modes turn by half a turn
_INSIDE = 0.01  # of the band, from its ends: where a largest reading is that of a resonance


def running(rows: Mapping[str, SourceColumn], assumed: list[str]) -> dict[str, SourceColumn]:
    """The columns without the rows at 0 Hz with which spectra begin."""
    kept = np.asarray(rows["f"].values) != 0
    if kept.all():
        return {**rows}
    number = int(np.sum(~kept))
    which = "the row at 0 Hz, which tells" if number == 1 else f"{number} rows at 0 Hz, which tell"
    assumed.append(f"{which} nothing of a resonance, {'is' if number == 1 else 'are'} left out")
    return {role: SourceColumn(c.name, c.unit, c.values[kept]) for role, c in rows.items()}


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
    columns |= phasor_columns_of(rows, assumed)
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
        keys["drive_force"] = level_of(table, drive, assumed)
    if (
        not is_ratio(table)
        and PER_VOLT not in table.attributes
        and not any(rows[role].unit == "dB" for role in ("amp", "y_amp") if role in rows)
    ):
        add_noise(columns, rows, columns[next(name for name in columns if name.startswith("V"))].unit, assumed)
    _by_drive(table, columns, keys, rows, assumed)
    add_surroundings(columns, rows)
    return columns, keys, quantity


def _by_drive(
    table: SourceTable,
    columns: dict[str, SourceColumn],
    keys: Mapping[str, Any],
    rows: Mapping[str, SourceColumn],
    assumed: list[str],
) -> None:
    """Makes readings of the gains of a network analyser, and of admittances, which are ratios to the drive."""
    owners = {"amp": "Vx_amp", "y_amp": "Vy_amp"}
    gains = [name for role, name in owners.items() if role in rows and rows[role].unit == "dB"]
    drive = next((column for name, column in columns.items() if name.startswith("F_")), None)
    told = keys.get("drive_force", {})
    level, unit = (told["value"], told["unit"]) if drive is None else (drive.values, drive.unit)
    what = "readings in dB"
    if PER_VOLT in table.attributes:
        gains, what = [name for name in columns if name.endswith(("_I", "_Q", "_amp"))], "currents"
        if not is_same_kind(unit, "V"):
            must = "the drive beside impedances or admittances must be a voltage"
            raise InputError(f'{table.path}: {must}, but is in {unit}; give it as in --drive "10 mV".')
    if gains and is_same_kind(unit, "V"):
        columns |= {name: SourceColumn("", unit, columns[name].values * level) for name in gains}
        assumed.append(f"the {what} are ratios to the drive, with which they are multiplied")


def is_ratio(table: SourceTable) -> bool:
    """Whether the readings of a table are ratios to its drive, whose level it does not say."""
    return table.attributes.get("ratio") == "drive"


def at_level(
    table: SourceTable, rows: Mapping[str, SourceColumn], drive: tuple[float, str] | None, assumed: list[str]
) -> dict[str, SourceColumn]:
    """The columns of ratios to the drive at the level that was given, or that names tell, without one at 1 V; others as
    they are.
    """
    if not is_ratio(table) or "drive" not in rows:
        return dict(rows)
    told = "" if drive is None else f"at {drive[0]:g} {drive[1]}, as was given"
    if drive is None:
        drive, told = level_of_ratio(table)
    if drive is None:
        assumed.append("it was taken at 1 V, as the file does not say (`--drive`)")
        return dict(rows)
    if not is_same_kind(drive[1], "V"):
        must = "the level `--drive` of a ratio of voltages must be a voltage"
        raise InputError(f"{table.path}: {must}, but is {drive[0]:g} {drive[1]}.")
    volts = float(to_si(*drive, "V", "option `--drive`"))
    assumed.append(f"it was taken {told}, with which the ratio is multiplied")
    scaled = {"I", "Q", "amp", "drive"}
    return {
        role: SourceColumn(column.name, column.unit, column.values * volts) if role in scaled else column
        for role, column in rows.items()
    }


def phasor_columns_of(rows: Mapping[str, SourceColumn], assumed: list[str]) -> dict[str, SourceColumn]:
    """The parts of a phasor, of one channel or two, in the words of a case."""
    form = ("I", "Q") if "I" in rows else ("amp", "phase")
    parts = {f"V{a}_{p}": rows[own + p] for a, own in (("x", ""), ("y", "y_")) for p in form if own + p in rows}
    if len({name[:2] for name in parts}) == 2:
        assumed.append(said_of_channels(rows))
    return {
        name: angle_column(column, assumed) if "phase" in name else reading_column(column, assumed)
        for name, column in parts.items()
    }


def phasors_of(columns: Mapping[str, SourceColumn], axis: str) -> np.ndarray:
    """(n,) complex, of the channel of an axis."""
    own = f"V{axis}"
    if f"{own}_I" in columns:
        return columns[f"{own}_I"].values + 1j * columns[f"{own}_Q"].values
    phase = columns[f"{own}_phase"]
    return columns[f"{own}_amp"].values * np.exp(1j * to_si(phase.values, phase.unit, "rad", "phase"))


def _conventions(columns: dict[str, SourceColumn], table: SourceTable, axis: str, assumed: list[str]) -> str:
    """Turns the phasors to e^{+iωt} where they run the other way; what is read, as the phase at resonance has it, in
    the channel of the driven axis.
    """
    own = f"V{axis}"
    known = read_as(columns[f"{own}_I" if f"{own}_I" in columns else f"{own}_amp"].unit)
    known = known or table.attributes.get("reads", "")
    if f"{own}_I" not in columns and f"{own}_phase" not in columns:
        assumed += [] if known else [f"{_UNTOLD}; amplitudes without a phase do not tell"]
        return known
    phasors, frequency = phasors_of(columns, axis), np.asarray(columns["f"].values, float)
    kept = ~_lone(frequency, phasors)
    phasors, frequency = phasors[kept], frequency[kept]
    turn = phasors[1:] * phasors[:-1].conj()
    if np.sum(np.sign(np.diff(frequency)) * turn.imag) > 0.2 * np.sum(np.abs(turn.imag)):
        for second in [name for name in columns if name.endswith(("_Q", "_phase"))]:
            columns[second] = SourceColumn("", columns[second].unit, -columns[second].values)
        phasors = phasors.conj()
        assumed.append(TURNED)
    if known:
        return known
    if "t" in columns and _never_settles(columns["t"], frequency, phasors):
        assumed.append(f"{_UNTOLD}; the sweep is too fast for its phase to tell")
        return ""
    largest = int(np.argmax(np.abs(phasors)))
    angle = np.degrees(np.angle(phasors[largest]))
    if min(frequency[largest] - frequency.min(), frequency.max() - frequency[largest]) < _INSIDE * np.ptp(frequency):
        assumed.append(f"{_UNTOLD}; the largest reading ends the band, so its phase does not tell")
        return ""
    away = abs((angle + 90) % 180 - 90)  # from 0° or 180°
    if _CLEAR <= away <= 90 - _CLEAR:
        assumed.append(f"{_UNTOLD}; its phase at resonance, {angle:+.0f}°, does not tell")
        return ""
    quantity, nearest = ("velocity", "0° or 180°") if away < _CLEAR else ("displacement", "-90° or 90°")
    whole = 90 * round(angle / 90)
    about = f"about {whole}°" if abs(angle - whole) <= _NEAR else f"{angle:.0f}°, nearest to {nearest}"
    if quantity == "displacement" and angle > 0:
        assumed.append(f"{OPPOSITE}: at resonance its phase is {about}; {OPPOSITE_TAKEN}")
    else:
        assumed.append(f"the read-out shows {quantity}: at resonance its phase is {about}")
    return quantity


def _never_settles(time: SourceColumn, frequency: np.ndarray, phasors: np.ndarray) -> bool:
    """Whether a step is too short for a resonance as narrow as the one that is seen, and what still rings from the
    steps before has turned the phase further than two modes do: it then tells nothing at the largest reading.
    """
    rows = np.argsort(frequency, kind="stable")
    size = np.abs(phasors[rows])
    turned = np.unwrap(np.angle(phasors[rows][size >= _HEARD * size.max()]))
    width = float(np.sum((size >= size.max() / np.sqrt(2.0)) * np.gradient(frequency[rows])))
    step = float(np.median(np.diff(to_si(time.values, time.unit, "s", "t"))))
    return np.pi * width * step < _SETTLED and float(np.ptp(turned)) > _TURNS


def _lone(frequency: np.ndarray, phasors: np.ndarray) -> np.ndarray:
    """Which rows (n,) stand alone among their neighbours, up or down the band: a wrong one may be the largest."""
    found = np.zeros(len(phasors), bool)
    ways = np.sign(np.diff(frequency, prepend=frequency[0]))
    for rows in np.split(np.arange(len(phasors)), 1 + np.flatnonzero(np.diff(ways[1:])) + 1):
        found[[rows[row] for row, _ in lone_rows(frequency[rows], phasors[rows], 0.0)]] = True
    return found


def read_as(unit: str) -> str:
    """What a reading in such a unit shows of the motion; empty where it does not tell."""
    measured = {"m": "displacement", "m/s": "velocity", "m/s**2": "acceleration"}
    return next((what for base, what in measured.items() if is_same_kind(unit, base)), "")
