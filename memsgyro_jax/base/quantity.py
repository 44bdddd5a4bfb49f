"""Numbers with units in a study file, and the base class of its sections."""

import ast
import functools
import inspect
import math
import re
import textwrap
from collections import ChainMap
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

from .errors import InputError
from .text import excerpt, printable
from .units import NUMBER, decimal, to_peak, to_si


_TEXT = re.compile(rf"\s*(?P<number>{NUMBER})(?P<unit>\s.*|[^\d.,].*|)")  # 10%, 1400 1/s, but not 1,5 mm
_DECIBELS = {"dBm": math.sqrt(2.0 * 1e-3 * 50.0), "dBV": math.sqrt(2.0)}  # V, the peak at zero; dBm into 50 ohm
Value = TypeVar("Value")


@functools.cache
def _beneath_fields(section: type) -> dict[str, str]:
    """The text beneath each field of a class, without those that it is made from, by name."""
    try:
        body = ast.parse(textwrap.dedent(inspect.getsource(section))).body[0].body  # type: ignore[attr-defined]
    except (OSError, TypeError):  # made while running, or not in Python
        return {}
    return {
        field.target.id: inspect.cleandoc(text.value.value)
        for field, text in pairwise(body)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
    }


class FileSection(BaseModel):
    """A section of a study file: immutable, unknown keys and infinite numbers refused.

    What a key means stands beneath its field; an editor shows it, with the unit of the field's annotation.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, protected_namespaces=())

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """What pydantic asks a class for; those that it makes itself are described as their base is.

        What stands beneath the fields is read here and not by pydantic, which would read every source at each start.
        """
        made = handler(schema)
        entry = handler.resolve_ref_schema(made)
        entry.setdefault("description", inspect.getdoc(cls))
        told = dict(ChainMap(*(_beneath_fields(kind) for kind in cls.__mro__)))
        for name, field in cls.model_fields.items():
            for key in (name, field.alias, *getattr(field.validation_alias, "choices", ())):
                if name in told and key in entry.get("properties", {}):
                    entry["properties"][key].setdefault("description", told[name])
        return made

    @classmethod
    def alone(cls, given: Any) -> str:
        """The section on one line, for a message where something else was `given`; empty where that is not usual."""
        return ""

    def numbers(self) -> dict[str, Any]:
        """The fields by name, in SI and without `kind`: arguments for the object that the section describes."""
        return {name: value for name, value in self if name != "kind"}


@dataclass(frozen=True)
class In:
    """Annotation of a number that is held in the SI unit `unit` and written with any unit of the same kind.

    In the file it reads `"1.8e-7 kg"` or `{ value = 1.8e-7, unit = "kg" }`; a pure number (`unit` "1") may stand alone.
    """

    unit: str
    difference: bool = False  # of temperatures, so that "5 degC" must not become 278.15 K

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """What pydantic asks an annotation for."""
        serializer = core_schema.plain_serializer_function_ser_schema(self.write)
        return core_schema.no_info_before_validator_function(self.read, handler(source), serialization=serializer)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """The same for an editor."""
        return quantity_schema(self.unit)

    def read(self, given: Any) -> float:
        """The number in `unit`; raises `ValueError` where text, unit or type is wrong."""
        number, unit = number_and_unit(given)
        if not unit and self.unit != "1":
            raise ValueError(f'must carry a unit, for example "{number:g} {self.unit}", but none was given')
        if unit in ("", self.unit):  # nothing to convert, as in the default study: loading pint takes half a second
            return number
        if self.difference and to_si(0.0, unit, self.unit, "the value") != 0.0:
            raise ValueError(f'must be a difference, for example "{number:g} K", but is a temperature in {unit}')
        return to_si(number, unit, self.unit, "the value")

    def write(self, number: float) -> float | str:
        """The form in which a file is written."""
        return number if self.unit == "1" else f"{number!r} {self.unit}"


def quantity_schema(unit: str = "", **more: dict[str, Any]) -> dict[str, Any]:
    """JSON schema of a quantity in `unit`, or in any; its table may have keys `more`. `x-unit` tells it to programs."""
    pair = {
        "value": {"type": "number", "description": "The number."},
        "unit": {"type": "string", "description": "Its unit."},
    }
    table = {"type": "object", "properties": pair | more, "required": [*pair], "additionalProperties": False}
    told = f"a number and a unit like {unit}" if unit else "a number and its unit"
    text = {"type": "string", "pattern": rf"^\s*{NUMBER}", "description": told}
    return {"anyOf": [text, table, *([{"type": "number"}] if unit == "1" else [])], "x-unit": unit}


@dataclass(frozen=True)
class Also:
    """For an editor: what a validator takes beside what it makes of it: one entry of a list alone, a quantity in the
    unit `quantity` ("" for any), text.
    """

    one: bool = False
    quantity: str | None = None
    text: bool = False

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """What pydantic asks an annotation for."""
        found = handler(schema)
        entries = found.get("prefixItems", [found.get("items")])[:1] if self.one else []
        alone = [] if self.quantity is None else [quantity_schema(self.quantity)]
        return {"anyOf": [found, *entries, *alone, *([{"type": "string"}] if self.text else [])]}


def number_and_unit(given: Any) -> tuple[float, str]:
    """Number and unit (empty where there is none) of a quantity as a file holds it."""
    if isinstance(given, dict):
        if set(given) != {"value", "unit"} or not isinstance(given["unit"], str):
            raise ValueError(f'must be a table of "value" and "unit", for example {_example(given)}{_foreign(given)}')
        return _number(given["value"]), given["unit"]
    if isinstance(given, str):
        match = _TEXT.fullmatch(given)
        if match is None:
            raise ValueError(f'must be a number with a unit, for example "100 kHz", but is "{printable(given, 60)}"')
        return decimal(match["number"]), match["unit"].strip()
    return _number(given), ""


def amount_of_option(text: str, option: str, like: str, measures: str = "") -> tuple[float, str]:
    """Positive number and unit that an option of the command line holds; effective and peak-to-peak amplitudes
    ("10 mVrms", "20 Vpp") as peak ones, and levels ("-10 dBm", into 50 ohm, and "-20 dBV") as peak voltages.

    Args:
        text: as given.
        option: its name, for messages.
        like: an example.
        measures: a unit of what it measures; empty where that is known elsewhere.

    Raises:
        InputError: no positive number, no unit, or none that can be read.
    """
    try:
        number, unit = number_and_unit(text)
    except ValueError as error:
        raise InputError(f"Option `{option}` {error}.") from error
    must = f'Option `{option}` must be a positive number with its unit, like "{like}"'
    if unit in _DECIBELS and not measures:
        return _DECIBELS[unit] * 10.0 ** (number / 20.0), "V"
    if not unit or not number > 0:
        raise InputError(f'{must}, but is "{printable(text.strip(), 60)}".')
    if unit.startswith("dB"):
        raise InputError(f'{must}, but is "{printable(text.strip(), 60)}", in decibels; convert it to a linear unit.')
    factor, unit = to_peak(unit)
    to_si(1.0, unit, measures or unit, f"option `{option}`")
    return factor * number, unit


def _example(given: dict[str, Any]) -> str:
    """The table as it may stand, in the user's own numbers where they are there."""
    number, unit = given.get("value", 1.8e-7), given.get("unit", "kg")
    good = isinstance(number, int | float) and isinstance(unit, str)
    return f'{{ value = {number:g}, unit = "{printable(unit, 20)}" }}' if good else '{ value = 1.8e-7, unit = "kg" }'


def _foreign(given: dict[str, Any]) -> str:
    others = sorted(set(given) - {"value", "unit"})
    return f", without {printable(', '.join(others), 60)}" if others else ""


def _number(given: Any, what: str = "a number with a unit") -> float:
    if isinstance(given, bool) or not isinstance(given, int | float):
        raise ValueError(f"must be {what}, but is {excerpt(given)}")
    try:
        return float(given)
    except OverflowError as error:
        raise ValueError("must be a finite number, but is too large for a computer") from error


def _pair(given: Any) -> Any:
    """One entry for both axes, or two."""
    is_sequence = isinstance(given, list | tuple)
    if is_sequence and len(given) != 2:
        raise ValueError(f"must be one value for both axes or a list of two (x, y), but has {len(given)} entries")
    return tuple(given) if is_sequence else (given, given)


Pair = Annotated[tuple[Value, Value], BeforeValidator(_pair), Also(one=True)]
"""Two numbers for the axes x and y; one alone serves both."""

Pure = Annotated[float, In("1")]
Share = Annotated[float, Field(ge=0.0), In("1")]
Metre = Annotated[float, In("m")]
Speed = Annotated[float, In("m/s")]
Acceleration = Annotated[float, In("m/s^2")]
Kilogram = Annotated[float, Field(gt=0.0), In("kg")]
Stiffness = Annotated[float, In("N/m")]
Damping = Annotated[float, In("N*s/m")]
Newton = Annotated[float, In("N")]
Kelvin = Annotated[float, In("K")]
KelvinDifference = Annotated[float, In("K", difference=True)]
Volt = Annotated[float, In("V")]
Farad = Annotated[float, In("F")]
Density = Annotated[float, Field(ge=0.0), In("V/sqrt(Hz)")]
Rate = Annotated[float, In("rad/s")]
Radian = Annotated[float, In("rad")]
Hertz = Annotated[float, Field(gt=0.0), In("Hz")]
PerSecond = Annotated[float, Field(ge=0.0), In("1/s")]
Second = Annotated[float, Field(ge=0.0), In("s")]
Duration = Annotated[float, Field(gt=0.0), In("s")]


Number = Annotated[float, BeforeValidator(lambda given: _number(given, "a valid number"))]
"""A number whose unit stands elsewhere."""

LARGEST_COUNT, LARGEST_SEED = 2**31 - 1, 2**63 - 1


def _whole(given: Any) -> Any:
    if isinstance(given, bool) or not isinstance(given, int) or abs(given) > LARGEST_SEED:
        raise ValueError(f"must be a whole number, at most {LARGEST_COUNT}, but is {excerpt(given)}")
    return given


Whole = Annotated[int, BeforeValidator(_whole), Field(le=LARGEST_COUNT)]
Seed = Annotated[int, BeforeValidator(_whole), Field(ge=0, le=LARGEST_SEED)]


def unit_of(annotation: Any) -> str | None:
    """The unit in the annotation of a field, found inside pairs and options too; `None` where it holds no quantity."""
    for found in getattr(annotation, "__metadata__", ()):
        if isinstance(found, In):
            return found.unit
    inner = getattr(annotation, "__args__", ()) or ()
    return next((unit for unit in map(unit_of, inner) if unit), None)


def field_unit(part: type[BaseModel], name: str) -> str | None:
    """Unit of field `name` of a section, or `None`."""
    field = part.model_fields.get(name)
    if field is None:
        return None
    marks = [mark.unit for mark in field.metadata if isinstance(mark, In)]
    return marks[0] if marks else unit_of(field.annotation)
