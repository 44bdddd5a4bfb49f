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


# Starts a sweep in a process of its own for each line, the folder, that it reads: Python and its imports are there
# already. What happens is told in lines: "start PROCESS", "wrote FOLDER BLOCK", "end PROCESS FOLDER"
# or "failed PROCESS".
NURSERY = """
import os, signal, sys, traceback
from memsgyro_jax import runtime
runtime.configure(devices=1)
import memsgyro_jax as mg
import xarray, zarr
from memsgyro_jax.montecarlo import sweep
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

folder, write = line.strip(), Store.write
Store.write = told
tell("start", os.getpid())
try:
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    observer = mg.ExtendedKalmanFilter.for_device(gyro, readout, annealing=mg.Annealing())
    loop = mg.ClosedLoop(gyro, readout, observer, mg.DampingCompensation(mg.Tone(600.0, 53.95)))
    lot = mg.sweep(loop, mg.Spread.relative(0.15), dies=DIES, chunk=1, sample_rate=100e3, duration=5e-4, bound_dies=0,
                   out=folder, resume=True)
    assert lot.notes == (), lot.notes
    tell("end", os.getpid(), folder)
except BaseException:
    traceback.print_exc()
    tell("failed", os.getpid())
os._exit(0)
"""


class Nursery:
    """Starts and kills sweeps; knows which live, which blocks they wrote, and which folders are complete."""

    def __init__(self, dies: int, errors):
        script = NURSERY.replace("DIES", str(dies))
        clean = {n: v for n, v in os.environ.items() if not n.startswith(("XLA_FLAGS", "JAX_", "MEMSGYRO_"))}
        self.process = subprocess.Popen(
            [sys.executable, "-c", script], env=clean | {"PYTHONPATH": os.pathsep.join(sys.path)}, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors,
        )  # fmt: skip
        self.living: set[int] = set()
        self.wrote: Counter[tuple[str, str]] = Counter()
        self.complete: set[str] = set()
        self.wanted = 0
        self.reader = threading.Thread(target=self._read)
        self.reader.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            kind, *words = line.split()
            if kind == "start":
                self.living.add(int(words[0]))
            elif kind == "wrote":
                self.wrote[words[0], words[1]] += 1
            else:
                self.living.discard(int(words[0]))
                self.complete |= set(words[1:])
                self.wanted -= 1

    def start(self, folder) -> None:
        self.wanted += 1
        self.process.stdin.write(f"{folder}\n")
        self.process.stdin.flush()

    def kill(self, process: int) -> None:
        self.living.discard(process)
        self.wanted -= 1
        os.kill(process, signal.SIGKILL)

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


def assert_kills_cost_nothing(tmp_path, kills: int, dies: int, pause: float) -> None:
    generator = np.random.default_rng(0)
    with (tmp_path / "errors").open("w") as errors:
        nursery = Nursery(dies, errors)
        try:
            nursery.start(tmp_path / "alone")
            while nursery.wanted and nursery.process.poll() is None:
                time.sleep(0.05)
            killed, folder = 0, None
            while killed < kills and nursery.process.poll() is None:
                if folder is None or str(folder) in nursery.complete:
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
    assert_kills_cost_nothing(tmp_path, kills=200, dies=1600, pause=3.0)
