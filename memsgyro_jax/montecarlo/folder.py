"""Files below a folder, by name: each appears whole or not at all. The folder is a local one, or one of fsspec."""

import contextlib
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import write_whole


_STALE = 3600.0  # s after which the draft of a file is that of a process that was killed
_REMOTE = "://"


@dataclass(frozen=True)
class RemotePath:
    """What a store needs of a `pathlib.Path`, on a file system of fsspec (`memory://lot`, `s3://bucket/lot`).

    Such a system writes a file whole or not at all, but of several that create one it may let all: nothing can be
    leased there.
    """

    url: str

    def __truediv__(self, name: str) -> "RemotePath":
        return RemotePath(f"{self.url}/{name}")

    def __str__(self) -> str:
        return self.url

    @property
    def name(self) -> str:
        return self.url.rpartition("/")[2]

    @property
    def parent(self) -> "RemotePath":
        return RemotePath(self.url.rpartition("/")[0])

    def with_suffix(self, suffix: str) -> "RemotePath":
        return self.parent / (self.name.rpartition(".")[0] + suffix)

    def exists(self) -> bool:
        return bool(self._system().exists(self.url))

    def read_bytes(self) -> bytes:
        return bytes(self._system().cat_file(self.url))

    def write_bytes(self, content: bytes) -> None:
        self._system().pipe_file(self.url, content)

    def unlink(self) -> None:
        with contextlib.suppress(FileNotFoundError):
            self._system().rm_file(self.url)

    def remove_all(self) -> None:
        with contextlib.suppress(FileNotFoundError):
            self._system().rm(self.url, recursive=True)

    def stamp(self) -> object:
        about = self._system().info(self.url)
        return tuple(str(about.get(key)) for key in ("size", "created", "mtime", "ETag", "LastModified", "etag"))

    def iterdir(self) -> Iterator["RemotePath"]:
        for entry in self._system().ls(self.url, detail=False, refresh=True):
            yield self / str(entry).rstrip("/").rpartition("/")[2]

    def _system(self) -> Any:
        try:
            import fsspec

            return fsspec.core.url_to_fs(self.url)[0]
        except (ImportError, ValueError) as error:
            kind = self.url.partition(_REMOTE)[0]
            raise InputError(
                f"{self.url} cannot be reached: {error}; install fsspec with what it needs for {kind}."
            ) from error


def place_of(where: "str | Path | RemotePath") -> "Path | RemotePath":
    """A folder by its path, or by its address where that has `://` in it."""
    if isinstance(where, RemotePath):
        return where
    return RemotePath(str(where).rstrip("/")) if _REMOTE in str(where) else Path(where)


class Folder:
    """Files below a folder."""

    def __init__(self, path: Path | RemotePath):
        self.path = path

    def read(self, name: str) -> bytes | None:
        """The content of a file, None where there is none or it cannot be read."""
        with contextlib.suppress(OSError):
            return (self.path / name).read_bytes()
        return None

    def write(self, name: str, content: bytes) -> None:
        """Put a file in place of the one there was."""
        place = self.path / name
        if isinstance(place, RemotePath):
            place.write_bytes(content)
            return
        place.parent.mkdir(parents=True, exist_ok=True)
        write_whole(place, content)

    def remove(self, name: str) -> None:
        """Remove a file, if it is there."""
        with contextlib.suppress(FileNotFoundError):
            (self.path / name).unlink()

    def stamp(self, name: str) -> object:
        """Changes when the file is written; None when it is not there."""
        with contextlib.suppress(OSError):
            place = self.path / name
            if isinstance(place, RemotePath):
                return place.stamp()
            found = place.stat()
            return found.st_ino, found.st_mtime_ns
        return None

    def names(self, under: str = "") -> set[str]:
        """Of the files that lie directly in a folder below; hidden ones are drafts."""
        with contextlib.suppress(OSError):
            return {file.name for file in (self.path / under).iterdir() if not file.name.startswith(".")}
        return set()

    def tidy(self) -> None:
        """Remove what those who were killed an hour ago left half written, and the folder if nothing is in it."""
        if isinstance(self.path, Path):
            with contextlib.suppress(OSError):
                for draft in self.path.rglob(".*.part"):
                    if time.time() - draft.stat().st_mtime > _STALE:
                        draft.unlink()
                self.path.rmdir()

    def discard(self) -> None:
        """Remove the folder with all that is in it."""
        if isinstance(self.path, RemotePath):
            self.path.remove_all()
        else:
            shutil.rmtree(self.path, ignore_errors=True)
