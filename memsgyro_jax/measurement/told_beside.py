"""What stands beside the columns of a table: level of the drive, driven axis and reference frequency, as the user, the
names of the file and its folder, or attributes of the file say.
"""

import contextlib
import re
from collections.abc import Mapping, Sequence
from typing import Any

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.quantity import amount_of_option, number_and_unit

from .column_meaning import Meaning
from .file_names import level_in_name, told_by_names, without_bias
from .formats import SourceColumn, SourceTable
from .formats.header import split_header, tidy_unit
from .imported_columns import is_same_kind
from .two_channels import axis_in_name, plain_words


Level = tuple[float, str]  # with its unit
NO_LEVEL = "the drive is 1 V, as the file does not say (`--drive`)"
_LEVEL = re.compile(r"(?<![A-Za-z0-9.])(\d+(?:[.p]\d+)?)[ _]?([nuµm]?[VAN])(?:pk|p)?(?![A-Za-z])")
_REFERENCE = (re.compile(r"\b(?:reference|ref)\b"), re.compile(r"\b(?:oscillator|osc)\b"))  # the clearer first
_FREQUENCY = re.compile(r"\bfreq(?:uency)?\b")
_OTHER = re.compile(r"\b(?:clock|units?|range|step|max|min|index|number)\b")
_UNITS = ("unit", "units", "Unit", "Units")
_LEVEL_NAMES = (
    "drive",
    "drive_level",
    "drive_amplitude",
    "drive_force",
    "drive_voltage",
    "excitation",
    "anregung",
)  # of files


def _of_drive(levels: Sequence[re.Match[str]]) -> re.Match[str] | None:
    """The first of the levels in a name; beside volts, which may be a bias, the one in a part of a volt."""
    parts = [one for one in levels if one[2][0] in "nuµm" and one[2].endswith("V")]
    whole = [one for one in levels if one[2] == "V"]
    return parts[0] if len(parts) == 1 and whole else next(iter(levels), None)


def _level_told(name: str) -> tuple[Level, str] | None:
    """Number and unit, and the words for it, of the level that a name tells."""
    if words := level_in_name(name):
        value, unit = amount_of_option(words, "--drive", "20 mV")
        return (value, unit), f"{words}, {value:.4g} {unit} at its peak"
    if found := _of_drive([*_LEVEL.finditer(without_bias(name))]):
        level = float(found[1].replace("p", ".")), found[2]
        return level, f"{level[0]:g} {level[1]}"
    return None


def level_of(table: SourceTable, drive: Level | None, assumed: list[str]) -> dict[str, Any]:
    """The drive level that no column holds."""
    if drive is not None:
        return {"value": drive[0], "unit": drive[1]}
    found, whose = told_by_names(table.path.stem, table.folder, _level_told)
    if found is not None:
        (value, unit), words = found
        assumed.append(f"the drive is {words}, as the {whose}'s name says")
        return {"value": value, "unit": unit}
    for name, text in table.attributes.items():
        plain, unit = split_header(name)
        level = text.strip() if not unit else f"{re.sub(r'(?<=[0-9]),(?=[0-9])', '.', text.strip())} {unit}"
        if plain.lower() in _LEVEL_NAMES and (of_file := _LEVEL.fullmatch(level)):
            assumed.append(f"the drive is {of_file[1]} {of_file[2]}, as the file's attribute `{name}` says")
            return {"value": float(of_file[1].replace("p", ".")), "unit": of_file[2]}
    assumed.append(NO_LEVEL)
    return {"value": 1.0, "unit": "V"}


def level_of_ratio(table: SourceTable) -> tuple[Level | None, str]:
    """The level at which a ratio to the drive was taken, as names tell it, and the words for it. One in whole volts may
    be a bias, and is not taken.
    """

    def told(name: str) -> tuple[Level, str] | None:
        found = _level_told(name)
        if found is None or not is_same_kind(found[0][1], "V"):
            return None
        (_, unit), words = found
        return found if unit != "V" or "," in words else None

    found, whose = told_by_names(table.path.stem, table.folder, told)
    return (None, "") if found is None else (found[0], f"at {found[1]}, as the {whose}'s name says")


def driven_axis(
    table: SourceTable, rows: Mapping[str, SourceColumn], given: str, meaning: Meaning, assumed: list[str]
) -> str:
    """Of two axes, which was driven; empty for a device of one, and where nothing says."""
    if not meaning.two_axes:
        return ""
    if given:
        return given
    if meaning.driven:
        assumed.append(f"{meaning.driven} is driven, as `{rows['drive'].name}` says")
        return meaning.driven
    axis, whose = told_by_names(f"{table.path.stem}_{table.name}", table.folder, axis_in_name)
    if axis:
        assumed.append(f"{axis} is driven, as the {whose}'s name says")
    return axis or ""


def reference_of(
    table: SourceTable, rows: Mapping[str, SourceColumn], given: Level | None, assumed: list[str]
) -> Level:
    """Frequency of the lock-in's reference, and its unit."""
    if given is not None:
        return given
    if "f" in rows:
        return float(rows["f"].values[0]), rows["f"].unit or "Hz"
    told = _references(table)
    clear = {name: level for name, level in told.items() if level[1]}
    if len({*clear.values()}) == 1:
        name, level = next(iter(clear.items()))
        assumed.append(f"the reference is {level[0]:.10g} {level[1]}, as the file's attribute `{name}` says")
        return level
    bare = next((name for name, level in told.items() if not level[1]), "") if not clear else ""
    named = {role: rows[role].header for role in ("t", "I", "Q") if role in rows}
    beside = f" (its attribute `{bare}` says {table.attributes[bare]} without a unit)" if bare else ""
    waves = ', or as in --map "t={t},x={I},y={Q}" if these are waveforms of two axes'
    waves = waves.format(**named) if len(named) == 3 else ""
    raise InputError(
        f"{table.path}: the reference frequency of the lock-in must be known, but no column has it{beside}; give it as "
        f'in --reference "32.768 kHz"{waves}.'
    )


def _references(table: SourceTable) -> dict[str, Level]:
    """Frequencies that attributes give of a reference, else of an oscillator, by name; without a unit where none says
    it.
    """
    found: dict[str, Level] = {}
    for words in _REFERENCE:
        for name, text in table.attributes.items():
            plain, unit = split_header(name)
            said = plain_words(plain)
            if not words.search(said) or not _FREQUENCY.search(said) or _OTHER.search(said):
                continue
            with contextlib.suppress(ValueError):
                value, own = number_and_unit(text)
                beside = (table.attributes.get(key, "") for key in (f"{name}_unit", f"{name} unit", f"{name}_units"))
                unit = tidy_unit(own) or unit or next(filter(None, beside), "")
                unit = unit or next((u for k in _UNITS if is_same_kind(u := table.attributes.get(k, ""), "Hz")), "")
                if value > 0 and (not unit or is_same_kind(unit, "Hz")):
                    found[name] = value, unit
        if found:
            break
    return found
