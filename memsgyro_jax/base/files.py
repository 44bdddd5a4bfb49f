"""Files that appear whole or not at all, and the text of a JSON file."""

import json
import math
import os
from pathlib import Path
from typing import Any


def write_whole(path: str | Path, content: str | bytes) -> Path:
    """Writes a file, text as UTF-8, beside its place and moves it there, so that nobody ever sees half of it."""
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(content.encode() if isinstance(content, str) else content)
        part.replace(path)
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
