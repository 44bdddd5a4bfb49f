"""What a result carries to be repeated: settings, seed, versions, and a fingerprint of what was computed."""

import functools
import hashlib
import inspect
import platform
import sys
import types
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, is_dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np

from memsgyro_jax import __version__

from .concrete import is_concrete, settled


Told = Callable[[bytes], None]


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

    A number counts alike as a float and as an array of one entry. Functions count by their code and by the numbers and
    functions of their file that they name, classes that are no package's by those of their methods.
    """
    parts = b"".join(part + b"\0" for part in _parts(objects))
    return hashlib.sha256(repr(versions()).encode() + parts).hexdigest()[:16]


def _parts(value: Any) -> list[bytes]:
    """Everything that makes a value what it is, from the outside in."""
    parts: list[bytes] = []
    _gather(value, set(), parts.append)
    return parts


def _gather(value: Any, seen: set[object], told: Told) -> None:
    """Hand on what makes a value what it is; of `seen` functions and classes the name alone."""
    if isinstance(value, _NUMBERS):
        array = np.asarray(value)
        return told(_kind_of_array(array.dtype, array.shape) + array.tobytes())
    kind = type(value)
    told(_name_of(kind))
    if kind is str:
        told(repr(value).encode())
    elif is_dataclass(kind):
        _methods(kind, seen, told)
        held = getattr(value, "__dict__", {})  # a module's own look-up is slow
        names = [field.name for field in fields(value)]
        _gather({name: held[name] if name in held else getattr(value, name) for name in names}, seen, told)
    elif isinstance(value, dict):
        for entry in value.items():
            for part in entry:
                _gather(part, seen, told)
    elif isinstance(value, tuple | list | set | frozenset):
        told(str(len(value)).encode())
        for held in value if isinstance(value, tuple | list) else sorted(value, key=repr):
            _gather(held, seen, told)
    elif isinstance(value, type):
        told(repr(value).encode())
        _methods(value, seen, told)
    elif isinstance(inspect.unwrap(value), types.FunctionType) if callable(value) else False:
        _function(inspect.unwrap(value), seen, told)
    elif isinstance(value, types.CodeType):
        _gather((value.co_code, value.co_names, value.co_consts), seen, told)
    elif isinstance(value, functools.partial):
        _gather((value.func, value.args, value.keywords), seen, told)
    else:
        told(repr(value).encode())
    return None


@functools.cache
def _name_of(kind: type) -> bytes:
    return f"{kind.__module__}.{kind.__qualname__}".encode()


@functools.cache
def _kind_of_array(dtype: np.dtype, shape: tuple[int, ...]) -> bytes:
    return f"{dtype}{shape}".encode()


def _function(function: types.FunctionType, seen: set[object], told: Told) -> None:
    """A function and what it names: constants of its file, and functions and classes that stand there too."""
    told(f"{function.__module__}.{function.__qualname__}".encode())
    held = tuple(cell.cell_contents for cell in function.__closure__ or ())
    _gather((function.__code__, function.__defaults__, function.__kwdefaults__, held), seen, told)
    if not _own(function) or function in seen:
        return
    seen.add(function)
    for name in sorted(_names(function.__code__) & set(function.__globals__)):
        named = function.__globals__[name]
        there = callable(named) and getattr(named, "__module__", None) == function.__module__
        if there or isinstance(named, _CONSTANTS) or (is_dataclass(named) and not isinstance(named, type)):
            _gather((name, named), seen, told)


def _methods(kind: type, seen: set[object], told: Told) -> None:
    """The methods that a class of the user's has, or inherits from another of them."""
    if kind in seen or not _own(kind):
        return
    seen.add(kind)
    for base in filter(_own, kind.__mro__):
        for name, method in vars(base).items():
            code = inspect.unwrap(getattr(method, "fget", None) or getattr(method, "func", None) or method)
            # Of the methods that Python reserves most are made by `dataclass`, and made anew in each process.
            if isinstance(code, types.FunctionType) and (name == "__call__" or not name.startswith("__")):
                _gather((name, code), seen, told)


_NUMBERS = (float, np.generic, np.ndarray, jax.Array)
_CONSTANTS = (bool, int, float, complex, str, bytes, tuple, np.generic, np.ndarray, jax.Array)


def _own(named: Any) -> bool:
    """Whether a class or function is the user's, rather than of an installed package."""
    root = str(named.__module__).split(".")[0]
    if root in sys.stdlib_module_names or root in ("builtins", __name__.split(".")[0]):
        return False
    place = Path(getattr(sys.modules.get(root), "__file__", None) or "")
    return not {"site-packages", "dist-packages"} & set(place.parts)


def _names(code: types.CodeType) -> set[str]:
    inner = [_names(constant) for constant in code.co_consts if isinstance(constant, types.CodeType)]
    return set(code.co_names).union(*inner)
