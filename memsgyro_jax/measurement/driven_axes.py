"""Which axis of a device of two was driven in each file of an instrument: as given, or the sentence that asks."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import listed

from .imported_conditions import for_each_file
from .imported_record import ImportedRecord


def axes_of_files(given: Sequence[str], files: int) -> list[str]:
    """The axis of each file, empty where none was given; raises `InputError` for another word or number of them."""
    axes = [text.strip().lower() for text in given]
    if wrong := [text for text, axis in zip(given, axes, strict=True) if axis not in ("x", "y")]:
        raise InputError(f"Option `--axis` must be x or y, but is `{wrong[0]}`.")
    return for_each_file("--axis", axes, files)


def require_axes(paths: Sequence[str | Path], found: Sequence[Sequence[ImportedRecord]], given: Sequence[str]) -> None:
    """Raises `InputError` unless all files are of one axis, or all have two channels and say which was driven.

    Args:
        paths: of the files.
        found: the records of each.
        given: axes, as the user says.
    """
    two = [path for path, some in zip(paths, found, strict=True) if any(record.two_axes for record in some)]
    one = [path for path, some in zip(paths, found, strict=True) if not all(record.two_axes for record in some)]
    if given and not two:
        raise InputError(
            "Option `--axis` must be left out, as no file has two channels (`--map` with y_I, y_Q names one)."
        )
    if two and one:
        raise InputError(
            f"{one[0]}: must have two channels, as {Path(two[0]).name} has, but has one; import it alone, or name the "
            "columns that all files have with --map."
        )
    silent = [
        path
        for path, some in zip(paths, found, strict=True)
        if any(r.two_axes and not r.axis and r.kind != "free_decay" for r in some)
    ]
    if silent:
        words = " ".join(some[0].axis or _louder(some[0]) for some in found)
        names = listed(Path(path).name for path in silent)
        raise InputError(
            f"{names}: with two channels the driven axis must be known, but neither a column F_x or F_y nor the file's "
            f"name says it; give it for each file, as in --axis {words} (by the larger channel)."
        )


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
