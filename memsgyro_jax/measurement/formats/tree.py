"""Numbers in a tree of names: HDF5 (NetCDF-4 and newer MAT files too), MAT and NetCDF-3, LabOne's among them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from memsgyro_jax.base.errors import InputError

from .base import Format, SourceTable, complex_columns, library
from .header import split_header, tidy_unit
from .labone import demodulated
from .steady_step import step_of_samples
from .structures import Leaf, shared_tables


_DEMODULATOR = {"x", "y"}
_NAME_KEYS = ("names", "columns", "channels", "channel_names", "labels", "column_names")
_UNIT_KEYS = ("units", "unit", "Unit", "Units", "unit_string")


class Hdf5(Format):
    """HDF5, which MAT files of version 7.3 and NetCDF-4 are."""

    name = "HDF5"

    def recognises(self, path: Path, head: bytes) -> bool:
        return any(head[at : at + 8] == b"\x89HDF\r\n\x1a\n" for at in (0, 512, 1024, 2048))

    def read(self, path: Path) -> tuple[SourceTable, ...]:
        h5py = library("h5py", "h5py", path)
        with h5py.File(path, "r") as file:
            return _tables(path, _of_group(file, h5py))


class Mat(Format):
    """MAT files of versions 4 to 7.2."""

    name = "MAT"

    def recognises(self, path: Path, head: bytes) -> bool:
        return head.startswith(b"MATLAB 5.0") or path.suffix.lower() == ".mat"

    def read(self, path: Path) -> tuple[SourceTable, ...]:
        from scipy.io import loadmat

        content = loadmat(path, struct_as_record=False, squeeze_me=True, chars_as_strings=True)
        return _tables(path, _of_mat({k: v for k, v in content.items() if not k.startswith("__")}))


class NetCdf3(Format):
    """NetCDF of the classic format."""

    name = "NetCDF"

    def recognises(self, path: Path, head: bytes) -> bool:
        return head[:3] == b"CDF" and head[3:4] in (b"\x01", b"\x02")

    def read(self, path: Path) -> tuple[SourceTable, ...]:
        from scipy.io import netcdf_file

        with netcdf_file(path, mmap=False) as file:
            leaves = {
                name: Leaf(np.array(v.data, v.data.dtype.newbyteorder("=")), _word(getattr(v, "units", "")))
                for name, v in file.variables.items()
            }
        return _tables(path, leaves)


def _of_group(group: Any, h5py: Any) -> dict[str, Any]:
    """The tree below an HDF5 group, with scalar attributes as text."""
    tree: dict[str, Any] = {f"@{key}": _word(value) for key, value in group.attrs.items() if np.size(value) == 1}
    for key in group:
        item = group[key]
        if key == "#refs#":
            continue
        if isinstance(item, h5py.Group):
            tree[key] = _of_group(item, h5py)
            continue
        for name, value in item.attrs.items():  # of a column about the whole: what a lock-in used, steps of its rows
            if np.size(value) == 1 and ("freq" in name.lower() or step_of_samples({name: _word(value)})[0]):
                tree.setdefault(f"@{name}", _word(value))
        unit = next((_word(item.attrs[k]) for k in _UNIT_KEYS if k in item.attrs), "")
        if item.dtype.names and {"real", "imag"} <= {*item.dtype.names}:  # a complex number of MATLAB
            tree[key] = Leaf(item["real"] + 1j * item["imag"], unit)
        elif item.dtype.names:
            rows = item[()]
            tree[key] = {name: Leaf(np.asarray(rows[name])) for name in item.dtype.names}
        elif item.dtype.kind in "iufc":
            tree[key] = Leaf(np.asarray(item[()]), unit, _words_of(item, _NAME_KEYS), _words_of(item, _UNIT_KEYS))
    return tree


def _words_of(item: Any, keys: tuple[str, ...]) -> tuple[str, ...]:
    """What an attribute says of each column of a matrix; empty where none does."""
    columns = item.shape[1] if len(item.shape) == 2 else 0
    found = (np.ravel(item.attrs[key]) for key in keys if key in item.attrs)
    return next((tuple(map(_word, words)) for words in found if columns == len(words)), ())


def _of_mat(value: Any) -> Any:
    """The tree of what `loadmat` gives: structures by their fields, cells and arrays of structures by number."""
    if isinstance(value, dict):
        return {key: _of_mat(entry) for key, entry in value.items()}
    if hasattr(value, "_fieldnames"):
        return {key: _of_mat(getattr(value, key)) for key in value._fieldnames}
    if isinstance(value, np.ndarray) and value.dtype == object:
        return {str(n): _of_mat(entry) for n, entry in enumerate(value.ravel())}
    if isinstance(value, np.ndarray) and value.dtype.kind in "iufc":
        return Leaf(value)
    return Leaf(np.asarray(value)) if isinstance(value, int | float | complex | np.number) else {}


def _tables(path: Path, tree: Mapping[str, Any]) -> tuple[SourceTable, ...]:
    tables = list(_walk(path, "", tree, {}))
    if not tables:
        raise InputError(f"{path}: must hold columns of numbers of one length, but holds none.")
    return tuple(tables)


def _walk(path: Path, place: str, tree: Mapping[str, Any], above: Mapping[str, str]):
    """A table of each place that holds columns, demodulators by the meaning of their fields."""
    leaves = {key: leaf for key, leaf in tree.items() if isinstance(leaf, Leaf)}
    scalars = {k: str(leaf.values.ravel()[0]) for k, leaf in leaves.items() if leaf.values.size == 1}
    scalars |= {f"{k}_unit": leaf.unit for k, leaf in leaves.items() if leaf.values.size == 1 and leaf.unit}
    attributes = {**above, **{k[1:]: v for k, v in tree.items() if k[0] == "@" and isinstance(v, str)}, **scalars}
    for name, entry in tree.items():
        if name in ("chunkheader", "header") and isinstance(entry, dict):  # beside the samples it is about
            attributes |= {
                k: str(v.values.ravel()[0]) for k, v in entry.items() if isinstance(v, Leaf) and v.values.size
            }
    columns = {key: leaf for key, leaf in leaves.items() if max(leaf.values.shape, default=0) == leaf.values.size > 1}
    lengths = [leaf.values.size for leaf in columns.values()]
    rows = max(sorted(set(lengths)), key=lengths.count) if lengths else 0
    kept = {key: leaf for key, leaf in columns.items() if leaf.values.size == rows}
    shared, taken = shared_tables(kept, tree)
    for name, placed in shared.items():
        joined = tuple(column for before, some in placed for column in _columns(some, before))
        yield SourceTable(path, f"{place}/{name}".strip("/"), joined, attributes)
    lone = any(leaf.values.dtype.kind == "c" for leaf in kept.values()) or bool(kept and step_of_samples(attributes)[0])
    if not taken and (len(kept) > 1 or lone):
        if {*kept} > _DEMODULATOR and {*kept} & {"frequency", "grid", "timestamp"}:
            yield from demodulated(path, place, {k: leaf.values.ravel() for k, leaf in kept.items()}, attributes)
        else:
            yield SourceTable(path, place, tuple(_columns(kept)), attributes)
    for key, leaf in leaves.items():  # a plain matrix is a table without a header
        if not kept and leaf.values.ndim == 2 and 1 < leaf.values.shape[1] <= 64 < leaf.values.size:
            yield SourceTable(path, place, tuple(_of_matrix(key, leaf)), attributes)
    for key, entry in tree.items():
        if isinstance(entry, dict) and key not in ("chunkheader", "header", *taken):
            yield from _walk(path, f"{place}/{key}".strip("/"), entry, attributes)


def _of_matrix(key: str, leaf: Leaf):
    for n in range(leaf.values.shape[1]):
        name, unit = split_header(leaf.names[n]) if leaf.names else (f"{key} {n + 1}", "")
        unit = (tidy_unit(leaf.units[n]) if leaf.units else "") or tidy_unit(leaf.unit) or unit
        yield from complex_columns(name, unit, leaf.values[:, n])


def _columns(leaves: Mapping[str, Leaf], before: str = ""):
    for key, leaf in leaves.items():
        name, unit = split_header(key)
        yield from complex_columns(f"{before}{name}", tidy_unit(leaf.unit) or unit, leaf.values.ravel())


def _word(value: Any) -> str:
    if isinstance(value, np.ndarray):
        value = value.ravel()[0] if value.size else ""
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
