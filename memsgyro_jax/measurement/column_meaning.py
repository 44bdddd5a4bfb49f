"""What the columns of an instrument's file mean: from their names and units, or as the user says."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import listed, printable

from .column_map import SECOND, SECOND_DRIVE, chosen_column
from .drive_columns import is_drive_level, take_levels
from .formats import SourceColumn, SourceTable
from .formats.header import SPECIAL
from .immittance import immittance_part
from .imported_columns import is_same_kind
from .two_channels import PARTS, axis_of_drive, channel_and_part, plain_words, two_channels, two_drives, two_waveforms
from .unnamed_columns import unnamed_sweep


_UNUSED = re.compile(
    r"std|sigma|noise|stderr|pwr|power|settl|bandwidth|\btc\b|constant|\bdio\b|^trigger|^aux ?in|chunk|\bsize\b|\bnext|"
    r"count|index|\bno\b|coherence|direction|status|overload|\bdate\b|density|comment|set ?timestamp|\bsweep\b"
)
_NAMED = {
    "f": r"^(f|freq|frequency|grid|fdrive|f drive|drive freq\w*|stimulus freq\w*|x frequency)$|fr[eé]quen[cz]",
    "t": r"^(t|time|times|timestamp|timestamps|elapsed( time)?|x value|relative time|time axis|zeit|temps)$",
    "T": r"^(temp|temperature)\b|temperature",
    "V_bias": r"bias",
    "drive": r"drive|excit|force|stimul|generator|source|\binput\b|level|set ?point|control|sig(nal)? ?out|current|"
    r"exc\b|osc\b|^(f [xy]|u|u [xy]|output)$|amplitude set|anregung",
    "phase": r"\bphase|theta|\bphi\b|\barg\b|angle",
    "amp": r"^r$|\bamp\b|ampl\b|amplitude|magnitude|\bmag\b|\babs\b|modulus|\bbetrag\b|\bgain\b|^s\d\d db$",
}
_DC_VOLTAGE = re.compile(  # whole names: a reading or a drive may have a part of them
    r"([vu] ?(dc|b)|dc (voltage|volts?)|voltage dc|polari[sz](ation|ing) voltage)"
    r"( (set ?point|set|source|supply|level))?"
)
_TURN_RATE = re.compile(r"^(rate|angular rate|turn rate|table rate|rate table|omega z?|ω)$")
NOISE = {"std": "std", "vx std": "x_std", "x std": "x_std", "vy std": "y_std", "y std": "y_std"}
"""Whole names of the standard deviation of each row, of all channels or of one."""
_DIMENSIONS = {"f": "Hz", "t": "s", "T": "K", "phase": "rad"}


@dataclass(frozen=True)
class Meaning:
    """The columns of a table by what they mean.

    Args:
        columns: role to column.
        unused: names of those that are left out.
        driven: axis of the drive, where its column says.
        guessed: roles that a name does not say outright.
    """

    columns: Mapping[str, SourceColumn]
    unused: tuple[str, ...]
    driven: str = ""
    guessed: tuple[str, ...] = ()

    @property
    def two_axes(self) -> bool:
        """Whether there are the readings of two channels, or the drives of two axes."""
        return bool({*SECOND, SECOND_DRIVE} & {*self.columns})

    @property
    def swept(self) -> bool:
        """Whether the frequency runs, rather than time."""
        return "f" in self.columns and np.unique(self.columns["f"].values).size > 2

    @property
    def at_points(self) -> bool:
        """Whether neither runs, but conditions do, of phasors at one frequency."""
        varied = any(np.ptp(self.columns[role].values) > 0 for role in ("rate", "T", "V_bias") if role in self.columns)
        phasors = {"I", "Q"} <= {*self.columns} or {"amp", "phase"} <= {*self.columns}
        return varied and phasors and not self.swept and "t" not in self.columns


def meaning_of(table: SourceTable, said: Mapping[str, str]) -> Meaning:
    """What the columns of a table mean.

    Args:
        table: as read.
        said: role to column, by the user; then no other column is used.

    Raises:
        InputError: the names and units do not tell; the sentence has a `--map` to copy.
    """
    if said:
        columns, driven = _said(table, said)
        names = {column.name for column in columns.values()}
        unused = tuple(column.header for column in table.columns if column.name not in names)
        return _whole(table, columns, unused, driven)
    found: dict[str, list[SourceColumn]] = {}
    for column in table.columns:
        found.setdefault(role_of(column), []).append(column)
    _as_read(found)
    take_levels(found)
    _as_channels(found)
    _as_amplitudes(found)
    if "f" not in found or not ({"I", "amp"} & {*found}):
        _as_waveforms(found)
    _without_others(found)
    _settled(table, found)
    columns = {
        role: candidates[0] for role, candidates in found.items() if (role and role != "signal") or candidates[1:] == []
    }
    columns.pop("", None)
    used = {id(column) for column in columns.values()}
    unused = tuple(column.header for column in table.columns if id(column) not in used)
    driven = axis_of_drive(columns["drive"].name) if "drive" in columns and SECOND_DRIVE not in columns else ""
    guessed = tuple(role for role in columns if role == "V_bias" and _is_dc_voltage(columns[role]))
    return replace(_whole(table, columns, unused, driven), guessed=guessed)


def _said(table: SourceTable, said: Mapping[str, str]) -> tuple[dict[str, SourceColumn], str]:
    """The columns that the user names, role to column, and the axis of the drive where one drives by itself."""
    columns = {role: chosen_column(table, role, text) for role, text in said.items()}
    drives = {role: columns.pop(role) for role in said if role.startswith("drive")}
    if len(drives) == 2:  # one that stays as it is, or of a sweep is nothing, drives none
        moving = {role: c for role, c in drives.items() if np.ptp(c.values) > 0 or ("f" in said and c.values.any())}
        drives = moving or dict([*drives.items()][:1])
    if len(drives) == 2 and "f" in said:
        both = listed((column.header for column in drives.values()), "`")
        raise InputError(f"{table.path}: `--map` must name one drive, as a sweep drives one axis, but both {both} do.")
    axis = "" if len(drives) == 2 else "".join(drives).removeprefix("drive").lstrip("_")
    return columns | dict(zip(("drive", SECOND_DRIVE), (drives[role] for role in sorted(drives)), strict=False)), axis


def role_of(column: SourceColumn) -> str:
    """What a column is by its unit and name; empty for what no record needs."""
    name = plain_words(column.name)
    if column.values.dtype.kind not in "iuf" or not np.isfinite(column.values).any():
        return ""
    if name in NOISE:
        return NOISE[name]
    if _UNUSED.search(name):
        return ""
    if is_drive_level(column):
        return "drive"
    if part := immittance_part(column):
        return part
    for role in ("f", "t", "T", "phase"):
        if column.unit and is_same_kind(column.unit, _DIMENSIONS[role]) and not (role == "phase" and "rate" in name):
            return role
    if column.unit == "ticks":
        return "t"
    if column.unit and is_same_kind(column.unit, "rad/s"):
        return "f" if re.search(_NAMED["f"], name) else "rate"
    if not column.unit and _TURN_RATE.search(name):
        return "rate"
    if _is_dc_voltage(column):
        return "V_bias"
    tokens = [re.sub(r"\d+$", "", token) for token in name.split()]
    for role in ("f", "t", "T", "V_bias", "drive"):
        unlike = column.unit and role in _DIMENSIONS
        if re.search(_NAMED[role], name) and not unlike:
            return role
    for role in ("phase", "amp"):
        if re.search(_NAMED[role], name):
            return role
    if part := channel_and_part(column.name)[1]:
        return part
    if part := _part_of(tokens):
        return part
    return "amp" if column.unit in ("dB", "dBV", "dBm") else "signal"


def _part_of(words: Sequence[str]) -> str:
    """The part of a phasor that a name tells by its last word or its first, the longer one before what may be the
    letter of a current, as in ``I_re`` and ``Im(I)``.
    """
    ends = sorted([*words[-1:], *words[:1]], key=len, reverse=True)
    return next((role for end in ends for role, own in PARTS.items() if end in own), "")


def _is_dc_voltage(column: SourceColumn) -> bool:
    """Whether a column is a steady voltage by its whole name and its unit, which is none of amplitudes."""
    named = _DC_VOLTAGE.fullmatch(plain_words(column.name)) is not None
    return named and not SPECIAL.fullmatch(column.unit) and is_same_kind(column.unit, "V")


def _as_read(found: dict[str, list[SourceColumn]]) -> None:
    """What is named like a steady voltage is read where nothing else is, as on a channel `Vb`, alone or beside `Va`."""
    signals = found.get("signal", [])
    alone = not ({"I", "Q", "amp"} & {*found}) and all(plain_words(c.name) in ("va", "v a") for c in signals)
    steady = [column for column in found.get("V_bias", []) if _is_dc_voltage(column)]
    if alone and steady:
        found["signal"] = [*signals, *steady]
        found["V_bias"] = [column for column in found["V_bias"] if column not in steady]
        if not found["V_bias"]:
            del found["V_bias"]


def _without_others(found: dict[str, list[SourceColumn]]) -> None:
    """Beside phasors, a column that no word tells of is a signal only where time runs and its unit is theirs."""
    if not ({"I", "Q"} <= {*found} or "amp" in found):
        return
    swept = any(np.unique(column.values).size > 2 for column in found.get("f", []))
    if swept or "t" not in found:
        found.pop("signal", None)
        found.pop("y_signal", None)
    elif {"I", "Q"} <= {*found} or "phase" in found:
        unit = found["I" if "I" in found else "amp"][0].unit or "V"
        alike = [c for c in found.pop("signal", []) if not c.unit or is_same_kind(c.unit, unit)]
        found |= {"signal": alike} if alike else {}


def _as_channels(found: dict[str, list[SourceColumn]]) -> None:
    """Readings whose names are those of two channels, phasors where no frequency runs; a drive of nothing, of two that
    stand beside each other, drives none.
    """
    swept = any(np.unique(column.values).size > 2 for column in found.get("f", []))
    parts = two_channels(column for role in ("I", "Q", "amp", "phase") for column in found.get(role, []))
    if parts and (swept or {"I", "Q"} <= {*parts} or {"amp", "phase"} <= {*parts}):
        for role in ("I", "Q", "amp", "phase"):
            found.pop(role, None)
        found.update({role: [column] for role, column in parts.items()})
    if swept and "drive" in found and any(np.any(column.values) for column in found["drive"]):
        found["drive"] = [column for column in found["drive"] if np.any(column.values)]


def _as_amplitudes(found: dict[str, list[SourceColumn]]) -> None:
    """Over a frequency that runs, the one reading that never is negative is an amplitude, whatever it is called."""
    swept = any(np.unique(column.values).size > 2 for column in found.get("f", []))
    signals = found.get("signal", [])
    if swept and not ({"I", "Q", "amp"} & {*found}) and len(signals) == 1 and np.nanmin(signals[0].values) >= 0:
        found["amp"] = found.pop("signal")


def _as_waveforms(found: dict[str, list[SourceColumn]]) -> None:
    """Over time, what is named like a part of a phasor, or like an amplitude but alternates, is a waveform."""
    lone = "I" in found or "Q" in found
    if lone and not ("I" in found and "Q" in found):
        for role in ("I", "Q"):
            found.setdefault("signal", []).extend(found.pop(role, []))
    if "amp" in found and "phase" not in found and all(np.min(c.values) < 0 < np.max(c.values) for c in found["amp"]):
        found.setdefault("signal", []).extend(found.pop("amp"))
    if pair := two_waveforms(found.get("signal", [])):
        found["signal"], found["y_signal"] = [pair[0]], [pair[1]]


def _settled(table: SourceTable, found: dict[str, list[SourceColumn]]) -> None:
    """Chooses where two columns say the same; raises where that would be a guess."""
    plain = [column for column in found.get("f", []) if column.name.lower() in ("f", "freq", "frequency")]
    if len(found.get("f", [])) > 1 and len(plain) == 1:
        found["f"] = plain
    if {"I", "Q", "amp"} <= {*found}:  # the same twice
        found.pop("amp")
        found.pop("phase", None)
    over_time = "f" not in found or not ({"I", "amp"} & {*found})
    wanted = ("t", "drive", "signal", "I", "Q") if over_time else ("f", "drive", "I", "Q", "amp", "phase")
    for role in wanted:
        here = found.get(role, [])
        if role == "drive" and len(here) > 1:  # one that stays as it is drives nothing
            here = [c for c in here if np.ptp(c.values) > 0] or here[:1]
            found[role] = here
            if over_time and "signal" in found and (pair := two_drives(here)):
                (found[role], found[SECOND_DRIVE]), here = ([one] for one in pair), []
        if len(here) > 1:
            raise _unclear(
                table, found, f"more than one column may be {_SPOKEN[role]}: {listed([c.header for c in here], '`')}"
            )


_SPOKEN = {
    "t": "the time", "f": "the frequency", "I": "the in-phase part", "Q": "the quadrature", "amp": "the amplitude",
    "phase": "the phase", "signal": "the signal", "drive": "the drive", "T": "the temperature",
}  # fmt: skip


def _whole(table: SourceTable, columns: dict[str, SourceColumn], unused: tuple[str, ...], driven: str) -> Meaning:
    """The meaning, if it is that of a record."""
    meaning = Meaning(columns, unused, driven)
    pair = {"I", "Q"} <= {*columns}
    if meaning.swept and not (pair or "amp" in columns):
        raise _unclear(
            table, {k: [v] for k, v in columns.items()}, "no columns are in-phase and quadrature, or amplitude"
        )
    parts = {f"y_{role}" for role in ("I", "Q", "amp", "phase", "signal") if role in columns}
    if meaning.two_axes and parts != {*SECOND} & {*columns}:
        raise _unclear(table, {k: [v] for k, v in columns.items()}, "the two channels do not have the same parts")
    if meaning.at_points:
        return meaning
    if not meaning.swept and "t" not in columns:
        raise _unclear(table, {k: [v] for k, v in columns.items()}, "no column is a frequency that runs, or time")
    told = pair or {"amp", "phase"} <= {*columns} or "signal" in columns
    offered = [columns["signal"]] if "signal" in columns else [] if told else table.columns
    if not meaning.swept and (level := next((c for c in offered if _is_level(c.unit)), None)):
        raise InputError(
            f"{printable(str(table.path))}: a record over time must be a waveform, or the two parts of a lock-in's "
            f"phasors, but `{level.header}` is an amplitude in decibels; save one of these."
        )
    if not meaning.swept and not told:
        raise _unclear(table, {k: [v] for k, v in columns.items()}, "no column is the signal over time")
    return meaning


def _is_level(unit: str) -> bool:
    """Whether it is one of decibels."""
    found = SPECIAL.fullmatch(unit)
    return found is not None and found["decibel"] is not None


def _unclear(table: SourceTable, found: Mapping[str, Sequence[SourceColumn]], what: str) -> InputError:
    """The names, and the words to copy."""
    if "f" not in found:
        found = unnamed_sweep(table) or found
    over_time = "f" not in found
    waveforms = ("t", "signal", "y_signal") if "y_signal" in found else ("t", "signal")
    roles: tuple[str, ...] = (
        waveforms if over_time else ("f", "I", "Q") if "amp" not in found else ("f", "amp", "phase")
    )
    if not over_time and any(_repeated(table, found, role) for role in roles[1:]):
        roles += tuple(f"y_{role}" for role in roles[1:])
    words = {"I": "x_I", "Q": "x_Q", "amp": "x_amp", "phase": "x_phase", "signal": "x", "y_signal": "y"}
    rest = [c for c in table.columns if c.values.dtype.kind in "iuf" and np.nanmin(c.values) < np.nanmax(c.values)]
    pairs, timeless = [], False
    for role in roles:
        part = role.removeprefix("y_")
        meant = [*found.get(role, []), *found.get(part, [])]
        candidates = [c for c in meant if c.name in [left.name for left in rest]]
        alike = [c for c in rest if role_of(c) in ("", "signal", part)]
        candidates = candidates or [c for c in alike if role != "t" or np.all(np.diff(c.values) > 0)]
        if role == "t" and not candidates:
            timeless = True
            pairs.append("t=time [s]")
        elif candidates or part != "phase":
            pairs.append(f"{words.get(role, role)}={candidates[0].header if candidates else 'COLUMN'}")
            rest = [c for c in rest if not candidates or c.name != candidates[0].name]
    drives = found.get("drive", []) if roles[0] == "t" else []
    pairs += [f"{role}={column.header}" for role, column in zip(("u_x", "u_y"), drives, strict=False)]
    names = listed([column.header for column in table.columns], "`")
    where = f"{printable(str(table.path))}{', ' + table.name if table.name else ''}"
    second = " (`y=` for that of a second axis)" if roles == ("t", "signal") and "signal" in found else ""
    clock = ' with --sample-rate "50 kHz", or whatever it was, as no column is a time' * timeless
    return InputError(
        f'{where}: {what}; the columns are {names}; say which is which, as in --map "{",".join(pairs)}"{second}{clock}.'
    )


def _repeated(table: SourceTable, found: Mapping[str, Sequence[SourceColumn]], role: str) -> bool:
    """Whether more than one column may be this part of a phasor, so that there may be two channels."""
    return "y_" + role in found or len(found.get(role, [])) > 1 or sum(role_of(c) == role for c in table.columns) > 1
