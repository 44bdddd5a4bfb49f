"""Columns of numbers as text: any delimiter, decimal point or comma, with what stands above them."""

import csv
import itertools
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import LARGEST_TABLE, read_whole
from memsgyro_jax.base.text import printable
from memsgyro_jax.base.units import NUMBER

from .base import Format, SourceColumn, SourceTable
from .header import split_header, tidy_unit
from .ticks import in_seconds


_SAMPLE = 2000  # lines by which the dialect is told
_COMMENT = re.compile(r"^\s*(?:#|%|//|!|\*)+\s?")
_PAIR = re.compile(r"^\s*([^:=,;\t]{1,60}?)\s*[:=,;\t]\s*(\S.*?)[\s,;]*$")
_UNIT_FIRST = re.compile(r"^\[\s*([^\[\]]+?)\s*\]\s*(\w*)$")  # a line of units with a part of the name behind each
_MOMENT = re.compile(
    r"(?:(?P<day>\d{4}-\d\d-\d\d|\d+[/.]\d+[/.]\d+)(?:T| +))?(?P<clock>\d{1,2}:\d\d:\d\d)(?P<part>[.,]\d+)?Z?"
)
_NUMBERED = re.compile(r"X,.+,Start,Increment,?", re.I)
_POINT = re.compile(NUMBER)
_COMMA = re.compile(NUMBER.replace(r"\.", ","))
_MISSING = {"", "nan", "-nan", "1.#qnan", "nan(ind)", "-nan(ind)", "inf", "+inf", "-inf", "--", "n/a", "na", "1.#inf"}


@dataclass(frozen=True)
class Dialect:
    """How fields are told apart (`None`: by blanks) and decimals written."""

    delimiter: str | None
    mark: str

    def fields(self, line: str) -> list[str]:
        """The fields of a line, without blanks around them."""
        if self.delimiter is None:
            return line.split()
        if line and '"' not in line:
            return [part.strip() for part in line.split(self.delimiter)]
        parts = next(csv.reader([line], delimiter=self.delimiter, skipinitialspace=True), [])
        return [part.strip() for part in parts]

    def number(self, field: str) -> float | None:
        """The number that a field holds, not a number for none, `None` for words."""
        if (_POINT if self.mark == "." else _COMMA).fullmatch(field):
            return float(field.replace(",", "."))
        return np.nan if field.lower() in _MISSING else None

    def numbers(self, width: int) -> re.Pattern[str]:
        """What a line of that many numbers and nothing else matches, in one go."""
        number = rf"(?>{(_POINT if self.mark == '.' else _COMMA).pattern})"
        apart = rf"\s+{number}" if self.delimiter is None else rf" *{re.escape(self.delimiter)} *{number}"
        return re.compile(rf" *{number}(?:{apart}){{{width - 1}}} *")

    def mask(self, fields: list[str]) -> tuple[bool, ...]:
        """Which fields are numbers or missing."""
        return tuple(self.number(field) is not None for field in fields)

    @property
    def words(self) -> str:
        """For people."""
        names = {";": "semicolons", "\t": "tabs", ",": "commas", "|": "bars", None: "blanks"}
        return f"columns separated by {names[self.delimiter]}, decimal {'point' if self.mark == '.' else 'comma'}"


DIALECTS = [Dialect(d, mark) for d, mark in itertools.product((";", "\t", "|", None), ".,")] + [Dialect(",", ".")]


class Delimited(Format):
    """CSV, TSV and their relatives."""

    name = "text table"

    def recognises(self, path: Path, head: bytes) -> bool:
        return decoded(head) is not None

    def read(self, path: Path) -> tuple[SourceTable, ...]:
        text, assumed = text_of(path)
        lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
        return (table_of_lines(path, _without_settings(lines), assumed),)


def _without_settings(lines: list[str]) -> list[str]:
    """Lines of an oscilloscope that writes its settings in three columns beside time and signal, these two with the
    units that the settings name, or numbers its samples and names their distance; other lines as they are.
    """
    if _NUMBERED.fullmatch(lines[0].strip()) and len(lines) > 2:
        return _timed_by_number(lines)
    if not lines[0].startswith("Record Length,"):
        return lines
    cells = [line.rstrip(",").split(",") for line in lines if line.strip(",")]
    if any(len(row) != 5 for row in cells):
        return lines
    told = {row[0].strip(): row[1].strip().strip('"') for row in cells}
    across, up = (told.get(f"{axis} Units") or usual for axis, usual in (("Horizontal", "s"), ("Vertical", "V")))
    head = f"time [{across}],{told.get('Source') or 'signal'} [{up}]"
    return [head, *(",".join(row[3:]) for row in cells)]


def _timed_by_number(lines: list[str]) -> list[str]:
    """Lines with times in place of the numbers of samples, by the start and the increment of the second line."""
    names = lines[0].strip().rstrip(",").split(",")[1:-2]
    units = lines[1].strip().rstrip(",").split(",")
    try:
        begin, step = map(float, units[-2:])
        cells = [line.split(",") for line in lines[2:] if line.strip(", ")]
        times = [begin + step * float(row[0]) for row in cells]
    except (ValueError, IndexError):
        return lines
    head = [f"{name} [{unit.strip().title()}]" for name, unit in zip(names, units[1:], strict=False)]
    rows = [",".join([f"{t:.12g}", *row[1 : 1 + len(names)]]) for t, row in zip(times, cells, strict=True)]
    return [",".join(["time [s]", *head]), *rows]


def decoded(data: bytes) -> tuple[str, str] | None:
    """The text that bytes mean and its encoding, or `None` where they are no text."""
    odd = data[1::2].count(0), data[::2].count(0)
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        guesses = ["utf-16"]
    elif max(odd) > len(data) // 4:
        guesses = ["utf-16-le" if odd[0] > odd[1] else "utf-16-be"]
    else:
        guesses = ["utf-8-sig", "cp1252", "latin-1"]
    for encoding in guesses:
        try:
            text = data[: len(data) // 2 * 2 if "16" in encoding else None].decode(encoding)
        except UnicodeDecodeError as error:
            if encoding != "utf-8-sig" or error.start < len(data) - 4:
                continue
            text = data[: error.start].decode(encoding)  # a letter cut at the end of what was read
        return None if re.search(r"[\x00-\x08\x0e-\x1b\x7f]", text) else (text, encoding)
    return None


def text_of(path: Path) -> tuple[str, list[str]]:
    """The text of a file in any encoding that instruments use, and what was assumed."""
    found = decoded(read_whole(path, "file", most=LARGEST_TABLE))
    if found is None:
        raise InputError(f"{printable(str(path))}: must be text or a format that is known, but is neither.")
    text, encoding = found
    return text, [] if encoding == "utf-8-sig" else [f"the text is in {encoding}"]


def table_of_lines(path: Path, lines: list[str], assumed: list[str], first: int = 0) -> SourceTable:
    """The table in the lines of a text from line `first` (from 0) on."""
    bare = [_COMMENT.sub("", line) if _COMMENT.match(line) else line for line in lines]
    data = [n for n in range(first, len(lines)) if lines[n].strip() and not _COMMENT.match(lines[n])]
    if not data:
        raise InputError(f"{printable(str(path))}: must hold rows of numbers, but holds none.")
    dialect, mask = _dialect(path, [lines[n] for n in data[:_SAMPLE]])
    begin = _first_row([lines[n] for n in data], dialect, mask)
    above, header = _above(bare[first : data[begin]], dialect, len(mask))
    repeated = {lines[n].strip() for n in range(first, data[begin])}
    rows, read = [], []
    usual = dialect.numbers(len(mask)) if all(mask) else None
    for n in data[begin:]:
        bare_line = lines[n].strip()
        if bare_line in repeated:
            continue
        if bare_line.upper() == "END":
            break
        if usual and usual.fullmatch(lines[n]):
            fields = lines[n].split(dialect.delimiter)
            held = [float(field.replace(",", ".")) for field in fields]
        else:
            fields = dialect.fields(lines[n])
            held = [dialect.number(field) if m else field for m, field in zip(mask, fields, strict=False)]
            if len(fields) != len(mask) or None in held:
                raise _broken(path, n + 1, fields, mask, last=n == data[-1])
        rows.append(fields)
        read.append(held)
    if len(rows) < 2:
        raise InputError(f"{printable(str(path))}: must hold at least two rows of numbers, but holds {len(rows)}.")
    columns = []
    for place, is_number in enumerate(mask):
        cells = [row[place] for row in rows]
        if place == len(mask) - 1 and not any(cells):  # a delimiter at the end of each row
            continue
        values = np.array([row[place] for row in read], float) if is_number else np.array(cells)
        name, unit = header[place] if header else (f"column {place + 1}", "")
        columns.append(SourceColumn(name or f"column {place + 1}", unit, values))
    said = assumed if dialect == DIALECTS[-1] else [*assumed, dialect.words]
    return SourceTable(path, "", tuple(_timed(in_seconds(columns, above))), above, tuple(said))


def _first_row(lines: list[str], dialect: Dialect, mask: tuple[bool, ...]) -> int:
    """The line at which the table begins: the first that reads like its rows, but not one alone above new names of the
    columns, as the steps of waveforms are.
    """
    like = [k for k, line in enumerate(lines[:_SAMPLE]) if dialect.mask(dialect.fields(line)) == mask]
    first = like[0]
    if first + 1 in like or len(like) < 2:
        return first
    below = dialect.fields(lines[first + 1])
    named = len(below) == len(mask) and not any(dialect.mask(below)) and lines[first + 1] not in lines[:first]
    return first + 2 if named and first + 2 in like else first


def _timed(columns: list[SourceColumn]) -> list[SourceColumn]:
    """Columns with the moments of a calendar or a clock as seconds since the first, where no other counts time."""
    units = ("s", "ms", "us", "µs", "min", "ticks")
    if any(c.unit in units or (c.name.lower() in ("t", "time") and c.values.dtype.kind == "f") for c in columns):
        return columns
    return [c if (t := _seconds(c.values)) is None else SourceColumn(c.name, "s", t) for c in columns]


def _seconds(words: np.ndarray) -> np.ndarray | None:
    """Seconds since the first of moments; `None` for other words, and for several days of which nobody knows whether
    the month stands first.
    """
    found = [_MOMENT.fullmatch(word) for word in words.tolist()] if words.dtype.kind == "U" else [None]
    if not all(found):
        return None
    days = [one["day"] or "1970-01-01" for one in found if one]
    if "-" not in days[0]:
        days = ["1970-01-01"] * len(days) if len({*days}) == 1 else days
    clock = [one["clock"].rjust(8, "0") + (one["part"] or "").replace(",", ".") for one in found if one]
    try:
        moments = np.array([f"{day}T{time}" for day, time in zip(days, clock, strict=True)], "datetime64[ns]")
    except ValueError:  # no such day or hour
        return None
    seconds = (moments - moments[0]) / np.timedelta64(1, "s")
    night = 86400.0 * np.cumsum(np.diff(seconds, prepend=0.0) < 0) * (found[0]["day"] is None if found[0] else 0)
    return np.asarray(seconds + night)


def _dialect(path: Path, lines: list[str]) -> tuple[Dialect, tuple[bool, ...]]:
    """The dialect in which most fields of one run of rows are numbers, and which columns these are."""
    best: tuple[float, Dialect, tuple[bool, ...]] | None = None
    for dialect in DIALECTS:
        if dialect.delimiter and not any(dialect.delimiter in line for line in lines):
            continue  # a row of one field is none
        cells = [dialect.fields(line) for line in lines]
        kinds = [(dialect.mask(row), sum(_MOMENT.fullmatch(field) is not None for field in row)) for row in cells]
        for (mask, moments), group in itertools.groupby(kinds):
            score = len(list(group)) * (2 * (sum(mask) + moments) - len(mask))
            if len(mask) > 1 and any(mask) and (best is None or score > best[0]):
                best = score, dialect, mask
    if best is None or best[0] <= 0:
        raise InputError(
            f"{printable(str(path))}: must hold rows of at least two numbers, separated by commas, semicolons, tabs or "
            "blanks, but holds none."
        )
    return best[1], best[2]


def _above(lines: list[str], dialect: Dialect, width: int) -> tuple[dict[str, str], list[tuple[str, str]]]:
    """What the lines above the rows say: attributes, and name and unit of each column (none where there is no header).

    The header is the last line of as many fields as the rows have; a line of units may follow it.
    """
    cut = [(line, _fitting(line, dialect, width)) for line in lines if line.strip()]
    places = [n for n, (_, fields) in enumerate(cut) if fields]
    header: list[tuple[str, str]] = []
    if places:
        last = cut[places[-1]][1]
        units = [tidy_unit(field.strip("[]()")) for field in last]
        if len(places) > 1 and all(parts := [_UNIT_FIRST.match(field) for field in last]):
            names = [split_header(name)[0] for name in cut[places[-2]][1]]
            found = [(name, *part.groups()) for name, part in zip(names, parts, strict=True) if part]
            header, places = [(f"{name} {more}".strip(), tidy_unit(unit)) for name, unit, more in found], places[-2:]
        elif len(places) > 1 and all(u or not f.strip() for u, f in zip(units, last, strict=True)) and any(units):
            names = cut[places[-2]][1]
            header = [(split_header(name)[0], unit) for name, unit in zip(names, units, strict=True)]
            places = places[-2:]
        else:
            header = [split_header(field) for field in last]
            places = places[-1:]
    pairs = [_PAIR.match(line) for n, (line, _) in enumerate(cut) if n not in places]
    return {pair[1].strip().strip('"'): pair[2].strip().strip('"') for pair in pairs if pair}, header


def _fitting(line: str, dialect: Dialect, width: int) -> list[str]:
    """The fields of a line above the rows if there are as many as in a row."""
    splits = [dialect.fields(line)]
    if dialect.delimiter is None:
        splits += [re.split(r"\s{2,}|\t", line.strip()), re.split(r"(?<=[\])])\s+", line.strip()), line.split(",")]
    for fields in splits:
        if len(fields) == width and not all(dialect.mask(fields)):
            return [field.strip() for field in fields]
    return []


def _broken(path: Path, line: int, fields: list[str], mask: tuple[bool, ...], last: bool) -> InputError:
    found = f"has {len(fields)}" if len(fields) != len(mask) else "has words where they have numbers"
    hint = "the file was cut short; save it again, or remove the line" if last else "mend or remove it"
    return InputError(
        f"{printable(str(path))}, line {line}: a row must have {len(mask)} fields like those before, but {found}; "
        f"{hint}."
    )
