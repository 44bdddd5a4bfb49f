"""The dies of a store, read: from its shards, and from files of single blocks that wait to be put into one.

A die counts when its status is one and its seal, a checksum over all of its row, its number and what computed it,
agrees: whatever is unfinished, cut short, flipped, missing or in another's place counts as not computed. No order of
writes, by however many processes, can make a wrong row count.
"""

import hashlib
import io
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, UInt64

from .folder import Folder, RemotePath
from .layout import SEAL, Layout, blocks_per_shard
from .shards import packed, unpacked
from .status import MEANING, PENDING, STATUS


_AT_ONCE = 256  # rows whose seals are made together: they stay in the cache
_TOLD = 10  # damaged blocks that are named one by one


def waiting_of(path: Path | RemotePath) -> Folder:
    """Where the blocks of a store are that are not yet in a shard."""
    return Folder(path.with_suffix(".blocks"))


@dataclass(frozen=True)
class StoredRows:
    """The dies of the store at `path`, in blocks of `block`."""

    path: Path | RemotePath
    layout: Layout
    dies: int
    block: int

    @property
    def blocks(self) -> int:
        """How many there are."""
        return -(-self.dies // self.block)

    @cached_property
    def per_shard(self) -> int:
        """Blocks in a shard."""
        return blocks_per_shard(self.block)

    @cached_property
    def shards(self) -> Folder:
        """The zarr group."""
        return Folder(self.path)

    @cached_property
    def waiting(self) -> Folder:
        """The blocks that are not yet in a shard, a file each: a table of `record` in NumPy's format."""
        return waiting_of(self.path)

    @cached_property
    def record(self) -> np.dtype:
        """A row: the columns, the status, the seal, 64 bits each."""
        columns = [(name, "<f8", column.sizes) for name, column in self.layout.columns.items()]
        return np.dtype([*columns, (STATUS, "<i8"), (SEAL, "<u8")])

    @cached_property
    def fill(self) -> dict[str, float]:
        """What stands where nothing was written."""
        return dict.fromkeys(self.layout.columns, np.nan) | {STATUS: PENDING, SEAL: 0}

    def span(self, number: int) -> tuple[int, int]:
        """The first die of a block, and the one behind it."""
        return number * self.block, min((number + 1) * self.block, self.dies)

    def shard(self, number: int) -> range:
        """The blocks of a shard."""
        return range(number * self.per_shard, min((number + 1) * self.per_shard, self.blocks))

    def within_shards(self, numbers: range) -> Iterator[range]:
        """A range of blocks, cut where shards begin."""
        first = numbers.start
        while first < numbers.stop:
            last = min((first // self.per_shard + 1) * self.per_shard, numbers.stop)
            yield range(first, last)
            first = last

    def read(self, numbers: range) -> tuple[np.ndarray, list[int]]:
        """The records of these blocks of one shard, pending where not sound, and the blocks that claim more."""
        start, stop = numbers.start * self.block, min(numbers.stop * self.block, self.dies)
        # What waits first: it is removed when the shard is written, and never the other way round.
        there = self.waiting.names()
        waiting = {n: self.waiting.read(self.name_of(n)) for n in numbers if self.name_of(n) in there}
        records, claimed, sound = self._from_shard(numbers)
        for number, content in waiting.items():
            if content is not None:
                mine = slice((number - numbers.start) * self.block, (number - numbers.start + 1) * self.block)
                found = self._from_file(content)
                good = self._sound(found, number * self.block)
                records[mine][good], sound[mine][good], claimed[mine] = found[good], True, True
        records, claimed, sound = records[: stop - start], claimed[: stop - start], sound[: stop - start]
        records[~sound] = self._nothing(1)
        damaged = np.flatnonzero(claimed & ~sound) // self.block + numbers.start
        return records, sorted({int(number) for number in damaged})

    def groups(self, notes: list[str]) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
        """The first die and the columns of one shard after another; what is damaged is told in `notes`."""
        damaged = []
        for numbers in self.within_shards(range(self.blocks)):
            records, bad = self.read(numbers)
            damaged += bad
            rows = {name: records[name] for name in self.layout.columns}
            yield numbers.start * self.block, rows | {STATUS: records[STATUS].astype("i1")}
        self.tell(damaged, notes, "count as not computed")

    def all(self) -> dict[str, np.ndarray]:
        """All columns, in memory."""
        parts = [rows for _, rows in self.groups([])]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def sealed(self, rows: dict[str, np.ndarray], first: int) -> np.ndarray:
        """Columns as records, from die `first` on, with their seals."""
        records = np.empty(len(rows[STATUS]), self.record)
        for name in (*self.layout.columns, STATUS):
            records[name] = rows[name]
        records[SEAL] = self._seals(records, first)
        return records

    def file_of(self, records: np.ndarray) -> bytes:
        """What the file of a block holds."""
        content = io.BytesIO()
        np.save(content, records, allow_pickle=False)
        return content.getvalue()

    def name_of(self, number: int) -> str:
        """The file of a block that waits."""
        return f"{number}.npy"

    def place_of(self, name: str, number: int) -> str:
        """The file of a column's shard."""
        return "/".join([name, "c", str(number), *("0" for _ in self.record[name].shape)])

    def shards_of(self, records: np.ndarray) -> Iterator[tuple[str, bytes | None]]:
        """Columns of a whole shard and what their files hold, the status last."""
        for name in (*self.layout.columns, SEAL, STATUS):
            column = records[name].astype("i1") if name == STATUS else records[name]
            yield name, packed(column, self.block, self.per_shard, self.fill[name])

    def tell(self, damaged: list[int], notes: list[str], fate: str) -> None:
        """Name the damaged blocks in `notes`."""
        for number in damaged[:_TOLD]:
            start, stop = self.span(number)
            notes.append(f"Dies {start} to {stop - 1} of {self.path} do not agree with their checksums and {fate}.")
        if len(damaged) > _TOLD:
            notes.append(f"So do those of {len(damaged) - _TOLD} further blocks.")

    def _from_shard(self, numbers: range) -> tuple[np.ndarray, Bool[np.ndarray, " dies"], Bool[np.ndarray, " dies"]]:
        """Records, which dies claim to be done, and which of them are sound."""
        records = self._nothing(len(numbers) * self.block)
        shard = numbers.start // self.per_shard
        inside = range(numbers.start - shard * self.per_shard, numbers.stop - shard * self.per_shard)
        claimed = np.zeros(len(records), bool)
        if self.shards.stamp(self.place_of(STATUS, shard)) is None:
            return records, claimed, claimed.copy()
        readable = np.ones(len(records), bool)
        # The status first, as it is written last: of a shard that another process is writing it says pending.
        for name in (STATUS, SEAL, *self.layout.columns):
            content = self.shards.read(self.place_of(name, shard))
            like = np.empty(0, "i1") if name == STATUS else records[name]
            values, whole = unpacked(content, inside, self.block, self.per_shard, like, self.fill[name])
            records[name] = values
            readable &= whole
            if name == STATUS:
                claimed = (values != PENDING) | ~whole
        return records, claimed, readable & self._sound(records, numbers.start * self.block)

    def _from_file(self, content: bytes) -> np.ndarray:
        """The records in the file of a block; what is no table of them gives none that is done."""
        try:
            found = np.load(io.BytesIO(content), allow_pickle=False)
        except Exception:  # what a reader makes of damaged bytes is its own affair
            return self._nothing(self.block)
        records = self._nothing(self.block)
        if isinstance(found, np.ndarray) and found.dtype == self.record and found.ndim == 1:
            records[: len(found)] = found[: self.block]
        return records

    def _nothing(self, count: int) -> np.ndarray:
        records = np.empty(count, self.record)
        for name, value in self.fill.items():
            records[name] = value
        return records

    def _sound(self, records: np.ndarray, first: int) -> Bool[np.ndarray, " dies"]:
        known = np.isin(records[STATUS], [status for status in MEANING if status != PENDING])
        good = np.zeros(len(records), bool)
        if known.any():
            good[known] = (self._seals(records, first) == records[SEAL])[known]
        return good

    def _seals(self, records: np.ndarray, first: int) -> UInt64[np.ndarray, " dies"]:
        """For each row 64 bits that change with any of its numbers, its place, and what computed it."""
        words = records.view("<u8").reshape(len(records), -1)[:, :-1]
        numbers = np.arange(first, first + len(records), dtype=np.uint64)
        seals = np.empty(len(records), np.uint64)
        for start in range(0, len(records), _AT_ONCE):
            some = slice(start, start + _AT_ONCE)
            own = _mixed(numbers[some], self._keys[-1])
            seals[some] = own + _mixed(words[some], self._keys[:-1]).sum(axis=1, dtype=np.uint64)
        return seals

    @cached_property
    def _keys(self) -> UInt64[np.ndarray, " words"]:
        """An odd number for each word of a row and one for its place, of what computed it and the names of columns."""
        text = f"{self.layout.attributes['fingerprint']} {' '.join((*self.layout.columns, STATUS))}"
        digest = hashlib.blake2b(text.encode(), digest_size=32).digest()
        drawn = np.random.PCG64(int.from_bytes(digest, "little")).random_raw(self.record.itemsize // 8)
        return drawn | np.uint64(1)


def _mixed(words: np.ndarray, keys: np.ndarray) -> np.ndarray:
    """Each word as another, none as the same, so that a sum of them tells when one has changed (D. H. Lehmer's
    multiplication with the shifts of G. Marsaglia, J. Stat. Softw. 8 (2003) 14); a hundredth of the time of a
    cryptographic digest.
    """
    mixed = words * keys
    mixed ^= mixed >> np.uint64(32)
    mixed *= np.uint64(0x9E3779B97F4A7C15)
    mixed ^= mixed >> np.uint64(29)
    return mixed
