"""Blocks on the workers of a Dask scheduler: a killed worker costs one block, and no bit."""

import os
import signal
import sys
import time
from collections import Counter
from functools import partial

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.farm import farmed
from memsgyro_jax.montecarlo.layout import LABELS, DieArray, Layout
from memsgyro_jax.montecarlo.status import STATUS
from memsgyro_jax.montecarlo.store import opened


BLOCKS, BLOCK = 40, 4
LAYOUT = Layout({"value": DieArray((), (), "1")}, {}, {"fingerprint": "a" * 16, "versions": "jax 0", LABELS: {}})


def compute(path, log, number: int) -> int:
    """A block of a sweep, but for the loop."""
    with opened(path, LAYOUT, BLOCKS * BLOCK, BLOCK, resume=True, share=range(number, number + 1)) as store:
        for wanted in store.unfinished():
            (log / f"{number}-{os.getpid()}-{time.monotonic_ns()}").touch()
            time.sleep(0.02)
            dies = np.arange(BLOCK * wanted, BLOCK * (wanted + 1))
            store.write(wanted, {"value": np.sin(dies), STATUS: np.zeros(BLOCK, np.int8)})
    return BLOCK


def test_a_killed_worker_costs_one_block(tmp_path):
    distributed = pytest.importorskip("distributed")
    import cloudpickle

    path, log = tmp_path / "dies.zarr", tmp_path / "log"
    log.mkdir()
    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "silence_logs": 50}
    with distributed.LocalCluster(**options) as cluster:
        done = []
        for number, dies in farmed(partial(compute, path, log), range(BLOCKS), cluster.scheduler_address):
            done.append(number)
            assert dies == BLOCK
            if len(done) == BLOCKS // 4:
                begun = sorted(log.iterdir(), key=lambda file: int(file.name.split("-")[2]))
                os.kill(int(begun[-1].name.split("-")[1]), signal.SIGKILL)
    assert sorted(done) == list(range(BLOCKS))
    begun = Counter(file.name.split("-")[0] for file in log.iterdir())
    assert set(begun) == {str(number) for number in range(BLOCKS)}
    assert begun.total() <= BLOCKS + 1
    with opened(path, LAYOUT, BLOCKS * BLOCK, BLOCK, resume=True) as store:
        assert list(store.unfinished()) == []
        assert store.notes == []
        assert store.rows["value"].tobytes() == np.sin(np.arange(BLOCKS * BLOCK)).tobytes()


def test_where_no_scheduler_answers_it_is_one_sentence(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("memsgyro_jax.base.farm._PATIENCE", 0.2)
    for address in ("tcp://127.0.0.1:9", "nonsense"):
        with pytest.raises(InputError, match=f"at {address} none answers"):
            list(farmed(compute, range(2), address))


def test_a_number_is_no_address_and_leaves_nothing_behind(tmp_path):
    """`--dask 2` waited for a minute, ended in a traceback, and left a store in the way of the right address."""
    pytest.importorskip("distributed")
    loop = mg.default_study().loop
    with pytest.raises(InputError, match="as tcp://host:8786"):
        mg.sweep(loop, mg.Spread.relative("1 %"), dies=2, sample_rate=50e3, duration=1e-3, out=tmp_path, dask="2")
    assert list(tmp_path.iterdir()) == []
