"""Impedances and admittances over a frequency, as analysers save them: the current that a drive makes flow."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from memsgyro_jax.base.units import to_si

from .formats import SourceColumn, SourceTable
from .imported_columns import angle_column, is_same_kind
from .two_channels import plain_words


PER_VOLT = "per volt"
"""Attribute of a table whose readings are those of one volt of drive."""
_KINDS = ("ohm", "S")
_PARTS = {
    "I": {"g", "gp", "r", "rs", "re", "real", "z'", "y'", "resistance", "conductance"},
    "Q": {"b", "bp", "x", "xs", "im", "imag", "imaginary", "z''", "y''", "reactance", "susceptance"},
    "": {"rp", "xp", "rdc"},  # of parallel parts: no parts of one phasor
}


def immittance_part(column: SourceColumn) -> str:
    """Which part of a phasor a column in ohms or siemens is: "I", "Q" or "amp"; empty for one in another unit."""
    if not _kind(column):
        return ""
    words = {*plain_words(column.name).split()}
    return next((part for part, own in _PARTS.items() if words & own), "amp")


def as_current(
    table: SourceTable, rows: Mapping[str, SourceColumn], assumed: list[str]
) -> tuple[SourceTable, dict[str, SourceColumn]]:
    """The readings of one volt of drive, where they are impedances or admittances: that current, a volt for an ampere.

    Args:
        table: as read; its attributes then say that its readings are those of one volt.
        rows: role to column.
        assumed: gets one sentence.
    """
    form = ("I", "Q") if {"I", "Q"} <= {*rows} else ("amp",)
    kinds = {_kind(rows[role]) if role in rows else "" for role in form}
    if len(kinds) != 1 or not (kind := kinds.pop()) or "f" not in rows:
        return table, dict(rows)
    values = [to_si(rows[role].values, rows[role].unit, kind, f"column `{rows[role].name}`") for role in form]
    turned = {**rows}
    if kind == "ohm":
        values = _inverted(values)
        if form == ("amp",) and "phase" in rows:
            phase = angle_column(rows["phase"], assumed)
            turned["phase"] = SourceColumn(phase.name, phase.unit, -phase.values)
    what = "1/Z, turned from the impedance" if kind == "ohm" else "the admittance"
    assumed.append(f"the response is {what}: the current through a resonator in series, at 1 V for 1 A")
    turned |= {role: SourceColumn(rows[role].name, "V", part) for role, part in zip(form, values, strict=True)}
    return replace(table, attributes={**table.attributes, "reads": "velocity", PER_VOLT: "drive"}), turned


def _kind(column: SourceColumn) -> str:
    return next((kind for kind in _KINDS if column.unit and is_same_kind(column.unit, kind)), "")


def _inverted(parts: list[np.ndarray]) -> list[np.ndarray]:
    """One over a phasor of two parts, or over an amplitude."""
    with np.errstate(divide="ignore", invalid="ignore"):  # of a zero; reading the case refuses it
        inverse = 1.0 / (parts[0] + 1j * parts[1] if len(parts) == 2 else parts[0])
    return [inverse.real, inverse.imag] if len(parts) == 2 else [inverse]
