"""Files below a folder, by name: each appears whole or not at all."""

import contextlib
import shutil
from pathlib import Path

from memsgyro_jax.base.files import write_whole


class Folder:
    """Files below a local folder."""

    def __init__(self, path: Path):
        self.path = path

    def read(self, name: str) -> bytes | None:
        """The content of a file, None where there is none or it cannot be read."""
        with contextlib.suppress(OSError):
            return (self.path / name).read_bytes()
        return None

    def write(self, name: str, content: bytes) -> None:
        """Put a file in place of the one there was."""
        place = self.path / name
        place.parent.mkdir(parents=True, exist_ok=True)
        write_whole(place, content)

    def remove(self, name: str) -> None:
        """Remove a file, if it is there."""
        (self.path / name).unlink(missing_ok=True)

    def stamp(self, name: str) -> object:
        """Changes when the file is written; None when it is not there."""
        with contextlib.suppress(OSError):
            found = (self.path / name).stat()
            return found.st_ino, found.st_mtime_ns
        return None

    def names(self, under: str = "") -> set[str]:
        """Of the files that lie directly in a folder below; hidden ones are drafts."""
        with contextlib.suppress(OSError):
            return {file.name for file in (self.path / under).iterdir() if not file.name.startswith(".")}
        return set()

    def tidy(self) -> None:
        """Remove the folder if nothing is in it."""
        with contextlib.suppress(OSError):
            self.path.rmdir()

    def discard(self) -> None:
        """Remove the folder with all that is in it."""
        shutil.rmtree(self.path, ignore_errors=True)
