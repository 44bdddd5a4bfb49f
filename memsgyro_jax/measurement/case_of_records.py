"""The files of a case, written from the records that were imported."""

import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import write_whole
from memsgyro_jax.base.text import listed, printable
from memsgyro_jax.base.toml import toml_table, toml_text
from memsgyro_jax.base.units import parse_header, to_si

from .case import Case, load_case
from .case.file import FILE, SCHEMA
from .case.unknown import OpenDesign
from .imported_record import ImportedRecord


_LOCK_IN = "V(t) = Re[(I + i Q) exp(i w t)] for a drive F cos(w t); amplitudes are peak values"
_ZERO_CELSIUS = 273.15  # K
_ROOM, _NEAR_ROOM = 298.15, 1.0  # K: the temperature of a case that names none, and how near to it is recorded there
_KNOWN = {  # beforehand, of a device of one axis and of two
    False: "resonance, quality_factor, static_gain",
    True: "mass, frequency_x, frequency_y, quality_factor_x, quality_factor_y",
}
_FREQUENCY, _QUALITY = 'value = ..., tolerance = 0.02, unit = "Hz"', 'value = ..., tolerance = 0.5, unit = "1"'
_TO_FILL = {  # where the records do not tell it
    False: {"resonance": _FREQUENCY, "quality_factor": _QUALITY},
    True: {
        "frequency_x": _FREQUENCY,
        "frequency_y": _FREQUENCY,
        "quality_factor_x": _QUALITY,
        "quality_factor_y": _QUALITY,
    },
}


_OF_DECAYS = """\
# resonance and quality_factor as the decays show them; nothing drives, so that there is no static_gain.
# Where [readout] has its scale, mass = { value = 1e-9, tolerance = 0.1, unit = "kg" } gives strengths in newtons,
# with a section [drive] that says unit = "N".
"""


def _csv_of(record: ImportedRecord) -> str:
    """The file of one record."""
    rows = zip(*(map(repr, column.astype(float).tolist()) for column in record.columns.values()), strict=True)
    return "\n".join([",".join(record.columns), *map(",".join, rows)]) + "\n"


def _toml_of(name: str, records: list[ImportedRecord], sources: list[str]) -> str:
    """`case.toml`: what is not known of the device is left out, to be told by the records."""
    two = any(record.two_axes for record in records)
    top = {"schema": SCHEMA, "name": printable(name, 60), "description": f"imported from {listed(sources)}"}
    parts = [
        "\n".join(f"{k} = {toml_text(v)}" for k, v in {**top, "device": "single_mass" if two else "resonator"}.items())
        + "\n"
    ]
    quantity = next((record.quantity for record in records if record.quantity), "displacement")
    parts.append(
        '# displacement, velocity or acceleration; add scale = { value = 1.0, unit = "V/um" } if it is known\n'
        + toml_table("readout", {"quantity": quantity})
    )
    parts.append(_design(records, two))
    parts += _environment(records)
    parts.append(toml_table("conventions", {"lock_in": _LOCK_IN}))
    for record in records:
        entry = {"name": record.name, "kind": record.kind, "file": f"{record.name}.csv", **record.keys}
        if record.kind in ("frequency_sweep", "rate_table", "operating_points"):
            entry["drive_axis"] = record.axis or "x"
        said = [f"# from {record.source}", *(f"# assumed: {sentence}" for sentence in record.assumed)]
        said += [f"# not used: {listed(record.unused)}"] if record.unused else []
        parts.append("\n".join(map(printable, said)) + "\n" + toml_table("[experiment]", entry))
    return "\n".join(parts)


def _environment(records: list[ImportedRecord]) -> list[str]:
    """The bias nearest to none and the temperature nearest to the usual one at which records were taken, where none was
    taken without a bias or there: gains that go with the bias have no meaning beside 0 V, and the numbers of the device
    would hold where nothing was measured.
    """
    entries, said = {}, []
    temperatures = _recorded(records, "T", "K")
    if temperatures is not None and np.all(temperatures > 0) and np.min(np.abs(temperatures - _ROOM)) > _NEAR_ROOM:
        nearest = float(temperatures[np.argmin(np.abs(temperatures - _ROOM))])
        entries["temperature"] = {"value": round(nearest - _ZERO_CELSIUS, 3), "unit": "degC"}
        said.append("temperature")
    biases = _recorded(records, "V_bias", "V")
    if biases is not None and biases.all():
        entries["bias_voltage"] = {"value": float(biases[np.argmin(np.abs(biases))]), "unit": "V"}
        said.append("bias voltage")
    if not said:
        return []
    about = f"# the {' and the '.join(said)} at which the numbers of the device hold, which records give\n"
    return [about + toml_table("environment", entries)]


def _recorded(records: list[ImportedRecord], name: str, unit: str) -> np.ndarray | None:
    """All rows of a column that every record has, in SI; `None` where one has it not."""
    columns = [
        to_si(column, parse_header(header).unit, unit, header)
        for record in records
        for header, column in record.columns.items()
        if parse_header(header).name == name
    ]
    return np.concatenate(columns) if columns and len(columns) == len(records) else None


def _design(records: list[ImportedRecord], two: bool) -> str:
    """Design values where no record is driven in a known way, roughly from the decays themselves."""
    if any(not record.design or record.two_axes for record in records):
        lines = [f"# {key} = {{ {value} }}" for key, value in _TO_FILL[two].items()]
        known = f"# what is known beforehand: {_KNOWN[two]}, as {{ value, tolerance, unit }}"
        return "\n".join([known, "[design]", *lines]) + "\n"
    rough = records[0].design
    entries = {
        key: {"value": value, "low": value / spread, "high": value * spread, "unit": unit}
        for (key, (value, unit)), spread in zip(rough.items(), (1.2, 3.0), strict=True)
    }
    return _OF_DECAYS + toml_table("design", entries)


def write_records(folder: Path, records: list[ImportedRecord], sources: list[str]) -> tuple[Case, list[ImportedRecord]]:
    """The case of some records, written beside the folder, read as a test, and only then moved there; and the records,
    with what their rows correct.

    **Raises:** `InputError` for what cannot be read, and where nothing tells the design, the lines of which are left to
    fill in.
    """
    parent = folder.absolute().parent
    parent.mkdir(parents=True, exist_ok=True)
    beside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=parent))
    try:
        for record in records:
            write_whole(beside / f"{record.name}.csv", _csv_of(record))
        write_whole(beside / FILE, _toml_of(folder.absolute().name, records, sources))
        try:
            better = _as_rows_show(load_case(beside), records)
            if any(one.keys != other.keys for one, other in zip(better, records, strict=True)):
                write_whole(beside / FILE, _toml_of(folder.absolute().name, better, sources))
                load_case(beside)
        except InputError as error:  # of files that the user never sees: named as what they were made from
            said = str(error)
            for record in records:
                said = said.replace(str(beside / f"{record.name}.csv"), f"{record.source} (as a record)")
            said = said.replace(str(beside), str(folder))
            if isinstance(error, OpenDesign):
                _moved(beside, folder)
                said += f" Everything else is written: fill in the lines there, then `memsgyro check {folder}`."
            raise InputError(said) from error
        _moved(beside, folder)
        return load_case(folder), better
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def _as_rows_show(case: Case, records: list[ImportedRecord]) -> list[ImportedRecord]:
    """The records, with what was assumed of a key ("`hold` is ...") corrected where their rows show another."""
    out = []
    for record, read in zip(records, case.records, strict=True):
        keys, told = read.better_keys(case)
        assumed = tuple(one for one in record.assumed if not any(f"(`{key}` is " in one for key in keys))
        record = replace(record, keys={**record.keys, **keys}, assumed=(*assumed, told)) if keys else record
        out.append(record)
    return out


def _moved(beside: Path, folder: Path) -> None:
    """The files of a case put in their place, the one that makes it a case last."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted(beside.iterdir(), key=lambda path: path.name == FILE):
        path.replace(folder / path.name)
