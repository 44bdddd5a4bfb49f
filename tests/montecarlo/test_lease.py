"""Several processes on one store: each block is computed once, and what the dead leave is taken over."""

import os
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.montecarlo import lease
from memsgyro_jax.montecarlo.layout import LABELS, DieArray, Layout
from memsgyro_jax.montecarlo.lease import Leases
from memsgyro_jax.montecarlo.status import STATUS
from memsgyro_jax.montecarlo.store import Store, discard, opened
from memsgyro_jax.montecarlo.stored import StoredRows


BLOCK = 4
LAYOUT = Layout({"value": DieArray((), (), "1")}, {}, {"fingerprint": "a" * 16, "versions": "jax 0", LABELS: {}})


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(lease, "BEAT", 0.05)
    monkeypatch.setattr(lease, "EXPIRY", 0.5)


def rows_of(number: int) -> dict[str, np.ndarray]:
    dies = np.arange(BLOCK * number, BLOCK * (number + 1))
    return {"value": np.sin(dies), STATUS: np.zeros(BLOCK, np.int8)}


def test_a_block_has_one_owner_at_a_time(tmp_path):
    with Leases(tmp_path / "l") as one, Leases(tmp_path / "l") as other:
        assert one.claim(0)
        assert not other.claim(0)
        assert other.claim(1)
        assert one.holds(0)
        assert not other.holds(0)
        one.release(0)
        assert not one.holds(0)
        assert other.claim(0)
    assert list(tmp_path.iterdir()) == []


def signed_by(folder: Path, host: str, process: int) -> str:
    """The mark of a process that has claimed block 0 and then died."""
    folder.mkdir()
    (folder / "owner-dead").write_text(f"{host}\n{process}")
    (folder / "0.0").write_text("owner-dead")
    return "owner-dead"


def test_what_a_dead_process_of_this_machine_held_is_free_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(lease, "EXPIRY", 1e9)
    child = subprocess.Popen(["true"])
    child.wait()
    signed_by(tmp_path / "l", lease._host(), child.pid)
    with Leases(tmp_path / "l") as mine:
        assert not mine.shared()
        assert mine.claim(0)
        assert mine.holds(0)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["owner-dead", ""])
def test_what_a_dead_process_of_another_machine_held_is_free_after_a_while(tmp_path, name):
    signed_by(tmp_path / "l", "elsewhere", os.getpid())
    (tmp_path / "l" / "0.0").write_text(name)  # without a name: it died before it wrote one
    with Leases(tmp_path / "l") as mine:
        began = time.monotonic()
        while not mine.claim(0):
            time.sleep(0.01)
        assert 0.5 <= time.monotonic() - began < 5.0


def test_who_slept_too_long_has_lost_its_block_and_writes_nothing(tmp_path):
    with opened(tmp_path / "s", LAYOUT, 4, BLOCK, resume=False) as sleeper:
        work = sleeper.unfinished()
        assert next(work) == 0
        sleeper._leases._left.set()
        with opened(tmp_path / "s", LAYOUT, 4, BLOCK, resume=True) as awake:
            for number in awake.unfinished():
                sleeper.write(0, rows_of(1))  # what must not be seen
                awake.write(number, rows_of(number))
        assert list(work) == [None]  # asks for what would have been written
        np.testing.assert_array_equal(sleeper.rows["value"], rows_of(0)["value"])


def test_of_many_that_wait_for_the_dead_one_takes_over(tmp_path):
    signed_by(tmp_path / "l", "elsewhere", 1)
    got: list[Leases] = []

    def wait(leases: Leases) -> None:
        end = time.monotonic() + 1.5
        while time.monotonic() < end:
            if leases.claim(0):
                got.append(leases)
                return

    with Leases(tmp_path / "l") as a, Leases(tmp_path / "l") as b, Leases(tmp_path / "l") as c:
        threads = [threading.Thread(target=wait, args=(leases,)) for leases in (a, b, c)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(got) == 1
        assert got[0].holds(0)


def test_four_that_start_at_once_share_the_work(tmp_path):
    """Without `resume`: who finds that another has just begun joins it. No block is computed twice."""
    blocks, computed, failed, rows = 40, [], [], []
    start = threading.Barrier(4)

    def work() -> None:
        try:
            start.wait()
            with opened(tmp_path / "s", LAYOUT, BLOCK * blocks, BLOCK, resume=False) as store:
                for number in store.unfinished():
                    computed.append(number)
                    store.write(number, rows_of(number))
                rows.append(store.rows)
        except BaseException as error:
            failed.append(error)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failed == []
    assert sorted(computed) == list(range(blocks))
    for found in rows:
        assert found["value"].tobytes() == np.sin(np.arange(BLOCK * blocks)).tobytes()
    assert [file.name for file in tmp_path.iterdir()] == ["s"]


@pytest.mark.parametrize("share", [None, range(1), range(2, 4)])
def test_whoever_ends_sees_the_shard_packed(tmp_path, monkeypatch, share):
    """All blocks are there, and who packs them dies on another machine, which is seen after a while: a part that ends
    leaves what anything reads as zarr.
    """
    with monkeypatch.context() as patch, opened(tmp_path / "s.zarr", LAYOUT, 14, BLOCK, resume=False) as store:
        patch.setattr(Store, "_pack", lambda *_: True)
        for number in store.unfinished():
            store.write(number, rows_of(number))
    assert len(list((tmp_path / "s.blocks").iterdir())) == 4
    signed_by(tmp_path / ".s.zarr.leases", "elsewhere", 1)
    (tmp_path / ".s.zarr.leases" / "0.0").rename(tmp_path / ".s.zarr.leases" / "shard0.0")
    with opened(tmp_path / "s.zarr", LAYOUT, 14, BLOCK, resume=True, share=share) as store:
        assert list(store.unfinished()) == []
    with xr.open_zarr(tmp_path / "s.zarr", consolidated=False, mask_and_scale=False) as found:
        assert found["value"].values.tobytes() == np.sin(np.arange(14)).tobytes()
        assert not found[STATUS].values.any()
    assert [file.name for file in tmp_path.iterdir()] == ["s.zarr"]


def test_a_store_at_work_is_not_removed(tmp_path):
    def begun() -> Store:
        return opened(tmp_path / "s", LAYOUT, 8, BLOCK, resume=False)

    with begun() as store:
        for number in store.unfinished():
            store.write(number, rows_of(number))
            with pytest.raises(InputError, match="being computed by another process"):
                discard(tmp_path / "s")
    with pytest.raises(InputError, match="--resume"), begun():
        pass
    discard(tmp_path / "s")
    assert list(tmp_path.iterdir()) == []


def test_who_finds_its_store_replaced_writes_nothing(tmp_path):
    other = Layout(LAYOUT.columns, {}, LAYOUT.attributes | {"fingerprint": "b" * 16})
    with opened(tmp_path / "s", LAYOUT, 8, BLOCK, resume=False) as store:
        number = next(store.unfinished())
        (tmp_path / "s").rename(tmp_path / "old")
        with opened(tmp_path / "s", other, 8, BLOCK, resume=False), pytest.raises(InputError, match="replaced"):
            store.write(number, rows_of(number))


@pytest.mark.parametrize("first", [6, 10])
def test_who_wants_more_dies_shares_the_rest(tmp_path, first):
    with opened(tmp_path / "s", LAYOUT, first, BLOCK, resume=False) as one:
        work = one.unfinished()
        one.write(next(work), rows_of(0))
        with opened(tmp_path / "s", LAYOUT, 14, BLOCK, resume=True) as more:
            for number in work:
                one.write(number, rows_of(number))
            for number in more.unfinished():
                more.write(number, rows_of(number))
        assert more.rows["value"].tobytes() == np.sin(np.arange(14)).tobytes()
        assert one.rows["value"].tobytes() == np.sin(np.arange(first)).tobytes()


def test_a_block_that_is_written_while_it_is_read_is_not_taken_for_damaged(tmp_path, monkeypatch):
    with opened(tmp_path / "s", LAYOUT, 8, BLOCK, resume=False) as one:
        work = one.unfinished()
        one.write(next(work), rows_of(0))
        number, file, looking = next(work), StoredRows._from_file, []

        def slow(stored, *given):
            found = file(stored, *given)
            if not looking:
                looking.append(True)
                one.write(number, rows_of(number))
            return found

        monkeypatch.setattr(StoredRows, "_from_file", slow)
        with opened(tmp_path / "s", LAYOUT, 8, BLOCK, resume=True) as other:
            assert other.notes == []
            assert list(other.unfinished()) == []
            assert other.rows["value"].tobytes() == np.sin(np.arange(8)).tobytes()
