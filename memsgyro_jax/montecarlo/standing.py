"""How far a store is, read from its statuses alone."""

import io
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import aligned

from .folder import Folder, RemotePath, place_of
from .layout import SCHEMA, attributes_of, blocks_per_shard, held_by
from .lease import signed_in
from .shards import tallied, unpacked
from .status import DIVERGED, LOST, OK, PENDING, STATUS
from .store import leases_of
from .stored import waiting_of


@dataclass(frozen=True)
class Standing(Shown):
    """Of the `dies` of the store at `path` so many are `done`, `lost` and `diverged`; `waiting` of the done ones are in
    files of single blocks. `processes` have signed in and hold `claimed` blocks now, unless they died just now.

    Statuses are taken as they stand; `summarise` and going on verify them.
    """

    path: Path | RemotePath
    dies: int
    done: int
    lost: int
    diverged: int
    waiting: int
    processes: int
    claimed: int

    @property
    def finished(self) -> bool:
        """Whether all dies are done."""
        return self.done == self.dies

    def __repr__(self) -> str:
        fate = f"{self.lost} lost, {self.diverged} diverged"
        rows = [
            ("dies done", f"{self.done} of {self.dies} ({_share(self.done, self.dies)}): {fate}"),
            *([("  of them not yet in a shard", str(self.waiting))] if self.waiting else []),
            ("at work", f"{self.processes} processes on {self.claimed} blocks" if self.processes else "nobody"),
        ]
        return aligned(rows)


def standing_of(out: str | Path) -> Standing:
    """How far the sweep in the folder `out` is. Raises `InputError` where there is no store."""
    path = place_of(out) / "dies.zarr"
    attributes, dies = attributes_of(path), held_by(path)
    block = attributes.get("block")
    if attributes.get("schema") != SCHEMA or not isinstance(block, int) or block < 1 or dies is None:
        other = f"is {attributes['schema']}" if "schema" in attributes else "there is none"
        raise InputError(
            f"{path} must be the store of a sweep ({SCHEMA}), but {other}; give the folder that the sweep has as "
            "`--out`."
        )
    per_shard, blocks, shards, files = blocks_per_shard(block), -(-dies // block), Folder(path), waiting_of(path)
    counts, waiting, there = Counter[int](), 0, _numbers(files)  # looked for once: a listing may be long
    for first in range(0, blocks, per_shard):
        numbers = range(first, min(first + per_shard, blocks))
        # What waits first: it is removed when the shard is written.
        own = {n: _status_in(files.read(f"{n}.npy")) for n in numbers if n in there}
        content = shards.read(f"{STATUS}/c/{first // per_shard}")
        if not own and (first + per_shard) * block <= dies:
            counts.update(tallied(content, block, per_shard, PENDING))
            continue
        rows, _ = unpacked(content, range(len(numbers)), block, per_shard, np.empty(0, "i1"), PENDING)
        for number, found in own.items():
            mine = rows[(number - first) * block : (number - first) * block + len(found)]
            waiting += int(np.count_nonzero((mine == PENDING) & (found != PENDING)))
            mine[mine == PENDING] = found[mine == PENDING]
        counts.update(rows[: dies - first * block].tolist())
    ok, lost, diverged = (counts[status] for status in (OK, LOST, DIVERGED))
    at_work = signed_in(leases_of(path)) if isinstance(path, Path) else (0, 0)
    return Standing(path, dies, ok + lost + diverged, lost, diverged, waiting, *at_work)


def _numbers(files: Folder) -> set[int]:
    """Of the blocks that are files of their own."""
    return {int(name[:-4]) for name in files.names() if name.endswith(".npy") and name[:-4].isdecimal()}


def _status_in(content: bytes | None) -> np.ndarray:
    try:
        return np.load(io.BytesIO(content or b""), allow_pickle=False)[STATUS]
    except Exception:  # what a reader makes of damaged bytes is its own affair
        return np.empty(0, "i1")


def _share(done: int, dies: int) -> str:
    return "100 %" if done == dies else f"{min(100.0 * done / dies, 99.9):.1f} %"
