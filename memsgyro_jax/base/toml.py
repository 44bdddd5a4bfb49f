"""TOML files: one way of reading a file into checked sections, and the text of a value."""

import json
import re
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from .complaints import Source
from .errors import InputError


_BARE = re.compile(r"[A-Za-z0-9_-]+")
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
    try:
        text = path.read_bytes().decode("utf-8-sig")
        return tomllib.loads(text), Source(str(path), path.parent, text)
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such {what}{f'; {remedy}' if remedy else ''}.") from error
    except OSError as error:
        raise InputError(f"{path}: the {what} cannot be read ({error.strerror}).") from error
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise InputError(f"{path}: line {line}: a {what} must be UTF-8, but byte {error.start} is not.") from error
    except RecursionError as error:
        raise InputError(f"{path}: a {what} must be TOML of few levels, but is nested too deeply.") from error
    except ValueError as error:  # TOMLDecodeError, and Python's own for numbers of thousands of digits
        end = f"at line {text.count(chr(10)) + 1}, the end of the file"
        reason = " ".join(str(error).replace("at end of document", end).split()).rstrip(".")
        raise InputError(f"{path}: a {what} must be TOML, but cannot be read: {reason}.") from error


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
