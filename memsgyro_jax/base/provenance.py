"""What a result carries to be repeated: settings, seed, versions, and a fingerprint of what was computed."""

import functools
import hashlib
import platform
import types
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, is_dataclass
from importlib.metadata import version
from typing import Any

import jax
import numpy as np

from memsgyro_jax import __version__

from .concrete import is_concrete, settled


@dataclass(frozen=True)
class Settings:
    """Sample rate in Hz, duration in s, seed, fingerprint of the computed objects, versions of what computed them.

    Of a run inside `jax.vmap` or `jax.jit` the fingerprint is empty, and the seed None where it is traced itself.
    """

    sample_rate: float
    duration: float
    seed: int | None
    fingerprint: str
    versions: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, *objects: object, sample_rate: float, duration: float, seed: int) -> "Settings":
        """Settings of a run of `objects` (loop, scenario, ...), whose every number enters the fingerprint."""
        computed = settled((*objects, sample_rate, duration, seed))
        digits = fingerprint(*computed) if is_concrete(computed) else ""
        return cls(float(sample_rate), float(duration), int(seed) if is_concrete(seed) else None, digits, versions())

    def as_dict(self) -> dict[str, object]:
        """Flat entries for attributes and JSON."""
        entries = asdict(self)
        entries["versions"] = ", ".join(f"{name} {number}" for name, number in self.versions)
        return entries


@functools.cache
def versions() -> tuple[tuple[str, str], ...]:
    """Versions of Python, this package, and what it computes with."""
    packages = tuple((name, version(name)) for name in ("jax", "jaxlib", "equinox", "diffrax", "numpy", "scipy"))
    return (("python", platform.python_version()), ("memsgyro_jax", __version__), *packages)


def fingerprint(*objects: object) -> str:
    """16 hexadecimal digits that change with any number or structure in `objects`, whatever they print, and with any of
    the `versions`, which decide the last bits of a result.

    A number counts alike as a float and as an array of one entry; functions count by their name and code.
    """
    digest = hashlib.sha256(repr(versions()).encode())
    for part in _parts(objects):
        digest.update(part)
        digest.update(b"\0")
    return digest.hexdigest()[:16]


def _parts(value: Any) -> Iterator[bytes]:
    """Everything that makes a value what it is, from the outside in."""
    if isinstance(value, float | np.generic | np.ndarray | jax.Array):
        array = np.asarray(value)
        yield f"{array.dtype}{array.shape}".encode() + array.tobytes()
        return
    kind = type(value)
    yield f"{kind.__module__}.{kind.__qualname__}".encode()
    if is_dataclass(kind) and not isinstance(value, type):
        yield from _parts({field.name: getattr(value, field.name) for field in fields(value)})
    elif isinstance(value, dict):
        for name, held in value.items():
            yield from (*_parts(name), *_parts(held))
    elif isinstance(value, tuple | list | set | frozenset):
        yield str(len(value)).encode()
        for held in value if isinstance(value, tuple | list) else sorted(value):
            yield from _parts(held)
    elif isinstance(value, types.FunctionType):
        yield f"{value.__module__}.{value.__qualname__}".encode()
        held = tuple(cell.cell_contents for cell in value.__closure__ or ())
        yield from _parts((value.__code__, value.__defaults__, value.__kwdefaults__, held))
    elif isinstance(value, types.CodeType):
        yield from _parts((value.co_code, value.co_names, value.co_consts))
    elif isinstance(value, functools.partial):
        yield from _parts((value.func, value.args, value.keywords))
    else:
        yield repr(value).encode()
