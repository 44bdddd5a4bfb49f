"""CSV files of numbers whose header names each column with its unit, read so that nothing is silently wrong."""

import csv
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .errors import InputError
from .files import LARGEST_TABLE, read_text
from .text import first_of, printable
from .units import decimal, parse_header, to_si


_DIGITS, _ZERO = re.compile(r"[0-9eE+\-.,]*"), re.compile(r"[+-]?[0.]+([eE].*)?")  # most files hold nothing else
_DECIMAL_COMMA = "; is the decimal mark a comma? Write decimals with a point"


@dataclass(frozen=True)
class Table:
    """A CSV file of numbers: columns in the unit of the header, and the line on which each row stands.

    Args:
        path: of the file.
        columns: name to numbers, shape (rows,), in the column's own unit.
        units: name to unit text.
        lines: line number of each row in the file, counted from 1.
    """

    path: Path
    columns: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    lines: np.ndarray

    def si(self, name: str, expected: str) -> np.ndarray:
        """A column in the SI unit `expected`; raises `InputError` where the header's unit measures something else."""
        return to_si(self.columns[name], self.units[name], expected, f"column `{name}` of {self.path}")

    def at(self, row: int, name: str, what: str) -> InputError:
        """The error that the value in `row` (from 0) of column `name` calls for; `what` must hold instead."""
        value = self.columns[name][row]
        return InputError(f"{self.path}, line {self.lines[row]}, column `{name}`: the value {what}, but is {value:g}.")


class _Line(NamedTuple):
    number: int
    fields: list[str]


def read_table(path: str | Path) -> Table:
    """Reads a comma-separated file of finite numbers below a header like ``t [s],rate [deg/s]``.

    Lines that are empty or start with `#` are skipped.

    Raises:
        InputError: one sentence with file, line and column for a missing unit, a column named twice, a semicolon or a
            decimal comma, NaN or text in place of a number, a row of another length, or fewer than two rows.
    """
    path = Path(path)
    text = read_text(path, "file", most=LARGEST_TABLE)
    lines = _lines(path, text)
    if len(lines) < 3:
        raise InputError(
            f"{path}: the file must hold a header and at least two rows of numbers, but holds {len(lines)} lines."
        )
    header = _header(path, lines[0])
    names = list(header)
    values = _plain(lines[1:], len(names))
    values = np.array(_rows(path, lines[1:], names)) if values is None else values
    _refuse_cut_end(path, text, lines)
    columns = {name: values[:, place] for place, name in enumerate(names)}
    return Table(path, columns, header, np.array([line.number for line in lines[1:]]))


def _lines(path: Path, text: str) -> list[_Line]:
    # Only what ends a line for an editor: `splitlines` would also end one at a form feed.
    every = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    kept = [(n, line) for n, line in enumerate(every, 1) if line.strip() and not line.startswith("#")]
    if kept and re.search(r"[;\t]", kept[0][1]):
        raise InputError(
            f"{path}, line {kept[0][0]}: columns must be separated by commas and decimals written with a point, "
            "but the header has semicolons or tabs; export it again as comma-separated, or let `memsgyro import` "
            "read the files of an instrument as they are."
        )
    return [_Line(number, _fields(path, number, line)) for number, line in kept]


def _fields(path: Path, number: int, line: str) -> list[str]:
    if _DIGITS.fullmatch(line):  # as the reader below would, which is made anew for every line
        return line.split(",")
    try:
        return next(csv.reader([line], skipinitialspace=True, strict=True))
    except csv.Error as error:
        raise InputError(f"{path}, line {number}: the row is not comma-separated text ({error}).") from error


def _header(path: Path, line: _Line) -> dict[str, str]:
    header: dict[str, str] = {}
    for place, field in enumerate(line.fields, 1):
        where = f"{path}, line {line.number}, column {place}"
        try:
            column = parse_header(field)
        except InputError as error:
            raise InputError(f"{where}: {error}") from error
        if column.name in header:
            raise InputError(f"{where}: a column must be named once, but `{column.name}` stands twice; remove one.")
        header[column.name] = column.unit
    return header


def _plain(lines: list[_Line], width: int) -> np.ndarray | None:
    """The rows at once, where all are numbers that no rule of `decimal` can be against; else `None`."""
    if any(len(line.fields) != width for line in lines):
        return None
    fields = [field for line in lines for field in line.fields]
    if _DIGITS.fullmatch(",".join(fields)) is None:
        return None
    try:
        values = np.array(list(map(float, fields)))
    except ValueError:
        return None
    # A zero may be what is left of a number too small.
    zeros_alone = all(_ZERO.fullmatch(fields[place]) for place in np.flatnonzero(values == 0.0))
    return values.reshape(len(lines), width) if zeros_alone and np.isfinite(values).all() else None


def _rows(path: Path, lines: list[_Line], names: list[str]) -> list[list[float]]:
    rows, wrong = [], []
    for line in lines:
        try:
            rows.append(_row(line, names))
        except ValueError as error:
            wrong.append(f"line {line.number}{error}")
    if wrong:
        raise InputError(f"{path}{', ' if len(wrong) == 1 else ': '}{first_of(wrong, 'rows')}.")
    return rows


def _row(line: _Line, names: list[str]) -> list[float]:
    if len(line.fields) != len(names):
        hint = _DECIMAL_COMMA if len(line.fields) > len(names) else "; the row is cut short"
        raise ValueError(f": the row must have {len(names)} fields like the header, but has {len(line.fields)}{hint}")
    return [_number(name, field) for name, field in zip(names, line.fields, strict=True)]


def _number(name: str, field: str) -> float:
    text = field.strip()
    try:
        return decimal(text)
    except ValueError as error:
        hint = _DECIMAL_COMMA if re.fullmatch(r"[+-]?\d+,\d+", text) else "; mend or remove the row"
        raise ValueError(f", column `{printable(name, 60)}`: the value {error}{hint}") from error


def _refuse_cut_end(path: Path, text: str, lines: list[_Line]) -> None:
    """A copy that broke off leaves a last line without its end, whose last number is then plausible and wrong."""
    if text.endswith(("\n", "\r")):
        return
    if len(lines[-1].fields[-1]) < min(len(line.fields[-1]) for line in lines[1:-1]):
        raise InputError(
            f"{path}, line {lines[-1].number}: the file must end with a whole row, but breaks off within its last "
            "number; copy it again or remove the line."
        )
