"""The store of a sweep: a zarr group that survives kills, damage, and several processes.

Each block of dies is a file of its own as soon as it is computed, and moves into the shards of the columns when the
last block of a shard is there. Whatever is read is verified (`stored`), and what fails is computed again.
"""

import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from memsgyro_jax.base.errors import InputError

from .folder import Folder, RemotePath
from .layout import Layout, adapt, attributes_of, create, draft_path, held_by
from .lease import Leases
from .shards import holds
from .status import PENDING, STATUS
from .stored import StoredRows, waiting_of


_POLL = 0.2  # s between looks at blocks that others compute


class Store:
    """An open store of `dies` dies in blocks of `block`, of which this process is to see to those of `share`.

    `notes` holds what a person should know. Without `leases` it is only read, and must be finished.
    """

    def __init__(
        self,
        path: Path | RemotePath,
        layout: Layout,
        dies: int,
        block: int,
        leases: "Leases | Unleased | None",
        share: range | None = None,
    ):
        self.stored = StoredRows(path, layout, dies, block)
        self.share = range(self.stored.blocks) if share is None else share
        self._leases = leases
        self.notes = adapt(path, layout, dies, block)
        self._done = np.zeros(self.stored.blocks, bool)
        self._seen: dict[int, object] = {}
        damaged = [n for numbers in self.stored.within_shards(self.share) for n in self._look(numbers)]
        self.stored.tell(damaged, self.notes, "are computed again")

    @property
    def path(self) -> Path | RemotePath:
        """The zarr group."""
        return self.stored.path

    @property
    def rows(self) -> dict[str, np.ndarray]:
        """All columns, read and verified; pending where nothing sound is."""
        return self.stored.all()

    @property
    def done(self) -> int:
        """How many dies of the share are done."""
        return sum(np.subtract(*self.stored.span(number)[::-1]) for number in self.share if self._done[number])

    @property
    def missing(self) -> list[int]:
        """The blocks of the share that are not done."""
        return [number for number in self.share if not self._done[number]]

    @property
    def wanted(self) -> int:
        """How many dies the share has."""
        return min(self.share.stop * self.stored.block, self.stored.dies) - self.share.start * self.stored.block

    def unfinished(self) -> Iterator[int | None]:
        """Numbers of the blocks that this process is to compute and `write`, until all of the share are done.

        Each may be written while the next is computed already; `None` asks for the last one before others are waited
        for. Blocks that other processes compute are waited for, and taken over from those that die; so is the packing
        of the shards, so that what ends here is a zarr group as anything reads it.
        """
        waiting, leases = self.missing, self._leases
        if leases is None:
            if waiting:
                lacks = self.wanted - self.done
                raise InputError(f"{self.path} lacks {lacks} dies, but its folder cannot be written to; copy it.")
            return
        while waiting:
            last = None
            for number in waiting:
                # Looked for again once it is claimed: somebody may have written it just before.
                if not self._found(number) and leases.claim(number):
                    if self._found(number):
                        leases.release(number)
                        continue
                    yield number
                    if last is not None:
                        leases.release(last)
                    last = number
            if last is not None:
                if not self._done[last]:
                    yield None
                leases.release(last)
            before, waiting = len(waiting), [number for number in waiting if not self._done[number]]
            if len(waiting) == before:
                time.sleep(_POLL)
        stored = self.stored
        if (held_by(self.path) or 0) < stored.dies:  # another that goes on to fewer dies has just set back their number
            adapt(self.path, stored.layout, stored.dies, stored.block)
        if self.share:
            for shard in range(self.share.start // stored.per_shard, (self.share.stop - 1) // stored.per_shard + 1):
                while not self._pack(shard):  # another is at it: should it die, its work is taken over here too
                    time.sleep(_POLL)

    def write(self, number: int, rows: dict[str, np.ndarray]) -> None:
        """Write block `number`; rows beyond the number of dies are dropped.

        Writes nothing if another process has taken the block over. Raises `InputError` if the store was replaced.
        """
        stored = self.stored
        start, stop = stored.span(number)
        if self._identity() != (stored.layout.attributes["fingerprint"], stored.block):
            raise InputError(f"{self.path} was removed or replaced while its sweep ran; give each a folder of its own.")
        if not self._leases or not self._leases.holds(number):
            return
        records = stored.sealed({name: values[: stop - start] for name, values in rows.items()}, start)
        stored.waiting.write(stored.name_of(number), stored.file_of(records))
        self._seen[number] = self._stamp(number)
        self._done[number] = True
        self._pack(number // stored.per_shard)

    def _identity(self) -> tuple[object, object]:
        """Fingerprint and block size of what lies at the path now."""
        found = attributes_of(self.path)
        return found.get("fingerprint"), found.get("block")

    def _found(self, number: int) -> bool:
        """Whether the block is done; read if it was written since it was last looked at."""
        if not self._done[number] and self._stamp(number) != self._seen.get(number):
            self._look(range(number, number + 1))
        return bool(self._done[number])

    def _stamp(self, number: int) -> object:
        """Changes when a block or its shard is written; None when it never was."""
        place = self.stored.place_of(STATUS, number // self.stored.per_shard)
        stamps = self.stored.waiting.stamp(self.stored.name_of(number)), self.stored.shards.stamp(place)
        return stamps if any(stamps) else None

    def _look(self, numbers: range) -> list[int]:
        """See which blocks of one shard are done; gives those that claim to be and are not sound."""
        stored = self.stored
        stamps = {number: self._stamp(number) for number in numbers}
        if not any(stamps.values()):
            return []
        records, damaged = stored.read(numbers)
        for place, number in enumerate(numbers):
            mine = records[STATUS][place * stored.block : (place + 1) * stored.block]
            self._done[number] = bool(np.all(mine != PENDING))
        self._seen |= stamps
        return damaged

    def _pack(self, shard: int) -> bool:
        """Put the blocks of a shard into it, if all are there and wait; False while another process does it.

        What is missing on second look is found by the next who opens or reads the store.
        """
        stored, numbers = self.stored, self.stored.shard(shard)
        waiting = stored.waiting.names()
        mine = [number for number in numbers if stored.name_of(number) in waiting]
        if not mine or not self._leases:
            return True
        if len(mine) < len(numbers):
            content = stored.shards.read(stored.place_of(STATUS, shard))
            inside = np.zeros(stored.per_shard, bool) if content is None else holds(content, stored.per_shard)
            if not all(inside[number - numbers.start] for number in numbers if number not in mine):
                return True
        name = f"shard{shard}"
        if not self._leases.claim(name):
            return False
        try:
            records, _ = stored.read(numbers)
            # Who goes on to more dies will pack theirs with these.
            if np.all(records[STATUS] != PENDING) and held_by(self.path) == stored.dies:
                if not self._leases.holds(name):
                    return False
                for column, content in stored.shards_of(records):
                    place = stored.place_of(column, shard)
                    if content is None:
                        stored.shards.remove(place)
                    else:
                        stored.shards.write(place, content)
                for number in mine:
                    stored.waiting.remove(stored.name_of(number))
            return True
        finally:
            self._leases.release(name)


class Unleased:
    """Stands for leases where none can be had: whoever asks gets a block, and two may compute the same one, to the same
    bits. Parts do not, for each has its own.
    """

    def claim(self, block: int | str) -> bool:
        """Always granted."""
        return True

    def holds(self, block: int | str) -> bool:
        """Never lost."""
        return True

    def release(self, block: int | str) -> None:
        """Nothing is held."""


class Memory:
    """Where the dies of a sweep go that has no store: the columns, in memory."""

    notes: tuple[str, ...] = ()

    def __init__(self, dies: int, block: int):
        self.wanted, self._block, self._kept = dies, block, dict[int, dict[str, np.ndarray]]()

    @property
    def done(self) -> int:
        """How many dies are done."""
        return min(len(self._kept) * self._block, self.wanted)

    @property
    def rows(self) -> dict[str, np.ndarray]:
        """All columns."""
        return {
            name: np.concatenate([part[name] for part in self._kept.values()])[: self.wanted] for name in self._kept[0]
        }

    @property
    def missing(self) -> list[int]:
        """The blocks that are not there."""
        return [number for number in range(-(-self.wanted // self._block)) if number not in self._kept]

    def unfinished(self) -> Iterator[int | None]:
        """As of a `Store`."""
        yield from self.missing
        if self.missing:
            yield None

    def write(self, number: int, rows: dict[str, np.ndarray]) -> None:
        """Keep block `number`."""
        self._kept[number] = rows


@contextmanager
def opened(
    path: Path | RemotePath, layout: Layout, dies: int, block: int, resume: bool, share: range | None = None
) -> Iterator[Store]:
    """The store at `path` for as long as this process works on it: created, or with `resume` gone on with.

    One that another process works on is joined, and the work shared; a finished one whose folder cannot be written to
    is read. Raises `InputError` for a store that is there
    without `resume`, for one of another computation, version, block size or of more dies, and for what is no store.
    """
    if isinstance(path, RemotePath):
        if not attributes_of(path):
            create(path, layout, dies, block)
        elif not resume:
            raise InputError(f"{path} exists already; add `--resume` to go on with it, or choose another folder.")
        yield Store(path, layout, dies, block, Unleased(), share)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    if resume and path.exists() and not _writable(path.parent):
        yield Store(path, layout, dies, block, None, share)
        return
    with Leases(leases_of(path)) as leases:
        if path.exists() and not resume and not leases.shared():
            raise InputError(
                f"{path} exists already; add `--resume` to go on with it, `--overwrite` to replace it, or choose "
                "another folder."
            )
        if not path.exists():
            create(path, layout, dies, block)
        yield Store(path, layout, dies, block, leases, share)
        waiting_of(path).tidy()
    if not leases.folder.exists():  # nobody else is at work, so what lies beside is of those who were killed
        for draft in path.parent.glob(f".{path.name}.*.part"):
            shutil.rmtree(draft, ignore_errors=True)


def discard(path: Path | RemotePath) -> None:
    """Remove a store, if there is one. Raises `InputError` while another process is seen to work on it."""
    if not path.exists():
        return
    if isinstance(path, RemotePath):
        Folder(path).discard()
        waiting_of(path).discard()
        return
    with Leases(leases_of(path)) as leases:
        if leases.shared():
            raise InputError(f"{path} is being computed by another process; stop it first, or choose another folder.")
        trash = draft_path(path)
        path.rename(trash)  # gone at once
        shutil.rmtree(trash, ignore_errors=True)
        waiting_of(path).discard()


def _writable(folder: Path) -> bool:
    """Whether a file can be made there, which permissions alone do not tell."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def leases_of(path: Path) -> Path:
    """Where those who work on a store sign in."""
    return path.with_name(f".{path.name}.leases")
