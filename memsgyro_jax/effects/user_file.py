"""A user's own effects: a Python file in, instances out, or one sentence that says what to mend."""

import ast
import importlib.util
import inspect
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.units import to_si

from .axes import needed_axes, variants
from .base import Effect
from .catalogue import CATALOGUE
from .trial import PORT_METHODS, at_strength, complaint


MODULE = "memsgyro_effects_of_user"


def load_effects(path: str | Path, axes: int = 2) -> tuple[Effect, ...]:
    """Effects that a Python file defines, at strength zero, for a device with so many axes.

    These are the instances in the file's `EFFECTS`, or without it one instance for every axis of every subclass of an
    effect that the file defines and does not itself subclass further. Running a file is running a program: load only
    what you would run.

    Raises:
        InputError: with file and line, if the file does not run, holds no effect, or holds one that lacks a name, unit
            or method, has the name of another, or breaks a promise of the port (shape, zero means absent, finite).
    """
    path = Path(path)
    source = _read(path)
    module = _run(path, source)
    lines = {node.name: node.lineno for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ClassDef)}

    def at(kind: type) -> str:
        return f"{path}, line {lines[kind.__name__]}" if kind.__name__ in lines else str(path)

    given = getattr(module, "EFFECTS", None)
    if given is None:
        kinds = _final_effects(module)
        for kind in kinds:
            _check_class(kind, at(kind))
        effects = [effect for kind in kinds for effect in _instances(kind, axes, path, at(kind))]
    else:
        effects = _listed(given, path)
        for kind in dict.fromkeys(map(type, effects)):
            _check_class(kind, at(kind))
    if not effects:
        raise InputError(
            f"{path}: must define an effect for {axes} axes, a subclass of `memsgyro_jax.effects.ForceEffect`, "
            "`DriveEffect`, `ReadoutEffect` or `SweepEffect`, but defines none."
        )
    checked = tuple(_checked(effect, axes, path, at(type(effect))) for effect in effects)
    _check_names(checked, at)
    return checked


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: must be a Python file in UTF-8, but byte {error.start} is not.") from error
    except OSError as error:
        raise InputError(f"{path}: must be a readable Python file, but: {error.strerror}.") from error


def _run(path: Path, source: str) -> ModuleType:
    spec = importlib.util.spec_from_loader(MODULE, loader=None, origin=str(path))
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    module.__file__ = str(path)
    before = sys.modules.get(MODULE)
    sys.modules[MODULE] = module  # dataclasses look the module of a class up
    try:
        exec(compile(source, str(path), "exec"), module.__dict__)
    except SyntaxError as error:
        raise InputError(f"{path}, line {error.lineno}: must be valid Python, but: {error.msg}.") from error
    except (Exception, SystemExit) as error:
        raise InputError(f"{_place(error, path, str(path))}: must run, but: {_said(error)}.") from error
    finally:
        if before is None:
            del sys.modules[MODULE]
        else:
            sys.modules[MODULE] = before
    return module


def _final_effects(module: ModuleType) -> list[type[Effect]]:
    """Effect classes of the file in its order, without those that others of the file build on."""
    own: list[type[Effect]] = [
        value
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, Effect) and value.__module__ == MODULE
    ]
    own = list(dict.fromkeys(own))
    return [kind for kind in own if not any(other is not kind and issubclass(other, kind) for other in own)]


def _listed(given: Any, path: Path) -> list[Effect]:
    if not isinstance(given, tuple | list):
        raise InputError(f"{path}: `EFFECTS` must be a tuple of effects, but is of type {type(given).__name__}.")
    for entry in given:
        if not isinstance(entry, Effect):
            hint = "; write `()` behind the class" if isinstance(entry, type) else ""
            raise InputError(f"{path}: every entry of `EFFECTS` must be an effect, but one is {entry!r}{hint}.")
    return list(given)


def _check_class(kind: type[Effect], place: str) -> None:
    name = kind.__name__
    ports = " or ".join(f"`{port.__name__}`" for port in PORT_METHODS)
    if not issubclass(kind, tuple(PORT_METHODS)):
        raise InputError(f"{place}: effect `{name}` must be a subclass of {ports}, but is none.")
    if inspect.isabstract(kind):
        missing = ", ".join(f"`{method}`" for method in sorted(kind.__abstractmethods__))
        raise InputError(f"{place}: effect `{name}` must have the method {missing}, but has not.")
    if getattr(kind, "__abstractvars__", None):
        raise InputError(
            f"{place}: effect `{name}` must have the field `strength: Array = memsgyro_jax.effects.strength()`, "
            "but has not."
        )
    for field, example in (("name", '"my_effect"'), ("unit", '"N/m³", or "1" for a pure number')):
        said = any(field in vars(base) for base in kind.__mro__ if base.__module__ != Effect.__module__)
        if not (said and isinstance(getattr(kind, field), str) and getattr(kind, field).strip()):
            raise InputError(f"{place}: effect `{name}` must have a {field}, e.g. `{field} = {example}`, but has none.")
    if not kind.name.isidentifier():
        raise InputError(f'{place}: the name of effect `{name}` must be one word, but is "{kind.name}".')
    to_si(1.0, kind.unit, kind.unit, f"effect `{name}` ({place})")


def _instances(kind: type[Effect], axes: int, path: Path, place: str) -> tuple[Effect, ...]:
    return _tried(lambda: variants(kind, axes), path, place, f"effect `{kind.__name__}` must be made without arguments")


def _checked(effect: Effect, axes: int, path: Path, place: str) -> Effect:
    """The effect at strength zero, if it is as it should be."""
    label = f"effect `{effect.label}`"
    if needed_axes(effect) > axes:
        raise InputError(f"{place}: {label} must fit a device with one axis, but needs {needed_axes(effect)}.")
    if not (isinstance(effect.strength, Array) and jnp.issubdtype(effect.strength.dtype, jnp.floating)):
        raise InputError(
            f"{place}: {label} must have the field `strength: Array = memsgyro_jax.effects.strength()`, "
            f"but its strength is {effect.strength!r}."
        )
    effect = at_strength(effect, jnp.zeros(effect.strength.shape))
    if found := _tried(lambda: complaint(effect, axes), path, place, f"{label} must be computable"):
        raise InputError(f"{place}: {label}: {found}.")
    return effect


def _check_names(effects: tuple[Effect, ...], at: Callable[[type], str]) -> None:
    known = {kind.name for kind in CATALOGUE}
    seen: set[tuple[str, str]] = set()
    for effect in effects:
        wanted = f"{at(type(effect))}: an effect must have a name of its own"
        if effect.name in known:
            raise InputError(f"{wanted}, but `{effect.name}` is in the catalogue; rename it.")
        if (effect.name, effect.where) in seen:
            raise InputError(f"{wanted}, but two are called `{effect.label}`; rename one.")
        seen.add((effect.name, effect.where))


def _tried(action: Callable[[], Any], path: Path, place: str, wanted: str) -> Any:
    try:
        return action()
    except Exception as error:
        raise InputError(f"{_place(error, path, place)}: {wanted}, but: {_said(error)}.") from error


def _place(error: BaseException, path: Path, otherwise: str) -> str:
    """The line of the file that an error came from, where it came from the file."""
    numbers = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    return f"{path}, line {numbers[-1]}" if numbers else otherwise


def _said(error: BaseException) -> str:
    """An error in one line, without the closing full stop."""
    if isinstance(error, jax.errors.TracerBoolConversionError):
        return "it branches on a number; choose with `jax.numpy.where` instead of `if`"
    first = str(error).strip().split("\n")[0].rstrip(".: ")
    return f"{type(error).__name__}: {first}" if first else type(error).__name__
