"""What a result carries to be repeated: settings, seed, versions, and a fingerprint of what was computed."""

import functools
import hashlib
import platform
from dataclasses import asdict, dataclass
from importlib.metadata import version

import equinox as eqx
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
    packages = tuple((name, version(name)) for name in ("jax", "jaxlib", "equinox", "numpy"))
    return (("python", platform.python_version()), ("memsgyro_jax", __version__), *packages)


def fingerprint(*objects: object) -> str:
    """16 hexadecimal digits that change with any number or structure in `objects`."""
    digest = hashlib.sha256()
    arrays, structure = eqx.partition(objects, eqx.is_array)
    digest.update(str(jax.tree.structure(arrays)).encode())
    digest.update(repr(jax.tree.leaves(structure)).encode())
    for leaf in jax.tree.leaves(arrays):
        value = np.asarray(leaf)
        digest.update(f"{value.dtype}{value.shape}".encode() + value.tobytes())
    return digest.hexdigest()[:16]
