"""What a user says of the columns of an instrument's file: `--map`, role to column."""

import re
from itertools import accumulate

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import listed, printable
from memsgyro_jax.base.units import NUMBER

from .formats import SourceColumn, SourceTable
from .formats.header import split_header


ROLES = ("t", "f", "I", "Q", "amp", "phase", "signal", "drive", "T", "V_bias", "rate", "std")
"""Time, frequency, parts of a phasor, amplitude and phase of it, a waveform, what drives, conditions, noise."""
SECOND_DRIVE = "y_drive"
"""What drives the second axis while another column drives the first, over time."""
SECOND = ("y_I", "y_Q", "y_amp", "y_phase", "y_signal")
"""Parts of the phasor of a second channel, and its waveform."""
SHORT = {
    "x_I": "I", "Vx_I": "I", "X": "I", "x_Q": "Q", "Vx_Q": "Q", "Y": "Q", "x_amp": "amp", "Vx_amp": "amp", "R": "amp",
    "x_phase": "phase", "Vx_phase": "phase", "theta": "phase", "x": "signal", "y": "signal", "Vx": "signal",
    "F": "drive", "F_x": "drive_x", "u": "drive", "u_x": "drive_x", "F_y": "drive_y", "u_y": "drive_y",
    **{role: role for role in SECOND}, **{f"V{role}": role for role in SECOND}, "Vy": "y_signal",
}  # fmt: skip
"""Other words for the roles on the left of `--map`."""


def parse_map(text: str) -> dict[str, str]:
    """`role=column,…` as role to column; raises `InputError` for what is no such list."""
    pairs: dict[str, str] = {}
    for part in re.split(r",(?=\s*\w+\s*=)", text):
        left, equals, right = part.partition("=")
        role = SHORT.get(left.strip(), left.strip())
        if not equals or not right.strip() or role not in (*ROLES, *SHORT.values()):
            raise InputError(
                f'Option `--map` must read "role=column,..." with roles among {", ".join(ROLES)} (or X, Y, R, theta, '
                f"x_I, x_Q, x_amp, x_phase, x, u_x, F_x; of a second channel y_I, y_Q, y_amp, y_phase, y, F_y), "
                f"but has `{printable(part, 60)}`."
            )
        if left.strip() == "y" and "signal" in pairs:  # beside x
            role = "y_signal"
        drives = [one for one in pairs if one.startswith("drive")]
        if role in pairs or (role.startswith("drive") and drives and "drive" in (role, *drives)):  # x and y are two
            raise InputError(f"Option `--map` must name each role once, but {left.strip()} stands twice.")
        pairs[role] = right.strip()
    return pairs


def chosen_column(table: SourceTable, role: str, text: str) -> SourceColumn:
    """The column that a text names: `[number*]name [unit]`, where the unit is that of the file or overrides it."""
    factor = re.match(rf"({NUMBER})\s*\*\s*(?=\S)", text)
    wanted = text[factor.end() :] if factor else text
    name, unit = split_header(wanted)
    places = [*accumulate(table.name.split("/"), "{}/{}".format)]  # of a tree of names
    for same in (
        lambda c: wanted in (c.header, c.name),
        lambda c: c.name == name,
        lambda c: c.name.casefold() == name.casefold(),
        lambda c: name in [f"{place}/{c.name}" for place in places],
    ):
        hits = [column for column in table.columns if same(column)]
        if len(hits) == 1:
            values = hits[0].values
            if values.dtype.kind not in "iuf":
                raise InputError(f"{table.path}: `{wanted}`, named by --map, must hold numbers, but holds words.")
            return SourceColumn(hits[0].name, unit or hits[0].unit, values * (float(factor[1]) if factor else 1))
    names = listed([column.header for column in table.columns], "`")
    raise InputError(
        f"{table.path}: --map must name a column of the file for `{role}`, but `{wanted}` is none of {names}."
    )
