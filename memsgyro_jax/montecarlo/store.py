"""The store of a sweep: a zarr group that is written chunk by chunk and survives a kill at any moment.

Arrays are filled with NaN and the status with `PENDING`; a chunk's status is written last, so whatever is not finished
reads as pending and is computed again on resume.
"""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from memsgyro_jax.base.errors import InputError

from .batch import MEANING, PENDING, STATUS


if TYPE_CHECKING:
    import xarray as xr

LABELS = "labels"  # attribute: names along dimensions; zarr has no settled type for text arrays


@dataclass(frozen=True)
class DieArray:
    """An array with one row per die: dimension names after `die`, their sizes, and the unit."""

    dimensions: tuple[str, ...]
    sizes: tuple[int, ...]
    unit: str


@dataclass(frozen=True)
class Layout:
    """What a lot consists of: its columns, numeric coordinates as (dimension, values, unit), and attributes."""

    columns: dict[str, DieArray]
    coordinates: dict[str, tuple[str, np.ndarray, str]]
    attributes: dict[str, Any]

    def dataset(self, rows: dict[str, np.ndarray]) -> "xr.Dataset":
        """Rows and their status as a Dataset."""
        import xarray as xr

        variables: dict[str, tuple] = {
            name: (("die", *column.dimensions), rows[name], {"units": column.unit})
            for name, column in self.columns.items()
        }
        variables[STATUS] = ("die", rows[STATUS])
        coordinates = {name: (dim, values, {"units": unit}) for name, (dim, values, unit) in self.coordinates.items()}
        data = xr.Dataset(variables, coordinates, self.attributes)
        return data.assign_coords(self.attributes[LABELS])


@dataclass(frozen=True)
class Store:
    """An open store of `dies` dies in chunks of `chunk`."""

    path: Path
    group: Any  # a zarr.Group, whose members zarr types as array or group
    dies: int
    chunk: int

    @classmethod
    def create(cls, path: Path, layout: Layout, dies: int, chunk: int) -> "Store":
        """A new store; complete under `path` or not there at all. Raises `InputError` when one is there."""
        import zarr

        if path.exists():
            raise InputError(f"{path} exists already; add `--resume` to go on with it, or choose another folder.")
        path.parent.mkdir(parents=True, exist_ok=True)
        draft = path.with_name(path.name + ".part")
        shutil.rmtree(draft, ignore_errors=True)
        group = zarr.create_group(draft, zarr_format=3)
        group.attrs.update(layout.attributes)
        group.attrs["coordinates"] = " ".join(layout.coordinates)  # tells xarray what is no variable
        for name, (dimension, values, unit) in layout.coordinates.items():
            values = np.asarray(values)
            array = group.create_array(name, shape=values.shape, dtype=values.dtype, dimension_names=(dimension,))
            array[:] = values
            array.attrs["units"] = unit
        status = group.create_array(
            STATUS, shape=(dies,), chunks=(chunk,), dtype="int8", fill_value=PENDING, dimension_names=("die",)
        )
        status.attrs["meaning"] = ", ".join(f"{value} {words}" for value, words in MEANING.items())
        for name, column in layout.columns.items():
            array = group.create_array(
                name,
                shape=(dies, *column.sizes),
                chunks=(chunk, *column.sizes),
                dtype="float64",
                fill_value=np.nan,
                dimension_names=("die", *column.dimensions),
            )
            array.attrs["units"] = column.unit
        draft.rename(path)
        return cls.open(path)

    @classmethod
    def open(cls, path: Path) -> "Store":
        """An existing store; raises `InputError` for something else."""
        import zarr

        try:
            group: Any = zarr.open_group(path, mode="r+")
            status = group[STATUS]
            return cls(path, group, status.shape[0], status.chunks[0])
        except (KeyError, OSError, ValueError, zarr.errors.BaseZarrError) as error:
            raise InputError(f"{path} is not the store of a sweep; remove it or choose another folder.") from error

    def require(self, fingerprint: str, chunk: int) -> None:
        """Raise `InputError` unless the store holds the same computation, cut in the same chunks."""
        if self.group.attrs.get("fingerprint") != fingerprint:
            raise InputError(
                f"{self.path} was computed from another configuration (fingerprint "
                f"{self.group.attrs.get('fingerprint')} instead of {fingerprint}); "
                "choose another folder, or repeat the settings it was made with."
            )
        if self.chunk != chunk:
            raise InputError(
                f"{self.path} was cut in blocks of {self.chunk} dies, this run would cut {chunk}; "
                "resume with the chunk size it was made with."
            )

    def resize(self, dies: int) -> None:
        """Make room for more dies; what is there stays. Fewer dies are refused."""
        if dies < self.dies:
            raise InputError(f"{self.path} holds {self.dies} dies; resume with at least as many, but {dies} was given.")
        for _, array in self._columns():
            array.resize((dies, *array.shape[1:]))
        object.__setattr__(self, "dies", dies)

    def pending(self) -> list[int]:
        """Numbers of the chunks that are not finished; a chunk that cannot be read counts as not finished."""
        return [number for number in range(-(-self.dies // self.chunk)) if not self._finished(number)]

    def write(self, number: int, rows: dict[str, np.ndarray]) -> None:
        """Write chunk `number`, the status last. Rows beyond the number of dies are dropped."""
        start, stop = number * self.chunk, min((number + 1) * self.chunk, self.dies)
        for name, values in rows.items():
            if name != STATUS:
                self.group[name][start:stop] = values[: stop - start]
        self.group[STATUS][start:stop] = rows[STATUS][: stop - start]

    def rows(self) -> dict[str, np.ndarray]:
        """All columns and the status, read back; dies that were never computed have status -1 and NaN."""
        return {name: array[:] for name, array in self._columns()}

    def _columns(self) -> Iterator[tuple[str, Any]]:
        """Name and array of everything that has a row per die."""
        for name, array in self.group.arrays():
            if (array.metadata.dimension_names or ("",))[0] == "die":
                yield name, array

    def _finished(self, number: int) -> bool:
        start, stop = number * self.chunk, min((number + 1) * self.chunk, self.dies)
        try:
            return bool(np.all(self.group[STATUS][start:stop] != PENDING))
        except (OSError, RuntimeError, ValueError):  # a half-written chunk after a kill
            return False
