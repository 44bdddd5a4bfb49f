"""The store of a sweep: a zarr group, written block by block, that survives kills, damage, and several processes.

A block of rows counts when its status, which is written last, is not `PENDING` and every die's seal, a checksum over
all of its row, agrees: whatever is unfinished, cut short, flipped, missing or in another's place is computed again. No
order of writes, by however many processes, can make a wrong row count. Each chunk also has a CRC32C of its own (a codec
of zarr), for those who read the store without this package.
"""

import contextlib
import hashlib
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from memsgyro_jax.base.errors import InputError

from .batch import MEANING, PENDING, STATUS
from .layout import SEAL, Layout, adapt, attributes_of, create, draft_path, held_by
from .lease import Leases


_TOLD = 10  # damaged blocks that are named one by one
_AT_ONCE = 64  # blocks that are read together: more would hold a large store in memory three times
_POLL = 0.2  # s between looks at blocks that others compute


class Store:
    """An open store of `dies` dies in blocks of `block`.

    `rows` holds the columns and the status of the dies that are done, in memory; `notes` what a person should know.
    """

    def __init__(self, path: Path, layout: Layout, dies: int, block: int, leases: Leases):
        import zarr

        self.path, self.layout, self.dies, self.block = path, layout, dies, block
        self._leases = leases
        self.notes = adapt(path, layout, dies, block)
        group: Any = zarr.open_group(path, mode="r+")
        self._arrays = {name: group[name] for name in (*layout.columns, SEAL, STATUS)}
        self.rows = {name: _filled(array, dies) for name, array in self._arrays.items() if name != SEAL}
        self._seen = [self._stamp(number) for number in range(-(-dies // block))]
        if any(self._seen):
            step = _AT_ONCE * block
            self._tell([n for start in range(0, dies, step) for n in self._load(start, min(start + step, dies))])

    @property
    def done(self) -> int:
        """How many dies are done."""
        return int(np.sum(self.rows[STATUS] != PENDING))

    def unfinished(self) -> Iterator[int]:
        """Numbers of the blocks that this process is to compute and `write`, one after another, until all are done.

        Blocks that other processes compute are waited for, and taken over from those that die.
        """
        waiting = [number for number in range(len(self._seen)) if not self._finished(number)]
        while waiting:
            before = len(waiting)
            for number in list(waiting):
                # Looked for again once it is claimed: somebody may have written it just before.
                if not self._found(number) and self._leases.claim(number):
                    if not self._found(number):
                        yield number
                    self._leases.release(number)
                if self._finished(number):
                    waiting.remove(number)
            if len(waiting) == before:
                time.sleep(_POLL)
        if (held_by(self.path) or 0) < self.dies:  # another that goes on to fewer dies has just set back their number
            adapt(self.path, self.layout, self.dies, self.block)

    def write(self, number: int, rows: dict[str, np.ndarray]) -> None:
        """Write block `number`, the status last; rows beyond the number of dies are dropped.

        Writes nothing if another process has taken the block over. Raises `InputError` if the store was replaced.
        """
        start, stop = self._span(number)
        rows = {name: values[: stop - start] for name, values in rows.items()}
        if self._identity() != self._expected:
            raise InputError(f"{self.path} was removed or replaced while its sweep ran; give each a folder of its own.")
        if not self._leases.holds(number):
            return
        for name in (*self.layout.columns, SEAL, STATUS):
            values = self._seals(rows, start) if name == SEAL else rows[name]
            self._arrays[name][start:stop] = values
            if name != SEAL:
                self.rows[name][start:stop] = values
        self._seen[number] = self._stamp(number)

    @property
    def _expected(self) -> tuple[object, object]:
        return self.layout.attributes["fingerprint"], self.block

    def _identity(self) -> tuple[object, object]:
        """Fingerprint and block size of what lies at the path now."""
        found = attributes_of(self.path)
        return found.get("fingerprint"), found.get("block")

    def _found(self, number: int) -> bool:
        """Whether the block is done; read if its status was written since it was last looked at."""
        stamp = self._stamp(number)
        if stamp != self._seen[number]:
            self._seen[number] = stamp
            self._load(*self._span(number))
        return self._finished(number)

    def _finished(self, number: int) -> bool:
        start, stop = self._span(number)
        return bool(np.all(self.rows[STATUS][start:stop] != PENDING))

    def _span(self, number: int) -> tuple[int, int]:
        return number * self.block, min((number + 1) * self.block, self.dies)

    def _stamp(self, number: int) -> tuple[int, int] | None:
        """Changes when the status of a block is written; None when it never was."""
        with contextlib.suppress(OSError):
            found = (self.path / STATUS / "c" / str(number)).stat()
            return found.st_ino, found.st_mtime_ns
        return None

    def _load(self, start: int, stop: int) -> list[int]:
        """Read the rows of these dies that are done and sound; gives the blocks with others that claim to be done."""
        # The status first, as it is written last: of a block that another process is writing it says pending.
        names = (STATUS, SEAL, *self.layout.columns)
        columns = {name: self._column(self._arrays[name], start, stop) for name in names}
        seals, _ = columns.pop(SEAL)
        rows = {name: values for name, (values, _) in columns.items()}
        written = rows[STATUS] != PENDING
        sound = written & np.isin(rows[STATUS], list(MEANING)) & (self._seals(rows, start) == seals)
        readable = np.logical_and.reduce([whole for _, whole in columns.values()])
        for name, values in rows.items():
            self.rows[name][start:stop][sound & readable] = values[sound & readable]
        return sorted({int(die) // self.block for die in start + np.flatnonzero(written & ~(sound & readable))})

    def _column(self, array: Any, start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        """Rows of an array, and which of them could be read; the others count as written, for they once were."""
        try:
            return array[start:stop], np.ones(stop - start, bool)
        except Exception:  # what a decoder makes of damaged bytes is its own affair
            if start // self.block == (stop - 1) // self.block:
                return np.zeros((stop - start, *array.shape[1:]), array.dtype), np.zeros(stop - start, bool)
        middle = self.block * ((start // self.block + -(-stop // self.block)) // 2)
        halves = self._column(array, start, middle), self._column(array, middle, stop)
        return np.concatenate([rows for rows, _ in halves]), np.concatenate([whole for _, whole in halves])

    def _seals(self, rows: dict[str, np.ndarray], start: int) -> np.ndarray:
        """For each row 64 bits that change with any of its numbers, its place, and what computed it."""
        names = (*self.layout.columns, STATUS)
        parts = [np.ascontiguousarray(rows[name]).view(np.uint8).reshape(len(rows[name]), -1) for name in names]
        origin = hashlib.blake2b(f"{self.layout.attributes['fingerprint']} {' '.join(names)}".encode(), digest_size=8)
        digests = []
        for number, row in enumerate(np.concatenate(parts, axis=1), start):
            digest = origin.copy()
            digest.update(number.to_bytes(8, "little") + row.tobytes())
            digests.append(int.from_bytes(digest.digest(), "little"))
        return np.array(digests, np.uint64)

    def _tell(self, damaged: list[int]) -> None:
        for number in damaged[:_TOLD]:
            start, stop = self._span(number)
            self.notes.append(
                f"Dies {start} to {stop - 1} of {self.path} do not agree with their checksums and are computed again."
            )
        if len(damaged) > _TOLD:
            self.notes.append(f"So are those of {len(damaged) - _TOLD} further blocks.")


@contextmanager
def opened(path: Path, layout: Layout, dies: int, block: int, resume: bool) -> Iterator[Store]:
    """The store at `path` for as long as this process works on it: created, or with `resume` gone on with.

    One that another process works on is joined, and the work shared. Raises `InputError` for a store that is there
    without `resume`, for one of another computation, version, block size or of more dies, and for what is no store.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with Leases(_leases(path)) as leases:
        if path.exists() and not resume and not leases.shared():
            raise InputError(f"{path} exists already; add `--resume` to go on with it, or choose another folder.")
        if not path.exists():
            create(path, layout, dies, block)
        yield Store(path, layout, dies, block, leases)
    if not leases.folder.exists():  # nobody else is at work, so what lies beside is of those who were killed
        for draft in path.parent.glob(f".{path.name}.*.part"):
            shutil.rmtree(draft, ignore_errors=True)


def discard(path: Path) -> None:
    """Remove a store, if there is one. Raises `InputError` while another process works on it."""
    if not path.exists():
        return
    with Leases(_leases(path)) as leases:
        if leases.shared():
            raise InputError(f"{path} is being computed by another process; stop it first, or choose another folder.")
        trash = draft_path(path)
        path.rename(trash)  # gone at once
        shutil.rmtree(trash, ignore_errors=True)


def _leases(path: Path) -> Path:
    return path.with_name(f".{path.name}.leases")


def _filled(array: Any, dies: int) -> np.ndarray:
    return np.full((dies, *array.shape[1:]), array.fill_value, array.dtype)
