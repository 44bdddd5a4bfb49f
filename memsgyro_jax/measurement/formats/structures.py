"""Readings in structures beside the frequency or time that they share, as scripts save them: `sweep.frequency` and
`sweep.demod1.x`.
"""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np


_RUNS = re.compile(r"(?i)(?:f|freq|frequency|frequencies|grid|t|time|timestamp)(?:[_ (\[].*)?")
_BESIDE = re.compile(r"(?i)(?:drive|level|excit|temp|bias|settling|bandwidth|tc$|order).*|T|V_?dc")  # no readings
_CHANNEL = re.compile(r"\d+|(?<![a-z])v?[xy](?![a-z])")


class Leaf:
    """Numbers of a tree and their unit; of a matrix, where that is told, names and units of its columns."""

    def __init__(
        self, values: np.ndarray, unit: str = "", names: tuple[str, ...] = (), units: tuple[str, ...] = ()
    ) -> None:
        self.values, self.unit, self.names, self.units = values, unit, names, units


Placed = list[tuple[str, Mapping[str, Leaf]]]  # columns by name, with the place that stands before their names


def shared_tables(own: Mapping[str, Leaf], tree: Mapping[str, Any]) -> tuple[dict[str, Placed], set[str]]:
    """Columns of the tables that the structures of a place make with its own columns, by the names of the tables, and
    which structures they take; none where its own columns are a table, or hold no frequency or time.

    Structures whose names differ in a number or an axis alone are the channels of one table, without a name, whose
    columns are named by their places, "demod1/x". Others are tables of their own.
    """
    readings = any(not (_RUNS.fullmatch(key) or _BESIDE.fullmatch(key)) for key in own)
    if readings or not any(map(_RUNS.fullmatch, own)):
        return {}, set()
    rows = next(iter(own.values())).values.size
    groups: dict[str, dict[str, Leaf]] = {}
    taken = set()
    for key, entry in tree.items():
        found = _beneath(key, entry, rows) if isinstance(entry, dict) and key not in ("chunkheader", "header") else {}
        if found and not any(_RUNS.fullmatch(name) for columns in found.values() for name in columns):
            groups |= found
            taken.add(key)
    if not groups:
        return {}, set()
    if len({_CHANNEL.sub("#", place.lower()) for place in groups}) > 1:
        return {place: [("", {**own, **columns})] for place, columns in groups.items()}, taken
    return {"": [("", own), *((f"{place}/", columns) for place, columns in groups.items())]}, taken


def _beneath(place: str, tree: Mapping[str, Any], rows: int) -> dict[str, dict[str, Leaf]]:
    """The columns of so many rows in a structure and in those in it, by place and name."""
    columns = {
        key: leaf
        for key, leaf in tree.items()
        if isinstance(leaf, Leaf) and leaf.values.size == rows == max(leaf.values.shape, default=0)
    }
    found = {place: columns} if columns else {}
    for key, entry in tree.items():
        if isinstance(entry, dict):
            found |= _beneath(f"{place}/{key}", entry, rows)
    return found
