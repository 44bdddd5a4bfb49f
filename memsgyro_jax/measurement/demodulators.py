"""Two demodulators of one lock-in, each saved as a table of its own: the two channels of one record."""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from .formats import SourceColumn, SourceTable
from .two_channels import channel_and_part, two_channels


File = tuple[str, tuple[SourceTable, ...]]  # name of its format, and its tables
_NUMBER = re.compile(r"(?i)(?<![a-z])demod(?:ulator)?s?[^a-z0-9]*(\d+)")
_SAME = 0.8  # gain between two demodulators of one signal, from which two channels are told
_SHARED = ("frequency", "grid", "time", "timestamp")


def demodulators_joined(
    paths: Sequence[Path], files: Sequence[File], alone: Collection[int] = ()
) -> tuple[list[Path], list[File], list[list[int]]]:
    """The files with tables of two demodulators made one each, where their names differ in its number alone, as in
    ``dev1234_demods_0_sample_00000.csv``, and their frequencies or times agree; in the place of the first. Also the
    numbers of the files that each is made of. Those whose numbers are `alone` stay as they are.

    Nothing is joined where three or more go together, for which of them are the channels nobody says, nor where both
    read the same signal.
    """
    groups: dict[tuple[str, str], dict[str, tuple[int, SourceTable]]] = {}
    for place, (_, tables) in enumerate(files):
        for table in tables:
            if place not in alone and (number := _number(table)) is not None:
                groups.setdefault(_without_number(table), {}).setdefault(number, (place, table))
    made: dict[int, SourceTable | None] = {}
    parts = [[place] for place in range(len(files))]
    for group in groups.values():
        if len(group) != 2:
            continue
        (into, first), (out, second) = (group[number] for number in sorted(group, key=int))
        if _is_one_record(first, second) and (joined := _joined(first, second)) is not None:
            made |= {id(first): joined, id(second): None}
            parts[into] = sorted({*parts[into], out})
    left = [(form, tuple(t for table in tables if (t := made.get(id(table), table)))) for form, tables in files]
    kept = [place for place, file in enumerate(left) if file[1]]
    return [paths[k] for k in kept], [left[k] for k in kept], [parts[k] for k in kept]


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


def _joined(first: SourceTable, second: SourceTable) -> SourceTable | None:
    """The columns of the first, and the readings of the second beside its own, by the number of the demodulator; none
    where they are no phasors, or those of one signal.
    """

    def numbered(table: SourceTable) -> list[SourceColumn]:
        names = [f"{column.name} {_number(table)}" for column in table.columns]
        pairs = zip(names, table.columns, strict=True)
        return [replace(column, name=name) for name, column in pairs if channel_and_part(name)[1]]

    readings = [*numbered(first), *numbered(second)]
    channels = two_channels(readings)
    if not channels or _is_one_signal(channels):
        return None
    others = [c for c in first.columns if not channel_and_part(f"{c.name} {_number(first)}")[1]]
    numbers = f"{_number(first)} and {_number(second)}"
    said = (
        f"the readings of demodulators {numbers}, saved apart, are x and y of one record, as their rows agree (each "
        "with a `--map` of its own, they stand alone)"
    )
    assumed = dict.fromkeys((*first.assumed, *second.assumed, said))
    return replace(first, columns=(*others, *readings), assumed=tuple(assumed))


def _is_one_signal(channels: Mapping[str, SourceColumn]) -> bool:
    """Whether the readings of two channels are as large and in step: one signal behind two filters."""
    size = "I" if "I" in channels else "amp"
    a, b = (np.asarray(channels[role].values, float) for role in (size, f"y_{size}"))
    kept = np.isfinite(a) & np.isfinite(b)
    a, b = a[kept], b[kept]
    gain = float(a @ b) / max(float(a @ a), 1e-300)
    return bool(_SAME < gain < 1 / _SAME and np.linalg.norm(b - gain * a) < (1 - _SAME) * np.linalg.norm(b))
