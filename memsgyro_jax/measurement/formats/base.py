"""What every file format gives: named columns with their units, and what had to be taken for granted to read them."""

import abc
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import printable


@dataclass(frozen=True, eq=False)
class SourceColumn:
    """One column as an instrument wrote it.

    Args:
        name: without its unit.
        unit: as written; empty where the file does not say.
        values: (n,) numbers, or words where a column holds any.
    """

    name: str
    unit: str
    values: np.ndarray

    @property
    def header(self) -> str:
        """Name and unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True, eq=False)
class SourceTable:
    """Columns of one length that belong together.

    Args:
        path: of the file.
        name: of the part of a file that holds several; empty otherwise.
        columns: in the order of the file.
        attributes: what else the file says, as text.
        assumed: one sentence each.
        folder: name of the folder that it is in, where that tells something of it; empty otherwise.
        shown: what the file is called in sentences; empty for its name.
    """

    path: Path
    name: str
    columns: tuple[SourceColumn, ...]
    attributes: Mapping[str, str] = field(default_factory=dict)
    assumed: tuple[str, ...] = ()
    folder: str = ""
    shown: str = ""


class Format(abc.ABC):
    """One way in which instruments save; members keep nothing."""

    name: ClassVar[str]

    @abc.abstractmethod
    def recognises(self, path: Path, head: bytes) -> bool:
        """Whether the file is of this format, from its name and its first 4096 bytes."""

    @abc.abstractmethod
    def read(self, path: Path) -> tuple[SourceTable, ...]:
        """All tables of the file; any exception stands for a file that is damaged."""


def library(module: str, package: str, path: Path) -> Any:
    """A module that only one format needs; raises `InputError` with what to install where it is missing."""
    try:
        return import_module(module)
    except ImportError as error:
        raise InputError(
            f"{path}: reading this format takes the package {package}, which is not installed; "
            "`pip install -e '.[import]'` in the folder of the package's README brings it."
        ) from error


@contextmanager
def damaged(path: Path, what: str) -> Iterator[None]:
    """Turns whatever a library raises for a damaged file into one sentence."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # libraries raise anything from struct.error to AssertionError
        reason = printable(" ".join(str(error).split()), 160).rstrip(".") or type(error).__name__
        raise InputError(
            f"{printable(str(path))}: must be a whole {what} file, but cannot be read ({reason}); save it again."
        ) from error


def complex_columns(name: str, unit: str, values: np.ndarray) -> tuple[SourceColumn, ...]:
    """A column, or the two parts of a complex one."""
    if not np.iscomplexobj(values):
        return (SourceColumn(name, unit, values),)
    return SourceColumn(f"{name} real", unit, values.real), SourceColumn(f"{name} imag", unit, values.imag)
