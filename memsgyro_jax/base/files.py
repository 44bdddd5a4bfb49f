"""Files read with care: regular ones of a bounded size only. Files that appear whole or not at all. JSON text."""

import difflib
import json
import logging
import math
import os
import stat
from pathlib import Path
from typing import Any

from .errors import InputError
from .text import printable


_LOG = logging.getLogger("memsgyro_jax")
LARGEST_TEXT = 4 * 2**20  # bytes of a file that a person writes: TOML, Python
LARGEST_TABLE = 512 * 2**20  # bytes of a file that an instrument writes


def read_whole(path: str | Path, what: str, *, most: int = LARGEST_TEXT, remedy: str = "") -> bytes:
    """The bytes of a regular file.

    Args:
        path: the file.
        what: it is, for messages, like "study file".
        most: bytes that it may have.
        remedy: what to do where there is no such file.

    **Raises:** `InputError` for a file that is missing, cannot be read, is a folder, a device or a pipe, or is larger.
    """
    path, shown = Path(path), printable(str(path))
    try:
        about = path.stat()
        if not stat.S_ISREG(about.st_mode):  # asked before it is opened, which some devices take as a command
            found = "a folder" if stat.S_ISDIR(about.st_mode) else "a device or a pipe"
            raise InputError(f"{shown}: the {what} must be a regular file, but is {found}.")
        with path.open("rb") as file:
            data = file.read(most + 1) if about.st_size <= most else b""
    except FileNotFoundError as error:
        hint = remedy or _of_nearly_that_name(path)
        raise InputError(f"{shown}: no such {what}{f'; {hint}' if hint else ''}.") from error
    except OSError as error:
        raise InputError(f"{shown}: the {what} cannot be read ({error.strerror}).") from error
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{shown}: the {what} must have a name without a NUL character.") from error
    _LOG.debug("reads %s", shown)
    if max(about.st_size, len(data)) > most:
        found = f"{max(about.st_size, len(data)) / 2**20:.4g}"
        raise InputError(f"{shown}: the {what} must have at most {most >> 20} MiB, but has {found} MiB.")
    return data


def _of_nearly_that_name(path: Path) -> str:
    """What to take in place of a file that is not there, where one beside it is called alike."""
    try:
        beside = {one.name.casefold(): one.name for one in path.parent.iterdir()}
    except OSError:
        return ""
    near = difflib.get_close_matches(path.name.casefold(), beside, n=1, cutoff=0.8)
    return f"beside it stands {printable(beside[near[0]])}" if near else ""


def read_text(path: str | Path, what: str, *, most: int = LARGEST_TEXT, remedy: str = "") -> str:
    """The text of a regular file in UTF-8, without a byte order mark; arguments and errors as of `read_whole`."""
    data = read_whole(path, what, most=most, remedy=remedy)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        hint = "; save it again as UTF-8"
        raise InputError(
            f"{printable(str(path))}: line {line}: the {what} must be UTF-8, but byte {error.start} is not{hint}."
        ) from error


def write_whole(path: str | Path, content: str | bytes) -> Path:
    """Writes a file, text as UTF-8, beside its place and moves it there, so that nobody ever sees half of it.

    Raises `InputError` for the name of a folder.
    """
    path = Path(path)
    if not path.name or path.is_dir():
        raise InputError(f"{path} must be a file, but is a folder.")
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        # A file name that is no text, such as a result may quote, reads "\\udcff" in it, as JSON has it.
        part.write_bytes(content.encode(errors="backslashreplace") if isinstance(content, str) else content)
        part.replace(path)
        _LOG.debug("wrote %s", path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    return path


def json_text(entries: Any) -> str:
    """Entries as JSON; what is not finite reads null."""
    return json.dumps(finite(entries), indent=2, ensure_ascii=False, allow_nan=False)


def write_json(path: str | Path, entries: Any) -> Path:
    """Writes entries as a JSON file, whole or not at all."""
    return write_whole(path, json_text(entries) + "\n")


def finite(value: Any) -> Any:
    """Entries of a JSON file without what it cannot hold: an infinite number, or none at all, reads null."""
    if isinstance(value, dict):
        return {name: finite(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
