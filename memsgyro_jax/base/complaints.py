"""What is wrong with a study file, in one sentence that names every place."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel

from .errors import InputError
from .quantity import FileSection, field_unit
from .text import FIRST, ended, excerpt, first_of, printable, suggestion


_WORD = r"""(?:[\w-]+|"[^"]*"|'[^']*')"""
_KEYS = rf"{_WORD}(?:\s*\.\s*{_WORD})*"
_TABLE = re.compile(rf"\s*(?P<open>\[\[?)\s*(?P<keys>{_KEYS})\s*\]")
_ENTRY = re.compile(rf"\s*(?P<keys>{_KEYS})\s*=")
_TABLE_FORM = "must be a table"
_FORMS = {  # of what a file may hold, by pydantic's name of the fault
    **dict.fromkeys(("model_type", "model_attributes_type", "dict_type"), _TABLE_FORM),
    **dict.fromkeys(("bool_type", "bool_parsing"), "must be true or false"),
    "tuple_type": "must be a list",
    "string_type": "must be text in quotes",
}
Place = tuple[str | int, ...]


class Misplaced(ValueError):
    """What is wrong deeper within a section, at a `place` that counts from there."""

    def __init__(self, place: Place, error: Exception) -> None:
        super().__init__(str(error))
        self.place = place


@dataclass(frozen=True)
class Source:
    """Where a study comes from: its name in messages, its folder, and its text (empty for one that is no file)."""

    name: str
    folder: Path
    text: str = ""

    @contextmanager
    def section(self, *place: str) -> Iterator[None]:
        """Adds the place to the errors of a section."""
        try:
            yield
        except ValueError as error:
            deeper = error.place if isinstance(error, Misplaced) else ()
            raise InputError(ended(f"{self.name}: {self._at((*place, *deeper))}: {error}")) from error

    def complain(self, errors: Sequence[Any], model: type[BaseModel], data: dict[str, Any]) -> InputError:
        """The first ten of pydantic's `errors` about `data`, read as `model`, in the order of the file."""
        about: dict[Place, list[Any]] = {}
        for error in filter(lambda error: not _follows(error, errors), errors):
            about.setdefault((*_in_file(error["loc"], data), *_deeper(error)), []).append(error)
        order = sorted(about, key=lambda place: self._line(place) or 0)
        texts: list[str] = []
        for place in order[:FIRST]:
            # Of an entry that may be one of several kinds, our own sentence says more than that it is none of them.
            own = [error for error in about[place] if error["type"] == "value_error"] or about[place]
            said = dict.fromkeys(_sentence(error, model, place).rstrip(".") for error in own)
            texts.append(f"{self._at(place)}: {' or '.join(said)}")
        each = [ended(f"{self.name}: {text}") for text in texts]
        if len(order) > len(texts):
            each.append(f"{self.name}: and {len(order) - len(texts)} more.")
        return InputError(ended(f"{self.name}: {first_of(texts, 'entries', len(order))}"), each)

    def _at(self, place: Place) -> str:
        line = self._line(place)
        return (f"line {line}, " if line else "") + f"`{printable('.'.join(map(str, place)), 100)}`"

    def _line(self, place: Place) -> int | None:
        """The line of the longest part of `place` that the file spells out."""
        lines = self._places
        whole = next((lines[place[:size]] for size in range(len(place), 0, -1) if place[:size] in lines), None)
        # A section may be there by its parts alone: `[spread.parameters]` without a `[spread]`.
        return whole or next((line for part, line in lines.items() if place and part[: len(place)] == place), None)

    @cached_property
    def _places(self) -> dict[Place, int]:
        return _lines(self.text)


def _lines(text: str) -> dict[Place, int]:
    """Line of each key of a TOML text, by a simple scan: exact but for keys inside values that span lines."""
    found: dict[Place, int] = {}
    table: Place = ()
    entries: Counter[Place] = Counter()  # of each list of tables
    for number, line in enumerate(text.splitlines(), 1):
        if heading := _TABLE.match(line):
            table = _words(heading["keys"])
            if heading["open"] == "[[":
                found.setdefault(table, number)
                entries[table] += 1
                table = (*table, entries[table] - 1)
            place = table
        elif entry := _ENTRY.match(line):
            place = (*table, *_words(entry["keys"]))
        else:
            continue
        found.setdefault(place, number)
    return found


def _words(keys: str) -> Place:
    return tuple(word.strip("\"'") for word in re.findall(_WORD, keys))


def _in_file(loc: Place, data: Any) -> Place:
    """pydantic's place without what the file does not spell out: the kind of a section, the index of a lone entry."""
    place: list[str | int] = []
    for step, part in enumerate(loc):
        last = step == len(loc) - 1
        inside: Any = data  # an entry of a table by its key, of a list by its number
        if part in (data if isinstance(data, dict) else range(len(data)) if isinstance(data, list) else ()):
            data = inside[part]
        elif isinstance(part, int) or not last or not isinstance(data, dict) or data.get("kind") == part:
            continue  # pydantic's own name for one of several kinds
        place.append(part)
    return tuple(place)


def _deeper(error: Any) -> Place:
    """Where within what it checked a check of our own puts the fault."""
    cause = error.get("ctx", {}).get("error")
    return cause.place if isinstance(cause, Misplaced) else ()


def _follows(error: Any, errors: Sequence[Any]) -> bool:
    """Whether a list is called too short only because its entries are wrong, each of which is told, or because of a
    later entry, too.
    """
    place = error["loc"]
    if error["type"] == "missing" and isinstance(place[-1], int):
        return any(other["type"] == "missing" and other["loc"] == (*place[:-1], place[-1] + 1) for other in errors)
    within = (other["loc"] for other in errors if len(other["loc"]) > len(place))
    return error["type"] == "too_short" and any(other[: len(place)] == place for other in within)


def _sentence(error: Any, model: type[BaseModel], place: Place) -> str:
    kind, given = error["type"], error["input"]
    if kind == "value_error":
        return str(error["ctx"]["error"])
    if kind == "missing" and isinstance(error["loc"][-1], int):
        return f"must have at least {error['loc'][-1] + 1} entries, but has {len(given)}"
    if kind == "missing":
        return f"is missing: give it{_remedy(str(error['loc'][-1]), _models_at(error['loc'][:-1], model))}"
    if kind == "extra_forbidden":
        return _unknown(str(error["loc"][-1]), _models_at(error["loc"][:-1], model))
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        kinds = " or ".join(f'"{name}"' for name in map(_kind, _models_at(error["loc"], model)) if name)
        found = given.get("kind") if isinstance(given, dict) else given
        return f"must have a kind, {kinds}, but " + ("has none" if found is None else f"has {excerpt(found)}")
    if kind == "too_short":
        least, count = error["ctx"]["min_length"], error["ctx"]["actual_length"]
        return f"must have at least {least} {'entry' if least == 1 else 'entries'}, but has {count}"
    if kind == "too_long":
        return f"must have at most {error['ctx']['max_length']} entries, but has {error['ctx']['actual_length']}"
    wanted = error["msg"].replace("Input should be", "must be").replace("String should", "must")
    wanted = _FORMS.get(kind, wanted) + _example(error, place, model)
    return f"{wanted}, but is {excerpt(given)}"


def _example(error: Any, place: Place, model: type[BaseModel]) -> str:
    """How a list or a table is written, in the user's own words; empty for what is neither."""
    kind, given, models = error["type"], error["input"], _models_at(error["loc"], model)
    name = ".".join(part for part in place if isinstance(part, str))
    if kind == "tuple_type":
        one = excerpt(given) if isinstance(given, str | int | float) else '"a"'
        entries = ", ".join([one] * _entries(error["loc"], model))
        return f" of tables, each under `[[{name}]]`" if models else f", like `[{entries}]`"
    if _FORMS.get(kind) != _TABLE_FORM or not place:
        return ""
    sections = [each for each in models if issubclass(each, FileSection) and kind != "dict_type"]
    alone = next(filter(None, (each.alone(given) for each in sections)), "")
    under = f"[[{name}]]" if isinstance(place[-1], int) else f"[{name}]"
    return f", like `{place[-1]} = {alone}`" if alone else f", as under `{under}`"


def _entries(loc: Place, model: type[BaseModel]) -> int:
    """How many entries a list must have, or one where it may have any number."""
    fields = [each.model_fields[loc[-1]] for each in _models_at(loc[:-1], model) if loc[-1] in each.model_fields]
    kinds = [get_args(field.annotation) for field in fields]
    return max((len(each) for each in kinds if each and Ellipsis not in each), default=1)


def _remedy(name: str, models: list[type[BaseModel]]) -> str:
    """In which unit, or what else would do."""
    part = next((each for each in models if name in each.model_fields), None)
    if part is None:
        return ""
    unit, instead = field_unit(part, name), getattr(part, "instead", {}).get(name)
    return (f" in {unit}" if unit not in (None, "1") else "") + (f", or {instead}" if instead else "")


def _unknown(name: str, models: list[type[BaseModel]]) -> str:
    fields = [(key, field) for each in models for key, field in each.model_fields.items()]
    known = sorted(
        {n for key, field in fields for n in getattr(field.validation_alias, "choices", [field.alias or key])}
    )
    return f"is not known ({suggestion(name, known)})"


def _models_at(loc: Place, model: type[BaseModel]) -> list[type[BaseModel]]:
    """The sections that may stand at pydantic's place `loc`."""
    models = [model]
    for part in loc:
        inner = [each.model_fields[part] for each in models if part in each.model_fields]
        if inner:
            models = [found for field in inner for found in _models(field.annotation)]
        elif isinstance(part, str):
            models = [each for each in models if _kind(each) == part] or models
    return models


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for inner in get_args(annotation) for model in _models(inner)]


def _kind(model: type[BaseModel]) -> str | None:
    field = model.model_fields.get("kind")
    return get_args(field.annotation)[0] if field else None
