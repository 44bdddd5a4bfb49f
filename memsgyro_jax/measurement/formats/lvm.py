"""LabVIEW measurement files (.lvm): a header of the file, then one of each segment above its rows.

Specification: National Instruments, "Specification for the LabVIEW Measurement File (.lvm)".
"""

from pathlib import Path

import numpy as np

from memsgyro_jax.base.errors import InputError

from .base import Format, SourceColumn, SourceTable
from .delimited import Dialect, text_of
from .header import split_header, tidy_unit


_END = "***End_of_Header***"
_SEPARATORS = {"Tab": "\t", "Comma": ",", "Semicolon": ";"}


class LabViewText(Format):
    """LabVIEW measurement file."""

    name = "LabVIEW lvm"

    def recognises(self, path: Path, head: bytes) -> bool:
        return head.lstrip(b"\xef\xbb\xbf").startswith(b"LabVIEW Measurement")

    def read(self, path: Path) -> tuple[SourceTable, ...]:
        text, assumed = text_of(path)
        lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
        ends = [n for n, line in enumerate(lines) if line.strip().startswith(_END)]
        if not ends:
            raise InputError(f"{path}: an lvm file must have `{_END}` below its header, but ends before it.")
        head = dict(_pair(line) for line in lines[: ends[0]])
        delimiter = _SEPARATORS.get(head.get("Separator", "Tab"), "\t")
        dialect = Dialect(delimiter, head.get("Decimal_Separator", ".").strip() or ".")
        if len(ends) == 1:  # no segment header: the rows follow at once
            return (_segment(path, "", lines, {}, ends[0] + 1, len(lines), head, dialect, assumed),)
        starts = [*(end + 1 for end in ends[:-1]), len(lines)]
        tables = []
        for number, end in enumerate(ends[1:], 1):
            segment = dict(_fields(line, dialect) for line in lines[starts[number - 1] : end] if line.strip())
            segment.pop("Channels", None)
            stop = _next_header(lines, end + 1)
            name = f"segment {number}" if len(ends) > 2 else ""
            tables.append(_segment(path, name, lines, segment, end + 1, stop, head, dialect, assumed))
        return tuple(tables)


def _pair(line: str) -> tuple[str, str]:
    for separator in "\t,;":
        if separator in line:
            name, _, value = line.partition(separator)
            return name.strip(), value.strip("\t ") or value[:1]
    return line.strip(), ""


def _fields(line: str, dialect: Dialect) -> tuple[str, list[str]]:
    name, *values = dialect.fields(line)
    return name, values


def _next_header(lines: list[str], begin: int) -> int:
    """Where the header of another segment begins: behind the rows stands an empty line."""
    return next((n for n in range(begin, len(lines)) if lines[n].startswith("Channels")), len(lines))


def _segment(path, name, lines, about, begin, stop, head, dialect, assumed) -> SourceTable:
    rows = [(n + 1, dialect.fields(lines[n])) for n in range(begin, stop) if lines[n].strip()]
    if len(rows) < 3:
        raise InputError(f"{path}, line {begin + 1}: a segment must have a line of names and two rows, but has not.")
    names = rows[0][1]
    if dialect.number(names[0]) is not None:
        names, rows = [f"column {k + 1}" for k in range(len(names))], [(0, []), *rows]
    comment = [k for k, n in enumerate(names) if n == "Comment"]
    used = [k for k in range(len(names)) if k not in comment and names[k]]
    values = np.full((len(rows) - 1, len(names)), np.nan)
    for row, (line, fields) in enumerate(rows[1:]):
        for k in used:
            number = dialect.number(fields[k]) if k < len(fields) else None
            if number is None:
                raise InputError(
                    f"{path}, line {line}: a row must have a number below each of {len(used)} names, but has not "
                    f"below `{names[k]}`; the file was cut short or changed."
                )
            values[row, k] = number
    return _table(path, name, names, used, values, about, head, dialect, assumed)


def _table(path, name, names, used, values, about, head, dialect, assumed) -> SourceTable:
    """Columns with their units; where LabVIEW wrote no times, those that `X0` and `Delta_X` say."""
    dimension, unit = about.get("X_Dimension", ["Time"]), about.get("X_Unit_Label", [""])
    x_unit = tidy_unit(_first(unit)) or ("s" if _first(dimension) == "Time" else "Hz")
    x_name = "frequency" if _first(dimension) == "Frequency" else "time" if x_unit == "s" else _first(dimension)
    labels, channel = about.get("Y_Unit_Label", []), 0
    if head.get("X_Columns") == "Multi":  # then every channel has two columns
        labels = labels[::2]
    columns: list[SourceColumn] = []
    for k in used:
        if names[k] == "X_Value":
            empty = not np.isfinite(values[:, k]).any()
            if not empty and not any(c.name == x_name for c in columns):
                columns.append(SourceColumn(x_name, x_unit, values[:, k]))
            continue
        if not np.isfinite(values[:, k]).any():  # a channel without samples
            channel += 1
            continue
        plain, unit_here = split_header(names[k])
        label = tidy_unit(labels[channel]) if channel < len(labels) else ""
        columns.append(SourceColumn(plain, label or unit_here, values[:, k]))
        channel += 1
    if not any(c.name == x_name for c in columns) and "Delta_X" in about:
        step, start = (dialect.number(_first(about.get(key, ["0"]))) or 0.0 for key in ("Delta_X", "X0"))
        columns.insert(0, SourceColumn(x_name, x_unit, start + step * np.arange(len(values))))
    return SourceTable(path, name, tuple(columns), head, tuple(assumed))


def _first(values: list[str]) -> str:
    return next((value for value in values if value), "")
