"""The files of a case, written from the records that were imported."""

import contextlib
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import write_whole
from memsgyro_jax.base.text import listed, printable
from memsgyro_jax.base.toml import toml_table, toml_text
from memsgyro_jax.base.units import parse_header, to_si

from .case import AbstractRecord, Case, load_case
from .case.file import FILE, SCHEMA
from .case.unknown import OpenDesign
from .declared import QUANTITIES
from .imported_record import ImportedRecord
from .imported_sweep import OPPOSITE
from .opposite_phase import opposite_phase
from .tracking import UNTOLD


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


SPREADS = {"resonance": 1.2, "quality_factor": 3.0}
"""What a number that decays show roughly is written with: the factor from its value to either end of its interval."""
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
        if value < UNTOLD or unit == "Hz"
        else {"unknown": True}
        for (key, (value, unit)), spread in zip(rough.items(), SPREADS.values(), strict=True)
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
        try:
            better = _as_rows_show(beside, folder.absolute().name, records, sources)
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


def _as_rows_show(beside: Path, name: str, records: list[ImportedRecord], sources: list[str]) -> list[ImportedRecord]:
    """The records, with what was assumed of the read-out or of a key ("`hold` is ...") corrected where their rows show
    another; the case is written as they show it, and read as a test.
    """

    def read(known: list[ImportedRecord]) -> Case:
        write_whole(beside / FILE, _toml_of(name, known, sources))
        return load_case(beside)

    untold = any(record.forced for record in records) and not any(record.quantity for record in records)
    shown = records
    try:
        case = read(records)
    except OpenDesign:  # of a wrong quantity no device may be found
        if not untold:
            raise
        shown, case = _of_another_quantity(records, read)
    found = [one.better_quantity(case) for one in case.records] if untold else []
    for quantity, why in [one for one in found if one[0]][:1]:
        shown = _showing(records, quantity, why)
        case = read(shown)
    either = any(one.startswith(OPPOSITE) for record in records for one in record.assumed)
    if either and (quantity := opposite_phase(case.records, case)[1]):
        shown = [_told_by_rows(record, quantity) for record in shown]
        case = read(shown)
    better = [_corrected(record, one, case) for record, one in zip(shown, case.records, strict=True)]
    better = _held_alike(shown, better, case)
    if any(one.keys != other.keys for one, other in zip(better, shown, strict=True)):
        read(better)
    return better


def _of_another_quantity(
    records: list[ImportedRecord], read: Callable[[list[ImportedRecord]], Case]
) -> tuple[list[ImportedRecord], Case]:
    """The records where the read-out shows the first quantity but displacement of which they tell a device, and their
    case. **Raises:** `OpenDesign`, the case as it was, where they tell none.
    """
    for quantity in QUANTITIES[1:]:
        others = _showing(records, quantity, f"the read-out shows {quantity}: of displacements they tell no device")
        with contextlib.suppress(OpenDesign):
            return others, read(others)
    return records, read(records)


def _showing(records: list[ImportedRecord], quantity: str, why: str) -> list[ImportedRecord]:
    """The records, those under recorded forces showing a quantity, as a sentence says why."""
    return [
        replace(record, quantity=quantity, assumed=(*record.assumed, why)) if record.forced else record
        for record in records
    ]


def _told_by_rows(record: ImportedRecord, quantity: str) -> ImportedRecord:
    """A record of which the phase leaves two quantities, with the one that the rows show."""
    sign = " with an inverted sign" if quantity == "displacement" else ""
    said = f"the read-out shows {quantity}{sign}: its rows lie far nearer to a device then"
    assumed = tuple(said if one.startswith(OPPOSITE) else one for one in record.assumed)
    return replace(record, quantity=quantity, assumed=assumed)


def _corrected(record: ImportedRecord, read: AbstractRecord, case: Case) -> ImportedRecord:
    """A record with the keys that its rows show."""
    keys, told = read.better_keys(case)
    if not keys:
        return record
    assumed = tuple(one for one in record.assumed if not any(f"(`{key}` is " in one for key in keys))
    return replace(record, keys={**record.keys, **keys}, assumed=(*assumed, told))


def _held_alike(shown: list[ImportedRecord], better: list[ImportedRecord], case: Case) -> list[ImportedRecord]:
    """The records, those whose force was taken to run otherwise held as that of the others was, of which the rows show
    it, where their own rows do not say the reverse: one instrument took them all.
    """
    holds = {one.keys.get("hold") for one, old in zip(better, shown, strict=True) if one.keys != old.keys} - {None}
    if len(holds) != 1:
        return better
    (hold,) = holds
    out = []
    for one, read in zip(better, case.records, strict=True):
        if one.keys.get("hold", hold) != hold and not replace(read, hold=hold).better_keys(case)[0]:  # type: ignore[call-arg]
            assumed = tuple(told for told in one.assumed if "(`hold` is " not in told)
            told = f"its force ran as that of the other captures, of which the rows show it (`hold` is {hold})"
            one = replace(one, keys={**one.keys, "hold": hold}, assumed=(*assumed, told))
        out.append(one)
    return out


def _moved(beside: Path, folder: Path) -> None:
    """The files of a case put in their place, the one that makes it a case last."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted(beside.iterdir(), key=lambda path: path.name == FILE):
        path.replace(folder / path.name)
