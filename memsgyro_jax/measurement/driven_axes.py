"""Which axis of a device of two was driven in each file of an instrument: as given, or the sentence that asks."""

from collections.abc import Sequence

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import listed

from .file_names import FileName, told_by_names
from .imported_conditions import for_each_file
from .imported_record import ImportedRecord
from .two_channels import axis_in_name


_OF_A_DRIVE = ("frequency_sweep", "rate_table", "operating_points")  # kinds of record that drive one axis


ONE_CHANNEL = (
    "one channel tells nothing of the other axis by itself: to have a device of two axes all the same, import without "
    '`--axis`, then set `device = "single_mass"`, `drive_axis` of each sweep and, of the axis that was not read, its k '
    "and d (or frequency and quality_factor) with kxy and dxy under `[design]` in case.toml"
)
"""What to do where two axes were driven and one was read."""
_OF_A_SWEEP = "; import it alone, or name the columns that all files have with --map"
_OF_A_DECAY = (
    ": a decay begins in an unknown motion of both axes, so that one of a device of two needs the readings of both. "
    "Record both, or leave this file out; as one of a device of one axis it is imported beside sweeps of that axis of "
    "which --map names that channel alone (x_I, x_Q)"
)


def axes_of_files(given: Sequence[str], files: int) -> list[str]:
    """The axis of each file, empty where none was given, or "-"; raises `InputError` for another word or number of
    them.
    """
    axes = [text.strip().lower() for text in given]
    if wrong := [text for text, axis in zip(given, axes, strict=True) if axis not in ("x", "y", "-")]:
        raise InputError(f"Option `--axis` must be x or y (`-` for a file that says it), but is `{wrong[0]}`.")
    return ["" if axis == "-" else axis for axis in for_each_file("--axis", axes, files, "that says it, or has none")]


def require_axes(files: Sequence[FileName], found: Sequence[Sequence[ImportedRecord]], given: Sequence[str]) -> None:
    """Raises `InputError` unless all files are of one axis, or all have two channels and say which was driven.

    Args:
        files: what they are called.
        found: the records of each.
        given: axes, as the user says.
    """
    two = [file.shown for file, some in zip(files, found, strict=True) if any(record.two_axes for record in some)]
    one = [file.shown for file, some in zip(files, found, strict=True) if not all(record.two_axes for record in some)]
    if given and not two:
        raise InputError(
            "Option `--axis` must be left out, as no file has two channels (`--map` with y_I, y_Q names one). "
            f"{ONE_CHANNEL[0].upper()}{ONE_CHANNEL[1:]}."
        )
    if two and one:
        lone = next(some for file, some in zip(files, found, strict=True) if file.shown == one[0])
        remedy = _OF_A_DECAY if all(record.kind == "free_decay" for record in lone) else _OF_A_SWEEP
        raise InputError(f"{one[0]}: must have two channels, as {two[0]} has, but has one{remedy}.")
    silent = [
        file.shown
        for file, some in zip(files, found, strict=True)
        if any(r.two_axes and not r.axis and r.kind != "free_decay" for r in some)
    ]
    if silent:
        words = " ".join(some[0].axis or _louder(some[0]) for some in found)
        raise InputError(
            f"{listed(silent)}: with two channels the driven axis must be known, but neither a column F_x or F_y nor "
            f"the name of file or folder says it; give it for each file, as in --axis {words} (by the larger channel)."
        )


def hint_of_axes(files: Sequence[FileName], found: Sequence[Sequence[ImportedRecord]]) -> tuple[str, ...]:
    """A sentence where names of files of one channel say that both axes were driven: they become sweeps of one axis."""
    driven = [one for one, some in zip(files, found, strict=True) if any(r.kind in _OF_A_DRIVE for r in some)]
    told = [told_by_names(one.stem, one.folder, axis_in_name)[0] for one in driven]
    if any(record.two_axes for some in found for record in some) or {*told} != {"x", "y"}:
        return ()
    said = "the files' names say that x and y were driven, but each has one channel, and all are taken for one axis"
    return (f"{said}; {ONE_CHANNEL}",)


def _louder(record: ImportedRecord) -> str:
    """The channel with the largest reading."""
    most = {
        axis: max(
            float(np.max(np.abs(v)))
            for name, v in record.columns.items()
            if name.startswith((f"V{axis} ", f"V{axis}_I", f"V{axis}_Q", f"V{axis}_amp"))
        )
        for axis in "xy"
    }
    return max(most, key=lambda axis: most[axis])
