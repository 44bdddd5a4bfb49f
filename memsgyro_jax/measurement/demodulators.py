"""Two demodulators of one lock-in, each saved as a table of its own: the two channels of one record."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from .formats import SourceColumn, SourceTable
from .two_channels import channel_and_part


File = tuple[str, tuple[SourceTable, ...]]  # name of its format, and its tables
_NUMBER = re.compile(r"(?i)(?<![a-z])demod(?:ulator)?s?[^a-z0-9]*(\d+)")
_SHARED = ("frequency", "grid", "time", "timestamp")


def demodulators_joined(paths: Sequence[Path], files: Sequence[File]) -> tuple[list[Path], list[File]]:
    """The files with tables of two demodulators made one each, where their names differ in its number alone, as in
    ``dev1234_demods_0_sample_00000.csv``, and their frequencies or times agree; in the place of the first.

    Nothing is joined where three or more go together, for which of them are the channels nobody says.
    """
    groups: dict[tuple[str, str], dict[str, SourceTable]] = {}
    for _, tables in files:
        for table in tables:
            if (number := _number(table)) is not None:
                groups.setdefault(_without_number(table), {}).setdefault(number, table)
    made: dict[int, SourceTable | None] = {}
    for group in groups.values():
        if len(group) == 2:
            first, second = (group[number] for number in sorted(group, key=int))
            if _is_one_record(first, second):
                made |= {id(first): _joined(first, second), id(second): None}
    left = [(form, tuple(t for table in tables if (t := made.get(id(table), table)))) for form, tables in files]
    kept = [(path, file) for path, file in zip(paths, left, strict=True) if file[1]]
    return [path for path, _ in kept], [file for _, file in kept]


def _place(table: SourceTable) -> str:
    return f"{table.path.stem} {table.name}"


def _number(table: SourceTable) -> str | None:
    """Of the demodulator, as the name of its file or its place in one says."""
    numbers = {found[1] for found in _NUMBER.finditer(_place(table))}
    return numbers.pop() if len(numbers) == 1 else None


def _without_number(table: SourceTable) -> tuple[str, str]:
    return str(table.path.parent), _NUMBER.sub("demod", _place(table))


def _is_one_record(first: SourceTable, second: SourceTable) -> bool:
    """Whether both have the same fields, and at least one of those that channels share, with the same values."""
    a, b = ({column.name.lower(): column.values for column in table.columns} for table in (first, second))
    shared = [name for name in _SHARED if name in a]
    if {*a} != {*b} or not shared:
        return False
    return all(a[n].shape == b[n].shape and np.allclose(a[n], b[n], rtol=1e-9, equal_nan=True) for n in shared)


def _joined(first: SourceTable, second: SourceTable) -> SourceTable:
    """The columns of the first, and the readings of the second beside its own, by the number of the demodulator."""

    def numbered(table: SourceTable) -> list[SourceColumn]:
        names = [f"{column.name} {_number(table)}" for column in table.columns]
        pairs = zip(names, table.columns, strict=True)
        return [replace(column, name=name) for name, column in pairs if channel_and_part(name)[1]]

    others = [c for c in first.columns if not channel_and_part(f"{c.name} {_number(first)}")[1]]
    numbers = f"{_number(first)} and {_number(second)}"
    said = f"the readings of demodulators {numbers}, saved apart, are x and y of one record, as their rows agree"
    columns = (*others, *numbered(first), *numbered(second))
    return replace(first, columns=columns, assumed=tuple(dict.fromkeys((*first.assumed, *second.assumed, said))))
