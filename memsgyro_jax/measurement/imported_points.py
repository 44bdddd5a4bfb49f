"""Operating points from the columns of an instrument's table: columns in the words of a case, keys, what is read."""

from collections.abc import Mapping
from typing import Any

from .formats import SourceColumn, SourceTable
from .imported_columns import add_surroundings, reading_column
from .imported_sweep import PEAK, level_of, phasor_columns_of, read_as


def columns_of_points(
    table: SourceTable,
    rows: Mapping[str, SourceColumn],
    drive: tuple[float, str] | None,
    axis: str,
    assumed: list[str],
) -> tuple[dict[str, SourceColumn], dict[str, Any], str]:
    """Columns and keys of settled phasors at one frequency, and what is read where it shows; as of a sweep."""
    columns = phasor_columns_of(rows, assumed)
    quantity = read_as(columns["Vx_I" if "Vx_I" in columns else "Vx_amp"].unit)
    if not any("peak amplitude" in sentence for sentence in assumed):
        assumed.append(PEAK)
    keys: dict[str, Any] = {}
    if "drive" in rows:
        columns[f"F_{axis or 'x'}"] = reading_column(rows["drive"], assumed, "drive")
    else:
        keys["drive_force"] = level_of(table, drive, assumed)
    add_surroundings(columns, rows)
    assumed.append("every row was read after the device had settled at its conditions")
    if "rate" in columns:
        assumed.append("the rate is the setting of the table (`rate_reference`)")
    return columns, keys, quantity
