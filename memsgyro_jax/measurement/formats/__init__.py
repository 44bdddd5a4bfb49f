"""How instruments save: one file per format, each of which gives named columns with their units."""

from pathlib import Path

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import LARGEST_TABLE, read_whole
from memsgyro_jax.base.text import printable

from .base import Format as Format
from .base import SourceColumn as SourceColumn
from .base import SourceTable as SourceTable
from .base import damaged
from .delimited import Delimited
from .labone import LabOneText
from .lvm import LabViewText
from .tdms import Tdms
from .touchstone import Touchstone
from .tree import Hdf5, Mat, NetCdf3
from .universal import Universal


FORMATS: tuple[Format, ...] = (
    Hdf5(), Mat(), NetCdf3(), Tdms(), Touchstone(), Universal(), LabViewText(), LabOneText(), Delimited(),
)  # fmt: skip
"""The first that recognises a file reads it."""
_HEAD = 4096


def read_instrument_file(path: str | Path) -> tuple[str, tuple[SourceTable, ...]]:
    """The name of a file's format, and its tables.

    Raises:
        InputError: the file is missing, empty, damaged, of no known format, or its library is not installed.
    """
    path = Path(path)
    head = read_whole(path, "file", most=LARGEST_TABLE)[:_HEAD]
    if not head.strip():
        raise InputError(f"{printable(str(path))}: the file is empty.")
    for form in FORMATS:
        if form.recognises(path, head):
            with damaged(path, form.name):
                return form.name, form.read(path)
    known = ", ".join(form.name for form in FORMATS)
    raise InputError(f"{printable(str(path))}: must be of a known format ({known}), but is none of them.")
