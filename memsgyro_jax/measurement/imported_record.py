"""From the columns of an instrument's table to records of a case: kind, columns in the words of a case, sections."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.units import parse_header, to_si

from .begin_of_decay import behind_the_filter, part_of_decay
from .column_map import SECOND_DRIVE
from .column_meaning import Meaning
from .experiments.time_record import RING_TIMES
from .formats import SourceColumn, SourceTable
from .formats.header import SPECIAL
from .immittance import as_current
from .imported_columns import (
    NOISE_COLUMNS,
    add_surroundings,
    cut_column,
    from_effective,
    headed,
    in_decibels,
    reading_column,
    time_column,
)
from .imported_conditions import CONDITIONS, beside_conditions, columns_of_points, columns_of_rate_table, stamps
from .imported_sweep import at_level, columns_of_sweep, phasor_columns_of, phasors_of, read_as, running
from .thinning import thinned
from .told_beside import driven_axis, reference_of
from .tracking import rough_decay, too_slow
from .two_channels import said_of_channels


_SILENT = 0.01  # of the largest drive: nothing
_QUIET_SHARE = 0.15  # of the rows at the end without drive: a free decay
_FEWEST = 50  # rows of a record over time
_MADE_OF: dict[str, set[str]] = {  # columns of a case and keys of its sections that a column of each role becomes
    **{role: {f"Vx_{role}"} for role in ("I", "Q", "amp", "phase")},
    **{f"y_{role}": {f"Vy_{role}"} for role in ("I", "Q", "amp", "phase")},
    **{role: {role} for role in ("t", "T", "V_bias", "rate")},
    "f": {"f", "reference_frequency", "drive_frequency"},
    "signal": {"Vx"},
    **{role: {name} for role, name in NOISE_COLUMNS.items()},
    "y_signal": {"Vy"},
    "drive": {"F_x", "F_y", "u_x", "u_y", "drive_force"},
    SECOND_DRIVE: {"F_y", "u_y"},
}


@dataclass(frozen=True, eq=False)
class ImportedRecord:
    """One `[[experiment]]` to be.

    Args:
        name: of the record.
        source: file and table that it comes from.
        kind: of measurement.
        columns: header, in the words of a case, to numbers.
        keys: further keys of its section.
        assumed: one sentence each.
        unused: columns of the source that are not used.
        quantity: what is read, where the record shows it: "displacement", "velocity" or "acceleration".
        design: values that no other record can tell, in SI.
        two_axes: whether two channels were read, or two axes driven.
        axis: that was driven, of two: "x" or "y", "xy" over time for both; empty where nothing says.
        forced: whether its columns hold the forces at every row.
    """

    name: str
    source: str
    kind: str
    columns: Mapping[str, np.ndarray]
    keys: Mapping[str, Any]
    assumed: tuple[str, ...]
    unused: tuple[str, ...] = ()
    quantity: str = ""
    design: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    two_axes: bool = False
    axis: str = ""
    forced: bool = False


@dataclass(frozen=True)
class Given:
    """What the user says beside the file: drive level and reference frequency with their units, or nothing; that one
    row of `every` is kept; whether a lock-in's readings are effective values (`rms`); which `axis` of two was
    driven; and the `conditions` of the whole file, role to value and unit.
    """

    drive: tuple[float, str] | None = None
    reference: tuple[float, str] | None = None
    every: int | None = None
    rms: bool = False
    axis: str = ""
    conditions: Mapping[str, tuple[float, str]] = field(default_factory=dict)


def records_of(name: str, table: SourceTable, meaning: Meaning, given: Given) -> list[ImportedRecord]:
    """The records that a table holds: a sweep, or what was forced and what was free of a run over time."""
    assumed = [*table.assumed]
    rows = thinned(table, meaning, _finite(table, meaning, assumed), given.every, assumed)
    rows = from_effective(rows, assumed) if given.rms else rows
    table, rows = as_current(table, rows, assumed)
    rows = at_level(table, rows, given.drive, assumed)
    rows = beside_conditions(table, rows, given.conditions, assumed)
    source = f"{table.shown or table.path.name}{', ' + table.name if table.name else ''}"
    about = {"name": name, "source": source, "unused": meaning.unused}
    with np.errstate(over="ignore", invalid="ignore"):  # of a damaged file; reading the case refuses them
        return _naming_unused(_records(about, table, meaning, rows, given, assumed), meaning)


def _records(
    about: dict, table: SourceTable, meaning: Meaning, rows: dict, given: Given, assumed: list[str]
) -> list[ImportedRecord]:
    """Those that the columns make."""
    if meaning.swept:
        return [_sweep(about, table, meaning, rows, given, assumed)]
    if meaning.at_points:
        return [_points(about, table, meaning, rows, given, assumed)]
    if "rate" in rows and "signal" not in rows and np.ptp(rows["rate"].values) > 0:
        return [_rate_table(about, table, rows, given, meaning, assumed)]
    return _over_time({**about, "two_axes": meaning.two_axes}, table, rows, given, meaning, assumed)


def _naming_unused(records: list[ImportedRecord], meaning: Meaning) -> list[ImportedRecord]:
    """The records, with the columns that none of them made something of among those that are not used; one of which a
    sentence says that it is left out has been named.
    """
    made = {parse_header(header).name for record in records for header in record.columns}
    made |= {key for record in records for key in record.keys}
    said = " ".join(sentence for record in records for sentence in record.assumed)
    idle = tuple(
        column.header
        for role, column in meaning.columns.items()
        if not made & _MADE_OF[role] and f"`{column.name}` is left out" not in said
    )
    guessed = [f"`{meaning.columns[role].name}` is taken for the bias voltage" for role in meaning.guessed]
    guessed = guessed if "V_bias" in made else []
    return [replace(record, unused=(*record.unused, *idle), assumed=(*record.assumed, *guessed)) for record in records]


def _finite(table: SourceTable, meaning: Meaning, assumed: list[str]) -> dict[str, SourceColumn]:
    """The columns in rows that have every number, but for that of their noise, and are no copies."""
    every = [column.values for role, column in meaning.columns.items() if role not in NOISE_COLUMNS]
    kept = np.all([np.isfinite(values) for values in every], axis=0)
    if not kept.all():
        assumed.append(_left_out(int((~kept).sum()), "without a number"))
    values = np.stack([np.asarray(column.values, float)[kept] for column in meaning.columns.values()], axis=1)
    first = np.sort(np.unique(values, axis=0, return_index=True)[1])
    if len(first) < len(values):
        copies = len(values) - len(first)
        assumed.append(_left_out(copies, f"that repeat{'s' * (copies == 1)} an earlier one to the last digit"))
    if len(first) < 3:
        raise InputError(f"{table.path}: must hold at least three rows of numbers, but holds {len(first)}.")
    places = np.flatnonzero(kept)[first]
    return {role: SourceColumn(c.name, c.unit, c.values[places]) for role, c in meaning.columns.items()}


def _left_out(rows: int, which: str) -> str:
    return f"{rows} row{'s' * (rows > 1)} {which} {'are' if rows > 1 else 'is'} left out"


def _sweep(about: dict, table: SourceTable, meaning: Meaning, rows: dict, given: Given, assumed: list[str]):
    rows = in_decibels(running(rows, assumed), assumed)
    axis = driven_axis(table, rows, given.axis, meaning, assumed)
    columns, keys, quantity = columns_of_sweep(table, rows, given.drive, axis, assumed)
    return ImportedRecord(
        **about, kind="frequency_sweep", columns=headed(columns), keys=keys, assumed=tuple(assumed), quantity=quantity,
        two_axes=meaning.two_axes, axis=axis,
    )  # fmt: skip


def _points(about: dict, table: SourceTable, meaning: Meaning, rows: dict, given: Given, assumed: list[str]):
    """Settled phasors at one frequency, a row for each rate or other condition."""
    axis = driven_axis(table, rows, given.axis, meaning, assumed)
    columns, keys, quantity = columns_of_points(
        table, rows, reference_of(table, rows, given.reference, assumed), given.drive, axis, assumed
    )
    return ImportedRecord(
        **about, kind="operating_points", columns=headed(columns), keys=keys, assumed=tuple(assumed), quantity=quantity,
        two_axes=meaning.two_axes, axis=axis,
    )  # fmt: skip


# ---- time


def _over_time(
    about: dict, table: SourceTable, rows: dict[str, SourceColumn], given: Given, meaning: Meaning, assumed: list[str]
) -> list[ImportedRecord]:
    columns = {"t": time_column(table, rows["t"], assumed)}
    if len(columns["t"].values) < _FEWEST:
        raise InputError(f"{table.path}: a record over time must have {_FEWEST} rows, but has {len(rows['t'].values)}.")
    if not np.all(np.diff(columns["t"].values) > 0):
        raise InputError(f"{table.path}: the time must rise from row to row, but does not.")
    add_surroundings(columns, {role: rows[role] for role in CONDITIONS if role in rows})
    if "signal" not in rows:
        return [_lock_in_decay(about, table, columns, rows, given, assumed)]
    columns["Vx"] = reading_column(rows["signal"], assumed)
    if "y_signal" in rows:
        columns["Vy"] = reading_column(rows["y_signal"], assumed)
        assumed.append(said_of_channels(rows))
    about = {**about, "quantity": read_as(columns["Vx"].unit)}
    drive = rows.get("drive")
    if drive is None or not np.ptp(drive.values) > 0:
        return [_decay(about, columns, assumed)]
    if SECOND_DRIVE in rows:
        axis, drives = "xy", {"u_x": drive, "u_y": rows[SECOND_DRIVE]}
        if "y_signal" not in rows:
            assumed.append(f"two drives make it a device of two axes (`single_mass`), x read by {rows['signal'].name}")
    else:
        axis = driven_axis(table, rows, given.axis, meaning, assumed)
        drives = {f"u_{axis or 'x'}": drive}
    driven = {name: reading_column(column, assumed, "drive") for name, column in drives.items()}
    return _driven_over_time({**about, "axis": axis}, columns, driven, rows, assumed)


def _driven_over_time(
    about: dict,
    columns: dict[str, SourceColumn],
    driven: dict[str, SourceColumn],
    rows: Mapping[str, SourceColumn],
    assumed: list[str],
) -> list[ImportedRecord]:
    """What was forced of a run, and what was free after it."""
    forces = [np.abs(column.values) for column in driven.values()]
    force = np.max([one / max(one.max(), 1e-300) for one in forces], axis=0)  # N and V may stand side by side
    last = int(np.flatnonzero(force > _SILENT * force.max())[-1]) + 1
    free = len(force) - last > max(_QUIET_SHARE * len(force), _FEWEST)
    records = []
    all_of_it = {**columns, **driven}
    add_surroundings(all_of_it, {"rate": rows["rate"]} if "rate" in rows else {})
    forced = {name: cut_column(column, slice(None, last if free else None)) for name, column in all_of_it.items()}
    records.append(_forced(about, forced, assumed))
    if free:
        begin = columns["t"].values[last]
        after = {name: cut_column(columns[name], slice(last, None)) for name in columns}
        said = [
            *assumed,
            f"from {begin:.6g} {columns['t'].unit} on nothing drives, and the decay is a record of its own",
        ]
        try:
            decay = _decay({**about, "name": f"{about['name']}_free"}, after, said)
            lasts = float(to_si(begin - columns["t"].values[0], columns["t"].unit, "s", "t"))
            records = _with_decay(records[0], lasts, decay)
        except InputError:
            left = f"what follows the drive from {begin:.6g} {columns['t'].unit} on is no clear decay, and is left out"
            records = [replace(records[0], assumed=(*records[0].assumed, left))]
    return records


def _with_decay(forced: ImportedRecord, lasts: float, decay: ImportedRecord) -> list[ImportedRecord]:
    """The driven part of a run, which lasts so many seconds, and the decay after it; the decay alone where the driven
    part is too short for an unknown start to die out.
    """
    resonance, quality = (value for value, _ in decay.design.values())
    if forced.keys["start"] == "rest" or lasts > 2 * RING_TIMES * quality / (np.pi * resonance):
        return [forced, decay]
    left = "what is driven is left out, as its unknown start does not die out before the drive ends"
    return [replace(decay, assumed=(*decay.assumed, left))]


def _forced(about: dict, columns: dict[str, SourceColumn], assumed: list[str]) -> ImportedRecord:
    signal, time = _louder(columns) - np.median(_louder(columns)), columns["t"]
    calm = max(2, len(signal) // 200)
    rest = bool(np.max(np.abs(signal[:calm])) < 0.05 * np.max(np.abs(signal)))
    said = [*assumed, "the drive was sampled as it ran (`hold` is band_limited), not held from row to row"]
    said.append(f"the motion begins at {'rest' if rest else 'an unknown state'}, as the first rows show")
    if rest and time.values[0] != 0:
        columns["t"] = SourceColumn("", time.unit, time.values - time.values[0])
    keys = {"hold": "band_limited", "start": "rest" if rest else "unknown"}
    return ImportedRecord(
        **about, kind="time_record", columns=headed(columns), keys=keys, assumed=tuple(said), forced=True
    )


def _decay(about: dict, columns: dict[str, SourceColumn], assumed: list[str]) -> ImportedRecord:
    """A waveform that dies out, as far as it is a decay that its converter could read."""
    signal, time = _louder(columns), columns["t"]
    part = part_of_decay(signal, columns["Vx"].unit, _FEWEST)
    if part.end - part.begin < _FEWEST:
        raise InputError(
            f"{about['source']}: a record over time without a drive must be a vibration that dies away, but its "
            f"envelope falls over fewer than {_FEWEST} rows; name the drive with --map, or leave the file out."
        )
    said, ends = list(assumed), {}
    for key, words, row in (("from", part.why, part.begin), ("to", part.until, part.end - 1)):
        if words:
            said.append("the free decay " + words.format(f"{time.values[row]:.6g} {time.unit}"))
            ends[key] = {"value": float(time.values[row]), "unit": time.unit}
    rows = slice(part.begin, part.end)
    seconds = to_si(time.values[rows], time.unit, "s", "t")
    design = rough_decay(seconds, signal[rows])
    if slowest := too_slow(seconds, signal[rows]):
        said.append(
            f"the resonance is taken for {design['resonance'][0]:.3g} Hz, though most of what vibrates is below "
            f"{slowest:.3g} Hz, with fewer than four periods in the decay, too few to tell one"
        )
    keys = stamps(time, said) | ends
    return ImportedRecord(
        **about, kind="free_decay", columns=headed(columns), keys=keys, assumed=tuple(said), design=design
    )


def _louder(columns: Mapping[str, SourceColumn]) -> np.ndarray:
    """The waveform that moves most, of one or two."""
    return max((columns[name].values for name in ("Vx", "Vy") if name in columns), key=np.std)


def _lock_in_decay(about, table, columns, rows, given: Given, assumed: list[str]) -> ImportedRecord:
    """Phasors over time."""
    reference = reference_of(table, rows, given.reference, assumed)
    columns |= phasor_columns_of(rows, assumed)
    size = rows["I" if "I" in rows else "amp"]
    if not given.rms and not SPECIAL.fullmatch(size.unit):
        assumed.append(f"`{size.name}` tells peak amplitudes (`--rms` where they are effective values)")
    about = {**about, "quantity": read_as(columns["Vx_I" if "I" in rows else "Vx_amp"].unit)}
    time, axes = columns["t"], "xy" if about["two_axes"] else "x"
    seconds, phasors = to_si(time.values, time.unit, "s", "t"), [phasors_of(columns, axis) for axis in axes]
    begin, ends = behind_the_filter(seconds, max(phasors, key=np.std)), {}
    if begin:
        ends["from"] = {"value": float(time.values[begin]), "unit": time.unit}
        at = f"{time.values[begin]:.6g} {time.unit}"
        assumed.append(
            f"the free decay begins at {at}, behind what the lock-in's filter still holds of before (`from`)"
        )
    design = {}  # of two axes, which sweeps or the user tell
    if not about["two_axes"]:
        design = rough_decay(seconds[begin:], phasors[0][begin:], to_si(*reference, "Hz", "f"))
    reference_frequency = {"value": reference[0], "unit": reference[1]}
    keys = stamps(time, assumed) | {"reference_frequency": reference_frequency} | ends
    return ImportedRecord(
        **about, kind="free_decay", columns=headed(columns), keys=keys, assumed=tuple(assumed), design=design
    )


def _rate_table(about, table, rows, given: Given, meaning: Meaning, assumed: list[str]) -> ImportedRecord:
    """Phasors over time beside the rate of a table."""
    reference = reference_of(table, rows, given.reference, assumed)
    columns, keys, quantity = columns_of_rate_table(table, rows, reference, given.drive, assumed)
    axis = driven_axis(table, rows, given.axis, meaning, assumed)
    return ImportedRecord(
        **about, kind="rate_table", columns=headed(columns), keys=keys, assumed=tuple(assumed), quantity=quantity,
        two_axes=meaning.two_axes, axis=axis,
    )  # fmt: skip
