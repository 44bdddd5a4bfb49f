"""TOML files: one way of reading a file into checked sections, and the text of a value."""

import json
import math
import re
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from .complaints import Source
from .errors import InputError
from .files import read_text
from .text import printable


_BARE = re.compile(r"[A-Za-z0-9_-]+")
_LEVELS = 32
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_CHAIN = re.compile(rf"(?<![\w.-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{_LEVELS}}}")
_HUGE = re.compile(r"\d[\d_]{400}")
Sections = TypeVar("Sections", bound=BaseModel)


def read_toml(path: str | Path, what: str, remedy: str = "") -> tuple[dict[str, Any], Source]:
    """The tables of a TOML file, and where they stand in it.

    Args:
        path: the file.
        what: it is, for messages, like "study file".
        remedy: what to do where there is no such file.

    **Raises:** `InputError` with file, and line where there is one, for a file that cannot be read or is no TOML.
    """
    path = Path(path)
    text = read_text(path, what, remedy=remedy)
    try:
        if chain := _CHAIN.search(text):  # reading it takes the square of its length
            raise _NoNumber(chain.group(), f"a key must have at most {_LEVELS} parts, but `{{}}` has more")
        return tomllib.loads(text, parse_float=_float), Source(str(path), path.parent, text)
    except _NoNumber as error:
        line = text.count("\n", 0, text.index(error.text)) + 1
        raise InputError(f"{path}: line {line}: {error}.") from error
    except RecursionError as error:
        raise InputError(f"{path}: a {what} must be TOML of few levels, but is nested too deeply.") from error
    except ValueError as error:  # TOMLDecodeError, and Python's own for integers of thousands of digits
        if huge := _HUGE.search(text):
            line = text.count("\n", 0, huge.start()) + 1
            raise InputError(f"{path}: line {line}: a number must have at most 400 digits, but has more.") from error
        end = f"at line {text.count(chr(10)) + 1}, the end of the file"
        reason = " ".join(str(error).replace("at end of document", end).split()).rstrip(".")
        raise InputError(f"{path}: a {what} must be TOML, but cannot be read: {printable(reason, 200)}.") from error


class _NoNumber(ValueError):
    """What TOML allows, but cannot be meant: the text where it stands, and the sentence about it."""

    def __init__(self, text: str, sentence: str) -> None:
        super().__init__(sentence.format(printable(text, 40)))
        self.text = text


def _float(text: str) -> float:
    """What TOML calls a float; one that a computer would silently make zero or infinite is refused."""
    value = float(text)
    if math.isinf(value) and "n" not in text:
        raise _NoNumber(text, "a number must be finite, but `{}` is larger than any that a computer holds")
    if value == 0.0 and re.search("[1-9]", re.split("[eE]", text)[0]):
        raise _NoNumber(text, "a number must be zero or not, but `{}` is smaller than any that a computer holds")
    return value


def checked(model: type[Sections], data: dict[str, Any], source: Source, context: Any = None) -> Sections:
    """The sections that `data` holds; raises `InputError` with everything that is wrong with them."""
    try:
        return model.model_validate(data, context=context)
    except ValidationError as error:
        raise source.complain(error.errors(include_url=False), model, data) from error


def toml_text(value: Any) -> str:
    """A value on one line; a float's `repr` is the shortest text that reads back as the same number."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{toml_key(name)} = {toml_text(entry)}" for name, entry in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml_text, value)) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    # JSON's escapes are TOML's, but JSON leaves the DEL character as it is.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def toml_key(name: str) -> str:
    """A key, in quotes where it needs them."""
    return name if _BARE.fullmatch(name) else toml_text(name)


def toml_table(name: str, entries: dict[str, Any]) -> str:
    """A table, a line each, between empty lines; `name` may be "[experiment]" for an entry of a list of tables."""
    return "\n".join([f"[{name}]", *(f"{toml_key(key)} = {toml_text(value)}" for key, value in entries.items())]) + "\n"
