"""An effect as a table `[[effects]]` of a TOML file, in model files and in studies alike."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from pydantic import AliasChoices, ConfigDict, Field, model_serializer

from memsgyro_jax.base.display import stated_at
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.quantity import FileSection, In, Number, number_and_unit
from memsgyro_jax.base.text import excerpt
from memsgyro_jax.base.units import to_si

from .base import Effect
from .catalogue import by_name
from .numbers import free_numbers


Numbers = Number | list[Number]


def _axis_or_variant(schema: dict[str, Any]) -> None:
    schema["properties"]["variant"] = schema["properties"]["axis"]


class EffectSection(FileSection):
    """`name = "cubic_stiffness"`, `axis = "x"` (`variant` where it is no axis) and `strength = "8e8 N/m^3"`, or a
    number with its `unit` beside it; `settings` holds further numbers, in SI or as text with a unit.
    """

    model_config = ConfigDict(validate_by_name=True, validate_by_alias=True, json_schema_extra=_axis_or_variant)
    name: str
    """Name of the effect, as `memsgyro effects` lists it, or of one of your own (`--effects FILE.py`)."""
    where: str = Field(default="", validation_alias=AliasChoices("axis", "variant"))
    """Axis on which it acts, "x" or "y", or its variant where it is no axis; left out where there is one only."""
    strength: Numbers | str | dict[str, Any]
    """Strength, with its unit as text, or a number (or list of them) whose `unit` stands beside it; zero is absent."""
    unit: str | None = None
    """Unit of a strength that is given as a number; left out, of one without unit."""
    settings: dict[str, Numbers | str | dict[str, Any]] = Field(default_factory=dict)
    """Further numbers of the effect by name, with their unit as text, or numbers in SI; what is left out has its usual
    value."""

    @model_serializer
    def _entries(self) -> dict[str, Any]:
        place = {"axis" if self.where in ("x", "y") else "variant": self.where} if self.where else {}
        unit = {"unit": self.unit} if self.unit else {}
        settings = {"settings": self.settings} if self.settings else {}
        return {"name": self.name, **place, "strength": self.strength, **unit, **settings}

    def build(self, known: Sequence[Effect]) -> Effect:
        """The effect, one of `known`.

        **Raises:** `InputError` for an effect, variant or setting that is not known, and for a strength of another unit
        or shape.
        """
        effect = self.found(known)
        held = {name: self.setting_of(effect, name) for name in self.settings}
        for name, value in {"strength": self.strength_of(effect), **held}.items():
            if np.shape(value) != np.shape(getattr(effect, name)):
                raise InputError(
                    f"`{name}` must have the shape {np.shape(getattr(effect, name))}, but has {np.shape(value)}"
                )
            _check_bounds(effect, name, np.asarray(value))
            effect = eqx.tree_at(lambda e, name=name: getattr(e, name), effect, jnp.asarray(value, float))
        return effect

    def found(self, known: Sequence[Effect]) -> Effect:
        """The one of `known` that is meant, as it is there. Raises `InputError` where none is."""
        if self.name.split(" ")[0] not in {effect.name for effect in known}:
            hint = "; a user's own effect needs its file, --effects FILE.py"
            raise InputError(f'must be an effect that is known, but "{self.name}" is not{hint}')
        return by_name(self.name, self.where, among=known)

    def strength_of(self, effect: Effect) -> Any:
        """The strength in the unit of `effect`, SI. Raises `InputError` for a unit of another kind, or none."""
        given, unit = self.strength, self.unit
        if isinstance(given, str | dict):
            given, unit = number_and_unit(given)
            if self.unit is not None and unit:
                raise InputError("must give the unit once, in the text of the strength or beside it")
            unit = unit or self.unit
        if not unit:
            if effect.unit != "1":
                raise InputError(f'a strength of `{effect.label}` must carry a unit, for example "{effect.unit}"')
            unit = "1"
        return to_si(np.asarray(given, float), unit, effect.unit, "the strength")

    def setting_of(self, effect: Effect, name: str) -> Any:
        """Setting `name` in SI. Raises `InputError` for one that is not known, and `ValueError` for a unit of another
        kind, or none where the effect states one.
        """
        if name not in settings_of(effect):
            known_settings = ", ".join(settings_of(effect)) or "none"
            raise InputError(f"has a setting `{name}` that is not known (known: {known_settings})")
        given = self.settings[name]
        if not isinstance(given, str | dict):
            return given
        unit = unit_of_setting(effect, name)
        if not unit:
            raise InputError(
                f"must be a plain number in SI, as `{effect.label}` states no unit of `{name}`, but is {excerpt(given)}"
            )
        return In(unit).read(given)


def unit_of_setting(effect: Effect, name: str) -> str:
    """The SI unit of a number of an effect beside its strength; empty where the effect states none."""
    declared = {number.field: number.unit for number in free_numbers(effect)}
    return declared.get(name) or stated_at(effect, name)


def entries_of_effect(effect: Effect) -> dict[str, Any]:
    """The table that `EffectSection` reads back, in SI with every digit.

    **Raises:** `InputError` where a number is not finite.
    """
    held = {name: written(getattr(effect, name), name) for name in settings_of(effect)}
    strength = written(effect.strength, effect.label)
    unit = effect.unit if effect.unit != "1" else None
    return EffectSection(
        name=effect.name, where=effect.where, strength=strength, unit=unit, settings=held
    ).model_dump()  # fmt: skip


def _check_bounds(effect: Effect, name: str, value: np.ndarray) -> None:
    """Raises `InputError` for a number beyond what physics allows it, as no fit would leave it."""
    for number in free_numbers(effect):
        if number.field == name and not np.all((value >= number.low) & (value <= number.high)):
            ends = [f"at least {number.low:g}"] * (number.low > -np.inf) + [f"at most {number.high:g}"] * (
                number.high < np.inf
            )
            unit = "" if number.unit == "1" else f" {number.unit}"
            raise InputError(f"`{name}` must be {' and '.join(ends)}{unit}, but is {value.tolist()}")


def settings_of(effect: Effect) -> tuple[str, ...]:
    """Numbers of an effect beside its strength, such as a frequency that was scanned; none that says which rows of a
    case a term of the instrument acts on.
    """
    own = (f for f in dataclasses.fields(effect) if not f.metadata.get("of_rows"))
    fields = (f.name for f in own if f.name != "strength")
    return tuple(name for name in fields if eqx.is_array(getattr(effect, name)))


def written(value: Any, name: str) -> Any:
    """A number or list of numbers as a file holds it; raises `InputError` where one is not finite."""
    numbers = np.asarray(value, float)
    if not np.isfinite(numbers).all():
        raise InputError(f"What is written must be finite, but `{name}` is {value}.")
    return numbers.tolist()
