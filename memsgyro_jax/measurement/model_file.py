"""A fitted model as a TOML file: base device per mass, read-out, reference conditions, and effects by name.

Numbers are written with all their digits, so that reading gives back the very same model.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from pydantic import Field, StrictFloat, StrictInt

from memsgyro_jax.base.complaints import Source
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import write_whole
from memsgyro_jax.base.quantity import FileSection
from memsgyro_jax.base.toml import checked, read_toml, toml_text
from memsgyro_jax.base.units import to_si
from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.effects import Effect, by_name, catalogue

from .model import Model


SCHEMA = "memsgyro-model/1"
_UNITS = {"stiffness": "rad²/s²", "damping": "1/s", "mobility": "1/kg"}
_PAIRS = {1: ("xx",), 2: ("xx", "yy", "xy")}
Number = StrictFloat | StrictInt
Numbers = Number | list[Number]


class _Matrix(FileSection):
    xx: Number
    yy: Number | None = None
    xy: Number | None = None
    unit: str


class _Scalar(FileSection):
    value: Number
    unit: str


class _Device(FileSection):
    stiffness: _Matrix
    damping: _Matrix
    mobility: _Scalar


class _Readout(FileSection):
    scale: list[Number]
    offset: list[Number]


class _Reference(FileSection):
    temperature: _Scalar
    bias_voltage: _Scalar


class _Effect(FileSection):
    name: str
    where: str = ""
    strength: Numbers
    unit: str
    settings: dict[str, Numbers] = Field(default_factory=dict)


class _File(FileSection):
    format: Literal["memsgyro-model/1"] = Field(alias="schema")
    device: _Device
    readout: _Readout
    reference: _Reference
    effect: list[_Effect] = Field(default_factory=list)


def write_model(model: Model, path: str | Path) -> Path:
    """Write a model whole or not at all; effects of strength zero are absent and left out.

    **Raises:** `InputError` where a number is not finite.
    """
    return write_whole(path, model_text(model))


def model_text(model: Model) -> str:
    """The text of a model file."""
    device, axes = model.device, model.axes
    lines = [f'schema = "{SCHEMA}"', "", "[device]"]
    for name in ("stiffness", "damping"):
        entries = zip(_PAIRS[axes], getattr(device, name), strict=True)
        numbers = ", ".join(f"{pair} = {_toml(value, name)}" for pair, value in entries)
        lines.append(f'{name} = {{ {numbers}, unit = "{_UNITS[name]}" }}')
    lines.append(f'mobility = {{ value = {_toml(device.mobility, "mobility")}, unit = "1/kg" }}')
    lines += ["", "[readout]", *(f"{n} = {_toml(getattr(model, n), n)}" for n in ("scale", "offset"))]
    lines += ["", "[reference]"]
    for name, value, unit in (
        ("temperature", model.reference_temperature, "K"),
        ("bias_voltage", model.reference_bias, "V"),
    ):
        lines.append(f'{name} = {{ value = {_toml(value, name)}, unit = "{unit}" }}')
    for effect in model.present.effects:
        lines += ["", "[[effect]]", f'name = "{effect.name}"', *([f'where = "{effect.where}"'] if effect.where else [])]
        lines += [f"strength = {_toml(effect.strength, effect.label)}", f'unit = "{effect.unit}"']
        settings = [f"{n} = {_toml(getattr(effect, n), n)}" for n in settings_of(effect)]
        lines += [f"settings = {{ {', '.join(settings)} }}"] if settings else []
    return "\n".join([*lines, ""])


def read_model(path: str | Path, own: Sequence[Effect] = ()) -> Model:
    """A model from its file.

    Args:
        path: as `write_model` writes it; strengths may be in any unit of the same kind.
        own: effects beyond the catalogue, from `load_effects`.

    **Raises:** `InputError` with file and line for what cannot be used.
    """
    data, source = read_toml(path, "model file")
    return _model(checked(_File, data, source), source, own)


def _model(file: _File, source: Source, own: Sequence[Effect]) -> Model:
    axes = 1 if file.device.stiffness.yy is None else 2
    matrices = {}
    for name in ("stiffness", "damping"):
        with source.section("device", name):
            entry = getattr(file.device, name)
            given = [getattr(entry, pair) for pair in ("xx", "yy", "xy")]
            if [value is not None for value in given] != [pair in _PAIRS[axes] for pair in ("xx", "yy", "xy")]:
                raise InputError(f"must have the entries {', '.join(_PAIRS[axes])} as the stiffness has, but has not")
            values = np.array([value for value in given if value is not None], float)
            matrices[name] = to_si(values, entry.unit, _UNITS[name], "the value")
    with source.section("device", "mobility"):
        mobility = _si(file.device.mobility, "1/kg")
    for name in ("scale", "offset"):
        with source.section("readout", name):
            if len(getattr(file.readout, name)) != axes:
                raise InputError(f"must have one entry per axis, {axes}, but has {len(getattr(file.readout, name))}")
    with source.section("reference"):
        temperature, bias = _si(file.reference.temperature, "K"), _si(file.reference.bias_voltage, "V")
    known = (*catalogue(axes), *own)
    effects = []
    for number, entry in enumerate(file.effect):
        with source.section("effect", number, "name"):
            effects.append(_effect(entry, known))
    return Model(
        NormalisedDevice(matrices["stiffness"], matrices["damping"], mobility),
        scale=jnp.asarray(file.readout.scale, float),
        offset=jnp.asarray(file.readout.offset, float),
        effects=tuple(effects),
        reference_temperature=temperature,
        reference_bias=bias,
    )


def _effect(entry: _Effect, known: Sequence[Effect]) -> Effect:
    if entry.name not in {effect.name for effect in known}:
        hint = "; a user's own effect needs its file, --effects FILE.py"
        raise InputError(f'must be an effect that is known, but "{entry.name}" is not{hint}')
    effect = by_name(entry.name, entry.where, among=known)
    strength = to_si(np.asarray(entry.strength, float), entry.unit, effect.unit, "the strength")
    values = {"strength": strength, **entry.settings}
    for name, value in values.items():
        if name not in ("strength", *settings_of(effect)):
            known_settings = ", ".join(settings_of(effect)) or "none"
            raise InputError(f"has a setting `{name}` that is not known (known: {known_settings})")
        if np.shape(value) != np.shape(getattr(effect, name)):
            raise InputError(
                f"`{name}` must have the shape {np.shape(getattr(effect, name))}, but has {np.shape(value)}"
            )
        effect = eqx.tree_at(lambda e, name=name: getattr(e, name), effect, jnp.asarray(value, float))
    return effect


def settings_of(effect: Effect) -> tuple[str, ...]:
    """Numbers of an effect beside its strength, such as a frequency that was scanned."""
    fields = (f.name for f in dataclasses.fields(effect) if f.name != "strength")
    return tuple(name for name in fields if eqx.is_array(getattr(effect, name)))


def _si(entry: _Scalar, unit: str) -> float:
    return float(to_si(float(entry.value), entry.unit, unit, "the value"))


def _toml(value: Any, name: str) -> str:
    numbers = np.asarray(value, float)
    if not np.isfinite(numbers).all():
        raise InputError(f"Argument `model` must hold finite numbers to be written, but `{name}` is {value}.")
    return toml_text(numbers.tolist())
