"""What LabOne, the software of Zurich Instruments' lock-in amplifiers, saves as text, and what its fields mean."""

import csv
import re
from pathlib import Path

import numpy as np

from memsgyro_jax.base.errors import InputError

from .base import Format, SourceColumn, SourceTable
from .delimited import Delimited, text_of
from .ticks import CLOCKS, seconds_per_tick


UNITS = {
    "frequency": "Hz", "freq": "Hz", "grid": "Hz", "x": "Vrms", "y": "Vrms", "r": "Vrms", "phase": "rad", "time": "s",
}  # fmt: skip
"""Of a demodulator's fields, as its manual has them: amplitudes are effective values."""
_HEADER = re.compile(r'\A(?P<before>(?:[ \t]*[%#][^\n]*\n)*?)[%#\s]*"?chunk"?\s*[;,]\s*"?timestamp')  # below comments
ASSUMED = "a demodulator's x, y and r are effective values and its phase is in rad, as LabOne saves them"


class LabOneText(Format):
    """CSV of LabOne: a column per field, or (sweeper) a row per field and sweep."""

    name = "LabOne CSV"

    def recognises(self, path: Path, head: bytes) -> bool:
        return _HEADER.search(head.decode("utf-8-sig", "replace")) is not None

    def read(self, path: Path) -> tuple[SourceTable, ...]:
        text, assumed = text_of(path)
        found = _HEADER.search(text)
        first, _, rest = text[found.end("before") if found else 0 :].lstrip("%# \n").partition("\n")
        delimiter = ";" if ";" in first else ","
        names = [name.strip().strip('"').lower() for name in first.split(delimiter)]
        if "fieldname" in names:
            return _rows_to_tables(path, names, list(csv.reader(rest.splitlines(), delimiter=delimiter)), assumed)
        (table,) = Delimited().read(path)
        return demodulated(path, "", {c.name.lower(): c.values for c in table.columns}, _beside(path, table.attributes))


def _rows_to_tables(path: Path, names: list[str], rows: list[list[str]], assumed: list[str]) -> tuple[SourceTable, ...]:
    """Rows `chunk;timestamp;size;fieldname;values…`: a table per chunk."""
    chunks: dict[str, dict[str, np.ndarray]] = {}
    place = names.index("fieldname")
    for line, row in enumerate(rows, 2):
        if not any(row):
            continue
        try:
            size, field = int(float(row[names.index("size")])) if "size" in names else None, row[place]
            values = np.array([float(v) for v in row[place + 1 :] if v.strip()])
            if size is not None and len(values) < size:
                raise ValueError
        except (IndexError, ValueError) as error:
            raise InputError(
                f"{path}, line {line}: a row of a sweep must have chunk, time, size, the name of a field and as many "
                "numbers as its size says, but has not; the file was cut short or changed."
            ) from error
        chunks.setdefault(row[0], {})[field.strip().lower()] = values[:size]
    tables = [
        t
        for k, chunk in chunks.items()
        for t in demodulated(path, f"chunk {k}" if len(chunks) > 1 else "", chunk, {}, assumed)
    ]
    if not tables:
        raise InputError(f"{path}: must hold at least one sweep, but holds none.")
    return tuple(tables)


def _beside(path: Path, attributes) -> dict[str, str]:
    """Attributes, with those of the header file that LabOne writes beside the samples."""
    found = dict(attributes)
    beside = path.with_name(re.sub(r"_(\d+)\.csv$", r"_header_\1.csv", path.name))
    if beside != path and beside.is_file():
        rows = [line.split(";") for line in text_of(beside)[0].splitlines()]
        for name in CLOCKS:
            for row in rows[1:]:
                if name in row[:-1]:
                    found[name] = row[row.index(name) + 1]
            if len(rows) > 1 and name in rows[0]:
                found[name] = rows[1][rows[0].index(name)]
    return found


def demodulated(path: Path, name: str, fields, attributes, assumed=()) -> tuple[SourceTable, ...]:
    """A table of a demodulator's fields: units as LabOne has them, ticks as seconds where the clock is known.

    Fields of another length than the sweep's points are left out; chunks of a file become tables of their own.
    """
    rows = len(next((fields[key] for key in ("frequency", "grid", "x", "timestamp") if key in fields), ()))
    kept = {key: np.asarray(v) for key, v in fields.items() if np.shape(v) == (rows,)}
    if "frequency" in kept and "grid" in kept and np.isfinite(kept["frequency"]).any():
        del kept["grid"]
    if "x" in kept and "freq" in kept:
        kept.pop("phase", None)  # of the oscillator, not of the signal
    base = seconds_per_tick(attributes)
    columns = []
    for key, values in kept.items():
        if key == "chunk":
            continue
        unit = UNITS.get(key, "")
        if key == "timestamp" and values.dtype.kind in "iuf":
            values = values - values[0]
            unit, values = ("s", values * base) if base else ("ticks", values)
            key = "time" if base else key
        columns.append(SourceColumn(key, unit, values))
    if "chunk" not in kept or len(set(kept["chunk"].tolist())) == 1:
        return (SourceTable(path, name, tuple(columns), attributes, (*assumed, ASSUMED)),)
    tables = []
    for chunk in dict.fromkeys(kept["chunk"].tolist()):
        here = kept["chunk"] == chunk
        parts = tuple(SourceColumn(c.name, c.unit, c.values[here]) for c in columns)
        tables.append(SourceTable(path, f"chunk {chunk:g}", parts, attributes, (*assumed, ASSUMED)))
    return tuple(tables)
