"""What the columns of a rate-table test are: by their units, their names, or as the user says."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table
from memsgyro_jax.base.text import listed, suggestion
from memsgyro_jax.base.units import parse_header

from .log_table import log_table


_APPLIED = re.compile(
    r"table|command|applied|input|reference|\bref|set ?point|stimul|encoder|true|tisch|drehzahl|soll", re.I
)
_PUT_OUT = re.compile(r"out|gyro|sensor|dut|uut|meas|signal|reading|response|ausgang|kreisel", re.I)
_SCATTER = re.compile(r"\b(std|stdev|stddev|sd|sigma|rms|noise|deviation)\b", re.I)
_RUN = re.compile(r"\b(run|turn on|power on|sequence|cycle|repeat|lauf)\b", re.I)
_TEMPERATURE = re.compile(r"^T$|\b[tT]emp|°")
_A_MINUTE = re.compile(r"(1/min|min *(\^ *|\*\* *)?(-1|⁻¹))")  # of a table's rate, turns
_DIRECTION = re.compile(r"\b(dir|direction|sense|richtung)\b", re.I)


class TableColumns(NamedTuple):
    """Names of the columns by what they mean; `None` where there is none."""

    rate: str
    output: str
    time: str | None
    scatter: str | None
    run: str | None
    direction: str | None
    temperature: str | None
    voltage: str | None
    unused: tuple[str, ...]


def table_of(source: Any) -> Table:
    """A CSV file, or a mapping of headers such as "rate [deg/s]" to numbers, as a frame of pandas is one.

    Raises:
        InputError: for what `log_table` refuses, and columns that are not finite numbers of one length.
    """
    if isinstance(source, str | Path):
        return _in_turns(log_table(source))
    try:
        columns = {str(name): np.asarray(source[name], float) for name in source}
    except (AttributeError, TypeError, ValueError) as error:
        raise InputError(
            'Argument `source` must be a file, or columns by headers such as "rate [deg/s]", but is of type '
            f"{type(source).__name__}."
        ) from error
    lengths = {values.shape for values in columns.values()}
    fits = len(lengths) == 1 and all(v.ndim == 1 and len(v) > 1 and np.isfinite(v).all() for v in columns.values())
    if not fits:
        raise InputError("Argument `source` must hold columns of finite numbers, two or more, all equally many.")
    headers = [parse_header(name) for name in columns]
    named = {header.name: values for header, values in zip(headers, columns.values(), strict=True)}
    units = {header.name: header.unit for header in headers}
    return _in_turns(Table(Path("source"), named, units, np.arange(1, len(next(iter(columns.values()))) + 1)))


def _in_turns(table: Table) -> Table:
    """The table with `rpm` for 1/min, in which many rate tables tell their rate, and which is no angle in SI."""
    units = {name: "rpm" if _A_MINUTE.fullmatch(unit) else unit for name, unit in table.units.items()}
    return replace(table, units=units)


def columns_of_test(table: Table, rate: str | None, output: str | None) -> TableColumns:
    """Which column is what; `rate` and `output` are as the user says.

    Raises:
        InputError: with the file and its columns where none or several may be the rate of the table or the output.
    """
    for option, name in (("rate_column", rate), ("output_column", output)):
        if name is not None and name not in table.columns:
            raise InputError(
                f"{table.path}: argument `{option}` must name a column, but there is no `{name}`; "
                f"{suggestion(name, table.columns, every=True)}."
            )
    left = [name for name in table.columns if name not in (rate, output)]

    def take(found: list[str]) -> str | None:
        if found:
            left.remove(found[0])
        return found[0] if found else None

    scatter = take([name for name in left if _SCATTER.search(_words(name))])
    time = take([name for name in left if measures(table, name, "s")])
    temperature = take([name for name in left if measures(table, name, "K")])
    for name in left:
        if _TEMPERATURE.search(_words(name)):
            table.si(name, "K")  # whose error says how degrees are written
    run = take([name for name in left if table.units[name] == "1" and _RUN.search(_words(name))])
    direction = take([name for name in left if table.units[name] == "1" and _DIRECTION.search(_words(name))])
    rate = rate or take(_rates(table, left, output))
    if rate is None:
        raise _unclear(table, 'the rate of the table, such as "table rate [deg/s]"', "rate")
    found = [output] if output else _outputs(table, left)
    if len(found) != 1:
        what = "the gyro's output" if found else 'the gyro\'s output, such as "output [V]"'
        raise _unclear(table, what, "output", found)
    if output is None:
        left.remove(found[0])
    voltage = take([name for name in left if "bias" in _words(name).lower() and measures(table, name, "V")])
    return TableColumns(rate, found[0], time, scatter, run, direction, temperature, voltage, tuple(left))


def measures(table: Table, name: str, unit: str) -> bool:
    """Whether a column is of a unit's kind; a unit that nobody knows, such as LSB, is of no kind."""
    try:
        table.si(name, unit)
    except InputError:
        return False
    return True


def _words(name: str) -> str:
    return re.sub(r"[_\-.]+", " ", name)


def _rates(table: Table, left: list[str], output: str | None) -> list[str]:
    """The column of the table's rate: the only one of a rate, or the one that is named so."""
    rates = [name for name in left if measures(table, name, "rad/s")]
    if len(rates) == 1:
        others = [name for name in left if name not in rates]
        return rates if output or _PUT_OUT.search(_words(rates[0])) is None or not others else []
    named = [name for name in rates if _APPLIED.search(_words(name)) and not _PUT_OUT.search(_words(name))]
    rest = [name for name in rates if not _PUT_OUT.search(_words(name))]
    return named if len(named) == 1 else rest if len(rest) == 1 else []


def _outputs(table: Table, left: list[str]) -> list[str]:
    """Columns that may be the output: those named so, or else all that are left but a bias voltage."""
    named = [name for name in left if _PUT_OUT.search(_words(name))]
    plain = [name for name in left if not ("bias" in _words(name).lower() and measures(table, name, "V"))]
    return named if len(named) == 1 else plain or left


def _unclear(table: Table, what: str, option: str, found: list[str] | None = None) -> InputError:
    columns = listed((f"{name} [{unit}]" for name, unit in table.units.items()), "`")
    several = f"{listed(found, '`')} may all be it" if found else "none can be told to be it"
    return InputError(
        f"{table.path}: a rate-table test must have one column of {what}, but of {columns} {several}; say which "
        f"(`{option}_column`, `--{option}-column`)."
    )
