"""Sweeps that share a store and are killed at random moments: no row is lost or differs, hardly one is made twice."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter

import numpy as np
import pytest
import xarray as xr


# Runs what it is told to in a process of its own for each line, the folder and the part, that it reads: Python and its
# imports are there already. What happens is told in lines: "start PROCESS PART", "wrote FOLDER BLOCK",
# "end PROCESS FOLDER PART" or "failed PROCESS".
NURSERY = """
import os, signal, sys, time, traceback
IMPORTS
from memsgyro_jax.montecarlo.store import Store

def tell(*words):
    os.write(1, (" ".join(map(str, words)) + "\\n").encode())

def told(store, number, rows):
    write(store, number, rows)
    if store._done[number]:
        tell("wrote", folder, number)

signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # leaves no dead behind
for line in sys.stdin:
    if os.fork() == 0:
        break
else:
    sys.exit()

(folder, part), write = line.split(), Store.write
Store.write = told
tell("start", os.getpid(), part)
try:
    RUN
    tell("end", os.getpid(), folder, part)
except BaseException:
    traceback.print_exc()
    tell("failed", os.getpid())
os._exit(0)
"""

IMPORTS = """
from memsgyro_jax import runtime
runtime.configure(devices=1)
import memsgyro_jax as mg
import xarray, zarr
from memsgyro_jax.montecarlo import sweep
"""

SWEEP = """
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    observer = mg.ExtendedKalmanFilter.for_device(gyro, readout, annealing=mg.Annealing())
    loop = mg.ClosedLoop(gyro, readout, observer, mg.DampingCompensation(mg.Tone(600.0, 53.95)))
    lot = mg.sweep(loop, mg.Spread.relative(0.15), dies=1600, chunk=1, sample_rate=100e3, duration=5e-4, bound_dies=0,
                   out=folder, resume=True)
    assert lot.notes == (), lot.notes
"""

STAND_IN = """
import numpy as np, zarr.storage, zarr.codecs
from pathlib import Path
from memsgyro_jax.montecarlo import layout
from memsgyro_jax.montecarlo.layout import LABELS, DieArray, Layout
from memsgyro_jax.montecarlo.store import opened
layout.SHARD = 28
LAYOUT = Layout({"value": DieArray((), (), "1")}, {}, {"fingerprint": "a" * 16, "versions": "jax 0", LABELS: {}})
"""

SHARE = """
    number, count = map(int, part.split("/"))
    share = range((number - 1) * BLOCKS // count, number * BLOCKS // count)
    with opened(Path(folder) / "dies.zarr", LAYOUT, 4 * BLOCKS, 4, True, share) as store:
        for block in store.unfinished():
            time.sleep(0.01)
            store.write(block, {"value": np.sin(np.arange(4 * block, 4 * block + 4)), "status": np.zeros(4, np.int8)})
        assert store.notes == [], store.notes
"""


class Nursery:
    """Starts and kills processes; knows which live, which blocks they wrote, and which (folder, part) are complete."""

    def __init__(self, imports: str, run: str, errors):
        script = NURSERY.replace("IMPORTS", imports).replace("    RUN", run)
        clean = {n: v for n, v in os.environ.items() if not n.startswith(("XLA_FLAGS", "JAX_", "MEMSGYRO_"))}
        self.process = subprocess.Popen(
            [sys.executable, "-c", script], env=clean | {"PYTHONPATH": os.pathsep.join(sys.path)}, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors,
        )  # fmt: skip
        self.living: dict[int, str] = {}
        self.wrote: Counter[tuple[str, str]] = Counter()
        self.complete: set[tuple[str, ...]] = set()
        self.wanted, self.lock = 0, threading.Lock()
        self.reader = threading.Thread(target=self._read)
        self.reader.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            kind, *words = line.split()
            if kind == "start":
                self.living[int(words[0])] = words[1]
            elif kind == "wrote":
                self.wrote[words[0], words[1]] += 1
            else:
                with self.lock:
                    if self.living.pop(int(words[0]), None) is not None:  # else it ended while it was being killed
                        self.wanted -= 1
                self.complete |= {tuple(words[1:])} if words[1:] else set()

    def start(self, folder, part: str = "1/1") -> None:
        with self.lock:
            self.wanted += 1
        self.process.stdin.write(f"{folder} {part}\n")
        self.process.stdin.flush()

    def kill(self, process: int) -> str | None:
        """Gives its part; None if it has just ended."""
        with self.lock:
            part = self.living.pop(process, None)
            self.wanted -= part is not None
        if part is not None:
            os.kill(process, signal.SIGKILL)
        return part

    def close(self) -> None:
        """Ends those that still live, and the nursery."""
        self.process.stdin.close()
        for process in list(self.living):
            self.kill(process)
        self.process.wait()
        self.reader.join()
        self.process.stdout.close()


def rows(folder) -> dict[str, bytes]:
    with xr.open_zarr(folder / "dies.zarr", consolidated=False, mask_and_scale=False) as data:
        return {name: data[name].values.tobytes() for name in data.data_vars}


def assert_kills_cost_nothing(tmp_path, kills: int, pause: float) -> None:
    generator = np.random.default_rng(0)
    with (tmp_path / "errors").open("w") as errors:
        nursery = Nursery(IMPORTS, SWEEP, errors)
        try:
            nursery.start(tmp_path / "alone")
            while nursery.wanted and nursery.process.poll() is None:
                time.sleep(0.05)
            killed, folder = 0, None
            while killed < kills and nursery.process.poll() is None:
                if folder is None or (str(folder), "1/1") in nursery.complete:
                    folder = tmp_path / f"shared{len(nursery.complete)}"
                while nursery.wanted < 4:
                    nursery.start(folder)
                time.sleep(generator.uniform(0.0, pause))
                if nursery.living:
                    nursery.kill(int(generator.choice(sorted(nursery.living))))
                    killed += 1
            while nursery.wanted and nursery.process.poll() is None:
                time.sleep(0.05)
        finally:
            nursery.close()
    folders = sorted(tmp_path.glob("shared*"))
    print(f"{killed} kills, {len(folders)} stores, {len(nursery.wrote)} blocks, {nursery.wrote.total()} written")
    assert killed == kills
    assert (tmp_path / "errors").read_text() == ""
    wanted = rows(tmp_path / "alone")
    for place in folders:
        assert rows(place) == wanted
    assert nursery.wrote.total() <= 1.02 * len(nursery.wrote)


@pytest.mark.slow
def test_200_kills_of_four_at_once_cost_nothing(tmp_path):
    assert_kills_cost_nothing(tmp_path, kills=200, pause=3.0)


def assert_parts_are_the_whole(tmp_path, parts: int, blocks: int, kills: int, pause: float) -> None:
    """Four processes at a time, each a part of a fresh folder; who is killed is started again."""
    generator, folder = np.random.default_rng(1), tmp_path / "shared"
    due, killed = [f"{number}/{parts}" for number in range(1, parts + 1)], 0
    with (tmp_path / "errors").open("w") as errors:
        nursery = Nursery(STAND_IN, SHARE.replace("BLOCKS", str(blocks)), errors)
        try:
            while (due or (killed < kills and nursery.wanted)) and nursery.process.poll() is None:
                while due and nursery.wanted < 4:
                    nursery.start(folder, due.pop(0))
                time.sleep(generator.uniform(0.0, pause))
                if killed < kills and (living := sorted(nursery.living)):
                    part = nursery.kill(int(generator.choice(living)))
                    if part is not None:
                        killed += 1
                        due.append(part)
            while nursery.wanted > 0 and nursery.process.poll() is None:
                time.sleep(0.02)
        finally:
            nursery.close()
    assert (tmp_path / "errors").read_text() == ""
    assert killed == kills
    shared = {block: count for (place, block), count in nursery.wrote.items() if place == str(folder)}
    # Who was killed while it packed a shard has written its last block without a word; that all are there, rows tell.
    assert blocks - kills <= len(shared) <= blocks
    assert sum(shared.values()) <= 1.02 * blocks
    assert rows(folder) == {"value": np.sin(np.arange(4 * blocks)).tobytes(), "status": bytes(4 * blocks)}
    # Who was killed while it wrote leaves a hidden draft.
    assert all(file.name == "dies.zarr" or file.name == "dies.blocks" for file in folder.iterdir())
    assert all(file.name.startswith(".") for file in (folder / "dies.blocks").glob("*"))


def test_parts_that_are_killed_and_started_again_are_the_whole(tmp_path):
    assert_parts_are_the_whole(tmp_path, parts=12, blocks=60, kills=5, pause=0.1)


@pytest.mark.slow
def test_200_parts_with_60_kills_are_the_whole(tmp_path):
    assert_parts_are_the_whole(tmp_path, parts=200, blocks=1000, kills=60, pause=0.05)
