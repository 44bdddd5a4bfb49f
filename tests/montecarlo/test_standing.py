"""How far a store is: every die is counted once, however many there are."""

import resource
import time

import numpy as np
import pytest

from memsgyro_jax.montecarlo import layout as layouts
from memsgyro_jax.montecarlo.layout import LABELS, PROCESSOR, DieArray, Layout
from memsgyro_jax.montecarlo.shards import packed
from memsgyro_jax.montecarlo.standing import standing_of
from memsgyro_jax.montecarlo.status import DIVERGED, LOST, PENDING, STATUS
from memsgyro_jax.montecarlo.store import opened


LAYOUT = Layout(
    {"value": DieArray((), (), "1")}, {}, {"fingerprint": "0" * 16, "versions": "none", PROCESSOR: "this", LABELS: {}}
)
DIES, BLOCK = 40, 16


def rows_of(number):
    dies = np.arange(number * BLOCK, (number + 1) * BLOCK)
    status = np.where(dies == 5, LOST, np.where(dies == 30, DIVERGED, 0)).astype(np.int8)
    return {"value": np.cos(dies), STATUS: status}


def test_the_standing_counts_every_die_once(tmp_path, monkeypatch):
    """Waiting, packed and missing blocks, a shard that cannot be read, and a last block that is not full."""
    monkeypatch.setattr(layouts, "SHARD", 2 * BLOCK)
    path = tmp_path / "dies.zarr"
    with opened(path, LAYOUT, DIES, BLOCK, resume=True) as store:
        work = store.unfinished()
        store.write(next(work), rows_of(0))
        found = standing_of(tmp_path)
        assert (found.dies, found.done, found.lost, found.waiting) == (DIES, BLOCK, 1, BLOCK)
        store.write(next(work), rows_of(1))
        assert standing_of(tmp_path).done == 2 * BLOCK
        store.write(next(work), rows_of(2))
        assert next(work, None) is None
    found = standing_of(tmp_path)
    assert (found.done, found.lost, found.diverged, found.waiting, found.finished) == (DIES, 1, 1, 0, True)
    place = path / STATUS / "c" / "0"
    whole = place.read_bytes()
    place.write_bytes(bytes([whole[0] ^ 1]) + whole[1:])
    assert standing_of(tmp_path).done == DIES - BLOCK, "one block is damaged"
    place.write_bytes(whole[:-1])
    assert standing_of(tmp_path).done == DIES - 2 * BLOCK, "the index is"


@pytest.mark.slow
def test_the_standing_of_a_hundred_million_dies_is_told_in_a_minute(tmp_path):
    """A stand-in for the loop: the statuses alone, 1 % of the dies lost. The memory is that of a shard."""
    dies, block = 100_000_000, 32
    layouts.create(tmp_path / "dies.zarr", LAYOUT, dies, block)
    per, folder = layouts.blocks_per_shard(block), tmp_path / "dies.zarr" / STATUS / "c"
    statuses = np.where(np.random.default_rng(1).random(per * block) < 0.01, LOST, 0).astype(np.int8)
    whole, rest = divmod(dies, per * block)
    folder.mkdir(parents=True, exist_ok=True)
    content = packed(statuses, block, per, PENDING)
    for number in range(whole):
        (folder / str(number)).write_bytes(content)
    (folder / str(whole)).write_bytes(packed(statuses[:rest], block, per, PENDING))
    memory, begun = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    found = standing_of(tmp_path)
    assert time.process_time() - begun < 60.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory < 30 * 1024
    assert found.finished
    assert found.lost == np.sum(statuses == LOST) * whole + np.sum(statuses[:rest] == LOST)
