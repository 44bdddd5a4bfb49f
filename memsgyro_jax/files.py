"""Files that appear whole or not at all."""

import os
from pathlib import Path


def write_whole(path: str | Path, text: str) -> Path:
    """Writes a text file beside its place and moves it there, so that nobody ever sees half of it."""
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    return path
