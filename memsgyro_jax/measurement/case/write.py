"""Writing a measurement case, in SI, so that reading it again gives the same numbers."""

import hashlib
from functools import singledispatch
from pathlib import Path

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import write_whole
from memsgyro_jax.base.toml import toml_text as _text

from .device import VOCABULARIES
from .file import FILE, SCHEMA
from .records import AbstractRecord, Case, FrequencySweepRecord, RateTableRecord, RingDownRecord, TimeRecord


def write_case(case: Case, folder: str | Path) -> Path:
    """Writes a case into a folder: every CSV file, then `case.toml` with the checksum of each of them.

    All numbers are in SI (temperatures in K, frequencies in rad/s) with every digit: `load_case` gives them back
    exactly.

    Args:
        case: what to write.
        folder: made where it does not exist; must not hold a case yet.

    Returns:
        The path of `case.toml`.

    Raises:
        InputError: the folder already holds a case, or a record's file would lie outside it.
    """
    folder = Path(folder)
    target = folder / FILE
    if target.exists():
        raise InputError(f"Argument `folder` must not hold a case yet, but {target} exists; choose another folder.")
    sections = [*_head(case)]
    for record in case.records:
        path = folder / record.file
        if not path.resolve().is_relative_to(folder.resolve()):
            raise InputError(f"File of experiment `{record.name}` must lie below the folder, but is {record.file!r}.")
        text = _csv(_columns(record, case))
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, text)
        sections.append(_table("[experiment]", _entry(record, case, text)))
    return write_whole(target, "\n".join(sections))


def _head(case: Case) -> list[str]:
    words = VOCABULARIES[case.device]
    readout = {"scale": _quantity(case.readout.scale, f"{case.readout.unit}/{words.displacement}")}
    if case.readout.adc_range is not None:
        readout["adc_range"] = _quantity(case.readout.adc_range, case.readout.unit)
    top = {"schema": SCHEMA, "name": case.name, "description": case.description, "device": case.device}
    design = {
        key: f"{{ value = {v.value!r}, low = {v.low!r}, high = {v.high!r}, unit = {_text(words.design[key])} }}"
        for key, v in case.design.items()
    }
    around = {
        "temperature": _quantity(case.environment.temperature, "K"),
        "bias_voltage": _quantity(case.environment.bias_voltage, "V"),
    }
    return [
        "\n".join(f"{key} = {_text(value)}" for key, value in top.items()) + "\n",
        _table("design", design),
        _table("readout", readout),
        _table("environment", around),
        _table("conventions", {_text(key): _text(value) for key, value in case.conventions.items()}),
    ]


def _entry(record: AbstractRecord, case: Case, csv: str) -> dict[str, str]:
    entry = {"name": _text(record.name), "kind": _text(record.kind), "file": _text(record.file)}
    entry["sha256"] = _text(hashlib.sha256(csv.encode()).hexdigest())
    if record.role is not None:
        entry["role"] = _text(record.role)
    if record.note:
        entry["note"] = _text(record.note)
    if record.noise_std is not None:
        entry["noise_std"] = _quantity(record.noise_std, case.readout.unit)
    return {**entry, **_settings(record, VOCABULARIES[case.device].force)}


@singledispatch
def _settings(record: AbstractRecord, force: str) -> dict[str, str]:
    raise TypeError(f"no way to write a {type(record).__name__}")


@_settings.register
def _(record: FrequencySweepRecord, force: str) -> dict[str, str]:
    return {"drive_axis": _text("xy"[record.axis]), "settled": "true" if record.settled else "false"}


def _drive(record: RingDownRecord | RateTableRecord, force: str) -> dict[str, str]:
    return {
        "drive_axis": _text("xy"[record.axis]),
        "drive_force": _quantity(record.drive_force, force),
        "drive_frequency": _quantity(record.drive_frequency, "rad/s"),
    }


@_settings.register
def _(record: RingDownRecord, force: str) -> dict[str, str]:
    return {**_drive(record, force), "drive_duration": _quantity(record.drive_duration, "s")}


@_settings.register
def _(record: RateTableRecord, force: str) -> dict[str, str]:
    reference = "calibrated" if record.rate_calibrated else "table"
    cycles = str(record.lock_in_cycles)
    return {**_drive(record, force), "lock_in_cycles": cycles, "rate_reference": _text(reference)}


@_settings.register
def _(record: TimeRecord, force: str) -> dict[str, str]:
    return {"hold": _text(record.hold), "start": _text(record.start)}


@singledispatch
def _columns(record: AbstractRecord, case: Case) -> dict[str, np.ndarray]:
    """Header to column."""
    raise TypeError(f"no way to write a {type(record).__name__}")


@_columns.register
def _(record: FrequencySweepRecord, case: Case) -> dict[str, np.ndarray]:
    words = VOCABULARIES[case.device]
    time = {} if record.time is None else {"t [s]": record.time}
    return {
        **time,
        f"{words.drives[0][record.axis]} [{words.force}]": record.drive,
        "V_bias [V]": record.bias_voltage,
        "T [K]": record.temperature,
        "rate [rad/s]": record.rate,
        "f [rad/s]": record.frequency,
        **_phasors(record.phasors, case),
    }


@_columns.register
def _(record: RingDownRecord, case: Case) -> dict[str, np.ndarray]:
    return {"t [s]": record.time, **_signals(record.signals, case)}


@_columns.register
def _(record: RateTableRecord, case: Case) -> dict[str, np.ndarray]:
    rate = {"rate [rad/s]": record.rate} if record.has_rate else {}
    return {"t [s]": record.time, **rate, **_phasors(record.phasors, case)}


@_columns.register
def _(record: TimeRecord, case: Case) -> dict[str, np.ndarray]:
    words = VOCABULARIES[case.device]
    forces = {f"{name} [{words.force}]": record.forces[:, axis] for axis, name in enumerate(words.forces[0])}
    return {"t [s]": record.time, **forces, **_signals(record.signals, case), "rate [rad/s]": record.rate}


def _signals(signals: np.ndarray, case: Case) -> dict[str, np.ndarray]:
    names = VOCABULARIES[case.device].signals[0]
    return {f"{name} [{case.readout.unit}]": signals[:, c] for c, name in enumerate(names)}


def _phasors(phasors: np.ndarray, case: Case) -> dict[str, np.ndarray]:
    parts = _signals(phasors, case)
    return {
        header.replace(" [", f"_{end} ["): part
        for header, value in parts.items()
        for end, part in (("I", value.real), ("Q", value.imag))
    }


def _csv(columns: dict[str, np.ndarray]) -> str:
    rows = zip(*(map(repr, column.tolist()) for column in columns.values()), strict=True)
    return "\n".join([",".join(columns), *map(",".join, rows)]) + "\n"


def _table(name: str, entries: dict[str, str]) -> str:
    return "\n".join([f"[{name}]", *(f"{key} = {value}" for key, value in entries.items())]) + "\n"


def _quantity(value: float, unit: str) -> str:
    return f"{{ value = {value!r}, unit = {_text(unit)} }}"
