"""What the store of a sweep looks like: its columns, and the metadata they are read by."""

import contextlib
import functools
import json
import shutil
import uuid
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.labels import LABELS as LABELS
from memsgyro_jax.base.labels import labels_apart, with_labels

from .folder import Folder, RemotePath
from .status import MEANING, PENDING, STATUS


if TYPE_CHECKING:
    import xarray as xr

SCHEMA = "memsgyro-dies/3"
PROCESSOR = "processor"  # attribute: what kind of processor began a store
SEAL = "seal"
SHARD = 16384  # dies in a file of a column, at least where the store has as many
_METADATA = "zarr.json"
_MEANING = ", ".join(f"{value} {words}" for value, words in MEANING.items())


@dataclass(frozen=True)
class DieArray:
    """An array with one row per die: dimension names after `die`, their sizes, and the unit, None where they differ."""

    dimensions: tuple[str, ...]
    sizes: tuple[int, ...]
    unit: str | None

    @property
    def attributes(self) -> dict[str, str]:
        """What a file says of it."""
        return {} if self.unit is None else {"units": self.unit}


@dataclass(frozen=True, eq=False)
class Layout:
    """What a lot consists of: its columns, numeric coordinates as (dimension, values, unit), and attributes."""

    columns: dict[str, DieArray]
    coordinates: dict[str, tuple[str, np.ndarray, str]]
    attributes: dict[str, Any]

    def dataset(self, rows: dict[str, np.ndarray]) -> "xr.Dataset":
        """Rows and their status as a Dataset."""
        import xarray as xr

        held: dict[str, tuple] = {
            name: (("die", *of.dimensions), rows[name], of.attributes) for name, of in self.columns.items()
        }
        held[STATUS] = "die", rows[STATUS], {"meaning": _MEANING}
        coordinates = {name: (dim, values, {"units": unit}) for name, (dim, values, unit) in self.coordinates.items()}
        return with_labels(xr.Dataset(held, coordinates, self.attributes))


@functools.lru_cache(maxsize=1)  # who makes a store looks at once whether it is as it should be
def files_of(layout: Layout, dies: int, block: int) -> dict[str, bytes]:
    """Names and contents of the files of an empty store, by which any store of this layout can be read.

    The metadata of the status, which tell how many dies there are, come last.
    """
    import zarr
    from zarr.codecs import Crc32cCodec, ZstdCodec
    from zarr.storage import MemoryStore

    packed = {"compressors": [ZstdCodec(), Crc32cCodec()]}
    files: dict[str, Any] = {}
    attributes, names = labels_apart(layout.attributes)
    # The last entry tells xarray what is no variable.
    others = {
        "schema": SCHEMA,
        "block": block,
        "shard": blocks_per_shard(block),
        "coordinates": " ".join((*layout.coordinates, *names, SEAL)),
    }
    group = zarr.create_group(MemoryStore(files), zarr_format=3, attributes=attributes | others)
    for name, (dimension, texts) in names.items():
        written = np.array(texts, dtype=object)
        group.create_array(name, shape=len(texts), dtype=str, dimension_names=(dimension,), **packed)[:] = written
    for name, (dimension, values, unit) in layout.coordinates.items():
        about = {"dimension_names": (dimension,), "attributes": {"units": unit}}
        group.create_array(name, shape=np.shape(values), dtype=np.asarray(values).dtype, **about, **packed)[:] = values
    columns = {name: (column, "float64", np.nan, column.attributes) for name, column in layout.columns.items()}
    columns[SEAL] = (DieArray((), (), "1"), "uint64", 0, {"meaning": "checksum of the row"})
    columns[STATUS] = (DieArray((), (), "1"), "int8", PENDING, {"meaning": _MEANING})
    for name, (column, dtype, fill, attributes) in columns.items():
        group.create_array(
            name,
            shape=(dies, *column.sizes),
            chunks=(block, *column.sizes),
            shards=(block * blocks_per_shard(block), *column.sizes),
            dtype=dtype,
            fill_value=fill,
            dimension_names=("die", *column.dimensions),
            attributes=attributes,
            **packed,
        )
    contents = {name: content.to_bytes() for name, content in files.items()}
    return dict(sorted(contents.items(), key=lambda file: file[0] == f"{STATUS}/{_METADATA}"))


def blocks_per_shard(block: int) -> int:
    """Blocks of `block` dies that share a file per column: a million dies in a thousand files."""
    return max(1, SHARD // block)


def create(path: Path | RemotePath, layout: Layout, dies: int, block: int) -> None:
    """An empty store; complete under `path` or not there at all. Nothing happens if another process was faster."""
    if isinstance(path, RemotePath):  # a store is there when its own metadata are, which come last
        files = files_of(layout, dies, block)
        for name in sorted(files, key=lambda name: name == _METADATA):
            Folder(path).write(name, files[name])
        return
    draft = draft_path(path)
    try:
        for name, content in files_of(layout, dies, block).items():
            (draft / name).parent.mkdir(parents=True, exist_ok=True)
            (draft / name).write_bytes(content)
        draft.rename(path)
    except OSError:
        if not path.exists():
            raise
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def adapt(path: Path | RemotePath, layout: Layout, dies: int, block: int) -> list[str]:
    """Give the store at `path` room for all dies and metadata as they were when it was created; says what was amiss.

    Raises `InputError` unless it is a store of the same computation, of no more dies.
    """
    notes = []
    _require(path, layout, block)
    began, here = attributes_of(path).get(PROCESSOR), layout.attributes.get(PROCESSOR)
    if began != here:
        notes.append(
            f"{path} was begun on another kind of processor, whose rows may differ from this one's in last bits."
        )
        layout = replace(layout, attributes=layout.attributes | {PROCESSOR: began})
    if dies < (held := held_by(path) or 0):
        raise InputError(f"{path} holds {held} dies; resume with at least as many, but {dies} was given.")
    for name, wanted in files_of(layout, dies, block).items():
        place = path / name
        if (found := _read(place)) == wanted:
            continue
        if place.name != _METADATA or _grown(found, dies) != json.loads(wanted):
            notes.append(f"{place} was not as a sweep writes it, and was written anew.")
        Folder(path).write(name, wanted)
    return notes


def draft_path(path: Path) -> Path:
    """A name beside a folder that nobody else uses."""
    return path.with_name(f".{path.name}.{uuid.uuid4().hex}.part")


def _require(path: Path | RemotePath, layout: Layout, block: int) -> None:
    """Raise `InputError` unless the store holds the same computation, cut in the same blocks."""
    found, wanted = attributes_of(path), layout.attributes
    if not {"fingerprint", "schema"} <= set(found):
        raise InputError(f"{path} is not the store of a sweep; remove it or choose another folder.")
    if found["schema"] != SCHEMA or found.get("versions") != wanted["versions"]:
        raise InputError(
            f"{path} was written by another version ({found['schema']}; {found.get('versions')}), whose rows may "
            f"differ from those of this one ({SCHEMA}; {wanted['versions']}); use that or choose another folder."
        )
    if found["fingerprint"] != wanted["fingerprint"]:
        raise InputError(
            f"{path} was computed from another configuration (fingerprint {found['fingerprint']} instead of "
            f"{wanted['fingerprint']}); choose another folder, or repeat the settings it was made with."
        )
    if found.get("block") != block:
        raise InputError(
            f"{path} was cut in blocks of {found.get('block')} dies, this run would cut {block}; "
            f"resume with the `chunk` it was made with, {found.get('block', 0) / block:g} times that of this run."
        )


def attributes_of(path: Path | RemotePath) -> dict[str, Any]:
    """Attributes of a group; empty when it is none, or cannot be read."""
    document = _document(_read(path / _METADATA))
    attributes = document.get("attributes") if isinstance(document, dict) else None
    return attributes if isinstance(attributes, dict) else {}


def held_by(path: Path | RemotePath) -> int | None:
    """For how many dies a store was made; None when its metadata do not tell."""
    document = _document(_read(path / STATUS / _METADATA))
    shape = document.get("shape") if isinstance(document, dict) else None
    return shape[0] if isinstance(shape, list) and len(shape) == 1 and isinstance(shape[0], int) else None


def _grown(text: bytes | None, dies: int) -> Any:
    """The metadata of an array as they would be for so many dies."""
    document = _document(text)
    with contextlib.suppress(TypeError, KeyError, IndexError):
        if document["dimension_names"][0] == "die" and document["shape"][0] <= dies:
            document["shape"][0] = dies
    return document


def _document(text: bytes | None) -> Any:
    with contextlib.suppress(ValueError, RecursionError):
        return json.loads(text or b"")
    return None


def _read(place: Path | RemotePath) -> bytes | None:
    with contextlib.suppress(OSError):
        return place.read_bytes()
    return None
