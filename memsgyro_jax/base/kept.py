"""Programs of which the tracing is kept on disk, beside what JAX keeps of their compilation.

JAX finds a compiled program again by its text, and to have the text a process must trace the function and lower it,
which takes longer than all the rest of a program that runs a few times. Here the text is found by what decides it: the
source of this package, the function, and the structure and shapes of its arguments.
"""

import contextlib
import dataclasses
import functools
import hashlib
import pickle
import shutil
import threading
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax import export

from .files import write_whole


_PACKAGE = Path(__file__).parent.parent
_SOURCES = 8  # versions of the source of which programs stay on disk
_KNOWN = (_PACKAGE.name, "equinox")  # packages whose classes and functions are told by their names


class _Foreign(Exception):
    """Something that the source of this package does not tell: a user's own effect, a function in a function."""


class _Program(NamedTuple):
    """A compiled program from a list of arrays to one, and a tree whose leaves are their numbers."""

    run: Callable[..., list]
    outcome: Any


def kept(function: Callable[..., Any], options: dict[str, Any] | None = None) -> Callable[..., Any]:
    """`eqx.filter_jit` of a function of arrays to arrays, whose tracing is kept for later processes.

    Nothing is kept where no compiled programs are, nor of what a user wrote.

    Args:
        function: of a module, by name.
        options: for the compiler.
    """
    more: Any = {"compiler_options": options} if options else {}
    plain, lock = eqx.filter_jit(function, **more), threading.Lock()
    programs: dict[Any, tuple[threading.Lock, list[_Program | None]]] = {}

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        leaves, tree = jax.tree.flatten(arguments)
        if _folder() is None or any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            return plain(*arguments)
        arrays = [leaf for leaf in leaves if eqx.is_array(leaf)]
        key = tree, *((leaf.shape, leaf.dtype) if eqx.is_array(leaf) else leaf for leaf in leaves)
        with lock:
            mine = programs.setdefault(key, (threading.Lock(), []))
        with mine[0]:
            if not mine[1]:
                mine[1].append(_program(function, options, arguments))
        (program,) = mine[1]
        if program is None:
            return plain(*arguments)
        return jax.tree.map(program.run(*arrays).__getitem__, program.outcome)

    return call


def _program(function: Callable[..., Any], options: dict[str, Any] | None, arguments: tuple) -> _Program | None:
    """The program from disk, or traced and put there; `None` where it cannot be kept."""
    try:
        told = [_told(function), _told(arguments), repr(options), jax.default_backend(), _settings()]
    except _Foreign:
        return None
    folder = _folder()
    if folder is None:
        return None
    place = folder / hashlib.sha256("\n".join(told).encode()).hexdigest()
    try:
        exported, outcome = pickle.loads(place.read_bytes())
    except Exception:  # not there, or damaged: as if it had never been
        try:
            exported, outcome = _traced(function, arguments)
            content = pickle.dumps((dataclasses.replace(exported, _get_vjp=None), outcome))
        except Exception:  # what cannot be exported runs as it always did, and says what is wrong with it
            return None
        with contextlib.suppress(OSError):
            write_whole(place, content)
    return _Program(jax.jit(exported.call, compiler_options=options), outcome)


def _traced(function: Callable[..., Any], arguments: tuple) -> tuple[export.Exported, Any]:
    """The text of a program from arrays to arrays, and what it makes of its arguments, a number for each array."""
    dynamic, static = eqx.partition(arguments, eqx.is_array)
    leaves, tree = jax.tree.flatten(dynamic)
    outcome = []

    def flat(*arrays: Any) -> list:
        found = function(*eqx.combine(jax.tree.unflatten(tree, arrays), static))
        parts, structure = jax.tree.flatten(found)
        outcome.append(jax.tree.unflatten(structure, range(len(parts))))
        return parts

    exported = export.export(jax.jit(flat))(*leaves)
    return exported, outcome[-1]


def _told(part: Any) -> str:
    """What decides a program, in words: names of classes and functions, structure, shapes, and numbers that are none of
    its arguments.
    """
    if isinstance(part, jax.Array | np.ndarray | np.generic):
        return f"{part.dtype}{part.shape}{getattr(part, 'weak_type', False)}"
    if part is None or isinstance(part, bool | int | float | complex | str | bytes):
        return repr(part)
    if isinstance(part, dict):
        return f"{{{', '.join(f'{_told(name)}: {_told(entry)}' for name, entry in part.items())}}}"
    if isinstance(part, tuple | list):
        return f"{_name(type(part))}({', '.join(map(_told, part))})"
    if isinstance(part, type) or (callable(part) and hasattr(part, "__qualname__")):
        return _name(part)
    if isinstance(part, eqx.Module):
        fields = ((field.name, getattr(part, field.name, None)) for field in dataclasses.fields(part))
        return f"{_name(type(part))}({', '.join(f'{name}={_told(entry)}' for name, entry in fields)})"
    raise _Foreign


def _name(what: Any) -> str:
    """Full name of a class or function of a package whose source is known."""
    room = str(what.__module__).split(".")[0]
    if room not in (*_KNOWN, "builtins") or "<" in what.__qualname__ or getattr(what, "__closure__", None):
        raise _Foreign
    return f"{what.__module__}.{what.__qualname__}"


def _settings() -> str:
    """What JAX is told for all programs."""
    names = "jax_enable_x64", "jax_default_matmul_precision", "jax_debug_nans", "jax_numpy_rank_promotion"
    return " ".join(f"{name}={getattr(jax.config, name)}" for name in names)


def _source() -> str | None:
    """Digits that tell the source of this package and the versions below it; `None` where there is none to read."""
    files = sorted(_PACKAGE.rglob("*.py"))
    found = hashlib.sha256(" ".join(version(name) for name in ("jax", "jaxlib", "equinox")).encode())
    for file in files:
        found.update(file.relative_to(_PACKAGE).as_posix().encode() + file.read_bytes())
    return found.hexdigest()[:16] if files else None


def _folder() -> Path | None:
    """Where programs are kept; `None` where JAX keeps none either."""
    compiled = jax.config.jax_compilation_cache_dir
    return _folder_beside(compiled) if compiled else None


@functools.cache
def _folder_beside(compiled: str) -> Path | None:
    """The folder of programs of this source, within that of the compiled ones; those of the oldest sources go."""
    whole, source = Path(compiled) / "traced", _source()
    if source is None:
        return None
    with contextlib.suppress(OSError):
        (whole / source).mkdir(parents=True, exist_ok=True)
        (whole / source).touch()
        for old in sorted(whole.iterdir(), key=lambda one: one.stat().st_mtime)[:-_SOURCES]:
            shutil.rmtree(old, ignore_errors=True)
    return whole / source
