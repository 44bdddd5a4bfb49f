"""Writing a measurement case, in SI, so that reading it again gives the same numbers."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import write_whole
from memsgyro_jax.base.toml import toml_text as _text

from ..declared import QUANTITIES
from ..experiments import AbstractRecord
from .content import Case
from .file import FILE, SCHEMA


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
        text = _csv({**record.columns(case), **_noise(record, case), **record.carried})
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, text)
        sections.append(_table("[experiment]", _entry(record, case, text)))
    return write_whole(target, "\n".join(sections))


def _head(case: Case) -> list[str]:
    words = case.words
    per, seen = words.displacement + case.readout.order * "/s", QUANTITIES[case.readout.order]
    scale = _quantity(case.readout.scale, f"{case.readout.unit}/({per})", case.readout.tolerance)
    readout = {"quantity": _text(seen)}
    # Of two axes in volts nobody told a scale: records are as they are.
    if case.device != "single_mass" or not case.readout.displacement:
        readout["scale"] = scale
    drive = {"unit": _text(words.force)}
    if case.drive is not None and case.drive.tolerance:
        drive["scale"] = _quantity(1.0, f"N/({words.force})", case.drive.tolerance)
    if case.readout.adc_range is not None:
        readout["adc_range"] = _quantity(case.readout.adc_range, case.readout.unit)
    top = {"schema": SCHEMA, "name": case.name, "description": case.description, "device": case.device}
    design = {
        key: "{ unknown = true }"
        if v.unknown
        else f"{{ value = {_number(v.value)}, low = {_number(v.low)}, high = {_number(v.high)}, "
        f"unit = {_text(words.design.get(key, 'kg'))} }}"
        for key, v in case.design.items()
        if key != "static_gain" or case.holds_gain
    }
    around = {
        "temperature": _quantity(case.environment.temperature, "K"),
        "bias_voltage": _quantity(case.environment.bias_voltage, "V"),
    }
    return [
        "\n".join(f"{key} = {_text(value)}" for key, value in top.items()) + "\n",
        _table("design", design),
        _table("readout", readout),
        *([_table("drive", drive)] if case.drive is not None else []),
        _table("environment", around),
        _table("conventions", {_text(key): _text(value) for key, value in case.conventions.items()}),
    ]


def _entry(record: AbstractRecord, case: Case, csv: str) -> dict[str, str]:
    entry: dict[str, Any] = {"name": record.name, "kind": record.kind, "file": record.file}
    entry["sha256"] = hashlib.sha256(csv.encode()).hexdigest()
    if record.role is not None:
        entry["role"] = record.role
    if record.note:
        entry["note"] = record.note
    if record.carried:
        entry["carried"] = [name.rsplit(" [", 1)[0] for name in record.carried]
    if record.noise_std is not None and record.noise_rows is None:
        entry["noise_std"] = {"value": record.noise_std, "unit": case.readout.unit}
    if record.temperature_std:
        entry["temperature_std"] = {"value": record.temperature_std, "unit": "K"}
    return {key: _text(value) for key, value in (entry | record.keys(case)).items()}


def _noise(record: AbstractRecord, case: Case) -> dict[str, np.ndarray]:
    """Columns of the noise of each row."""
    if record.noise_rows is None:
        return {}
    names = case.words.signals[0]
    return {f"{name}_std [{case.readout.unit}]": record.noise_rows[:, c] for c, name in enumerate(names)}


def _csv(columns: dict[str, np.ndarray]) -> str:
    rows = zip(*(map(repr, column.tolist()) for column in columns.values()), strict=True)
    return "\n".join([",".join(columns), *map(",".join, rows)]) + "\n"


def _table(name: str, entries: dict[str, str]) -> str:
    return "\n".join([f"[{name}]", *(f"{key} = {value}" for key, value in entries.items())]) + "\n"


def _quantity(value: float, unit: str, tolerance: float = 0.0) -> str:
    known = f", tolerance = {_number(tolerance)}" if tolerance else ""
    return f"{{ value = {_number(value)}, unit = {_text(unit)}{known} }}"


def _number(value: float) -> str:
    """The shortest text that reads back as the same number; that of NumPy's own kind would name its type."""
    return repr(float(value))
