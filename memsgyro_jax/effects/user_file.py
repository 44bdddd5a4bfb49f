"""A user's own effects: a Python file in, instances out, or one sentence that says what to mend."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.units import to_si
from memsgyro_jax.base.user_file import in_one_line, line_of, run_user_file

from .axes import needed_axes, variants
from .base import Effect, ForceEffect
from .catalogue import CATALOGUE, OF_OPERATION
from .trial import PORT_METHODS, at_strength, complaint


def load_effects(path: str | Path, axes: int = 2, *, as_written: bool = False) -> tuple[Effect, ...]:
    """Effects that a Python file defines, at strength zero, for a device with so many axes.

    With `as_written` their strengths are those of the file, from which a fit may start.

    These are the instances in the file's `EFFECTS`, or without it one instance for every axis of every subclass of an
    effect that the file defines and does not itself subclass further. Running a file is running a program: load only
    what you would run.

    Raises:
        InputError: with file and line, if the file does not run, holds no effect, or holds one that lacks a name, unit
            or method, has the name of another, or breaks a promise of the port (shape, zero means absent, finite).
    """
    file = run_user_file(path)
    path, at = file.path, file.at
    given = getattr(file.module, "EFFECTS", None)
    if given is None:
        kinds = file.final(Effect)
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
    return tuple(effects) if as_written else checked


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
            f"{place}: effect `{name}` must have the field `strength: fx.Scalar = fx.strength()` of "
            "memsgyro_jax.effects, but has not."
        )
    for field, example in (("name", '"my_effect"'), ("unit", '"N/m³", or "1" for a pure number')):
        said = any(field in vars(base) for base in kind.__mro__ if base.__module__ != Effect.__module__)
        if not (said and isinstance(getattr(kind, field), str) and getattr(kind, field).strip()):
            raise InputError(f"{place}: effect `{name}` must have a {field}, e.g. `{field} = {example}`, but has none.")
    if issubclass(kind, ForceEffect) and (missing := kind.unmoved()):
        raise InputError(f"{place}: effect `{name}` must have {missing}.")
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
            f"{place}: {label} must have the field `strength: fx.Scalar = fx.strength()` of memsgyro_jax.effects, "
            f"but its strength is {effect.strength!r}."
        )
    effect = at_strength(effect, jnp.zeros(effect.strength.shape))
    if found := _tried(lambda: complaint(effect, axes), path, place, f"{label} must be computable"):
        raise InputError(f"{place}: {label}: {found}.")
    return effect


def _check_names(effects: tuple[Effect, ...], at: Callable[[type], str]) -> None:
    known = {kind.name for kind in (*CATALOGUE, *OF_OPERATION)}
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
        raise InputError(f"{line_of(error, path, place)}: {wanted}, but: {in_one_line(error)}.") from error
