"""A fitted model as a TOML file: base device per mass, read-out, reference conditions, effects by name, and what the
instrument does to the records.

Numbers are written with all their digits, so that reading gives back the very same model.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from pydantic import Field

from memsgyro_jax.base.complaints import Source
from memsgyro_jax.base.concrete import check_positive, check_positive_definite
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import write_whole
from memsgyro_jax.base.quantity import FileSection, Number
from memsgyro_jax.base.toml import checked, read_toml, toml_table
from memsgyro_jax.base.units import to_si
from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.effects import TERMS, Effect, every_effect
from memsgyro_jax.effects.section import EffectSection, entries_of_effect, written

from .declared import QUANTITIES, check_temperature
from .model import Model


SCHEMA = "memsgyro-model/1"
_UNITS = {"stiffness": "rad²/s²", "damping": "1/s", "mobility": "1/kg"}
_PAIRS = {1: ("xx",), 2: ("xx", "yy", "xy")}
_LARGEST = {"stiffness": 1e26, "damping": 1e13, "mobility": 1e30, "scale": 1e20, "offset": 1e20}  # of 1 THz, 1e-30 kg


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
    quantity: Literal["displacement", "velocity", "acceleration"] = "displacement"
    scale: list[Number]
    offset: list[Number]


class _Reference(FileSection):
    temperature: _Scalar
    bias_voltage: _Scalar


class _File(FileSection):
    format: Literal["memsgyro-model/1"] = Field(alias="schema")
    device: _Device
    readout: _Readout
    reference: _Reference
    effects: list[EffectSection] = Field(default_factory=list)
    instrument: list[EffectSection] = Field(default_factory=list)


def write_model(model: Model, path: str | Path, *, note: str = "") -> Path:
    """Write a model whole or not at all; effects of strength zero are absent and left out.

    Args:
        model: its terms of an instrument are written without the rows that they belong to, which a case tells.
        path: of the file.
        note: a comment at its head.

    **Raises:** `InputError` where a number is not finite.
    """
    return write_whole(path, model_text(model, note=note))


def model_text(model: Model, *, note: str = "") -> str:
    """The text of a model file."""
    device, pairs = model.device, _PAIRS[model.axes]
    matrices = {
        name: dict(zip(pairs, written(getattr(device, name), name), strict=True)) | {"unit": _UNITS[name]}
        for name in ("stiffness", "damping")
    }
    scalars = (
        ("mobility", device.mobility, "1/kg"),
        ("temperature", model.reference_temperature, "K"),
        ("bias_voltage", model.reference_bias, "V"),
    )
    mobility, *reference = ({name: {"value": written(value, name), "unit": unit}} for name, value, unit in scalars)
    quantity = {"quantity": QUANTITIES[model.order]} if model.order else {}
    readout: dict[str, Any] = quantity | {name: written(getattr(model, name), name) for name in ("scale", "offset")}
    sections = [
        toml_table("device", matrices | mobility),
        toml_table("readout", readout),
        toml_table("reference", reference[0] | reference[1]),
        *(toml_table("[effects]", entries_of_effect(e)) for e in model.present.effects if not e.of_instrument),
        *(toml_table("[instrument]", entries_of_effect(e)) for e in _terms(model.present)),
    ]
    head = "".join(f"# {line}\n" for line in note.splitlines())
    return "\n".join([f'{head}schema = "{SCHEMA}"\n', *sections])


def _terms(model: Model) -> list[Effect]:
    return [effect for effect in model.effects if effect.of_instrument]


def read_model(path: str | Path, own: Sequence[Effect] = ()) -> Model:
    """A model from its file. What the instrument does is beside its effects, for `compare`, `diagnose` and `fit`, which
    see from a case which rows it belongs to.

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
            _check_size(name, matrices[name], _UNITS[name])
            _check_definite(name, matrices[name])
    with source.section("device", "mobility"):
        mobility = _si(file.device.mobility, "1/kg")
        _check_size("mobility", mobility, "1/kg")
        if not (mobility > 0.0 or (axes == 1 and mobility < 0.0)):  # a resonator's pick-off may be turned round
            raise InputError(f"must be 1 / mass, positive, but is {mobility:g} 1/kg")
    for name in ("scale", "offset"):
        with source.section("readout", name):
            given = getattr(file.readout, name)
            if len(given) != axes:
                raise InputError(f"must have one entry per axis, {axes}, but has {len(given)}")
            if name == "scale" and 0.0 in given:
                raise InputError("must not be zero, which shows nothing")
            _check_size(name, given, "V/m" if name == "scale" else "V")
    with source.section("reference", "temperature"):
        temperature = check_temperature(_si(file.reference.temperature, "K"))
    with source.section("reference", "bias_voltage"):
        bias = _si(file.reference.bias_voltage, "V")
    known = (*every_effect(axes), *own)
    effects = []
    for number, entry in enumerate(file.effects):
        with source.section("effects", number, "name"):
            effects.append(entry.build(known))
    for number, entry in enumerate(file.instrument):
        with source.section("instrument", number, "name"):
            effects.append(entry.build(_every_term(entry)))
    return Model(
        NormalisedDevice(matrices["stiffness"], matrices["damping"], mobility),
        scale=jnp.asarray(file.readout.scale, float),
        offset=jnp.asarray(file.readout.offset, float),
        effects=tuple(effects),
        reference_temperature=temperature,
        reference_bias=bias,
        order=QUANTITIES.index(file.readout.quantity),
    )


def _every_term(entry: EffectSection) -> list[Effect]:
    """Every term of an instrument at zero, of as many numbers as an entry gives."""
    size = len(entry.strength) if isinstance(entry.strength, list) else 1
    return [
        kind(np.zeros(size), np.zeros((1, 1, size)), **way)
        for kind in TERMS
        for way in ({}, *({"of": of} for of in kind.ways))
    ]


def _check_size(name: str, values: np.typing.ArrayLike, unit: str) -> None:
    """Beyond are slips of the keyboard: a mode above 1 THz, say."""
    size, most = float(np.max(np.abs(values))), _LARGEST[name]
    if not size <= most:
        raise InputError(f"must be of a size below {most:g} {unit}, beyond which no device is, but is {size:g}")


def _check_definite(name: str, values: np.ndarray) -> None:
    """What holds a mass, and what slows it, is positive along every direction."""
    if len(values) == 1:
        check_positive(name, values)
    else:
        check_positive_definite(name, *values)


def _si(entry: _Scalar, unit: str) -> float:
    return float(to_si(float(entry.value), entry.unit, unit, "the value"))
