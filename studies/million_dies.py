"""What does a store of a million dies cost? Its time, files and memory, with random numbers in place of the loop.

The rows have the columns of the default sweep and are random, so that nothing compresses. Four processes share them in
parts. Then the status of a store of a hundred million dies, made of copies of one shard's statuses. At the end, dies of
the default loop in blocks go to a store; a million of them are told by proportion.
"""

import multiprocessing
import resource
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from _common import Report

import memsgyro_jax as mg
from memsgyro_jax.base import runtime
from memsgyro_jax.montecarlo.layout import SHARD
from memsgyro_jax.montecarlo.runner import Runner
from memsgyro_jax.montecarlo.standing import standing_of
from memsgyro_jax.montecarlo.status import STATUS
from memsgyro_jax.montecarlo.store import Memory, Store


PARTS = 16


class StandIn(Runner):
    """Random rows in place of the loop's."""

    def work(self, store: Store | Memory, dies: int, progress: Callable[[int, int], None] | None) -> None:
        for block in store.unfinished():
            generator = np.random.default_rng(block)
            rows = {name: np.full((self.block, *sizes), 0.01) for name, sizes in SIZES.items()}
            for name in ("rate_error_end", "rate_estimate", "coefficient_true", "drawn"):
                rows[name] = generator.standard_normal(rows[name].shape)
            sound = {"lost_at": np.full(self.block, np.nan), STATUS: np.zeros(self.block, np.int8)}
            store.write(block, rows | sound)


SIZES: dict[str, tuple[int, ...]] = {}


def planned(out: Path, dies: int) -> mg.StoredSweep:
    """The default study's store, with a stand-in for its loop."""
    store = mg.plan(**{**mg.default_study().sweep_arguments, "dies": dies, "bound_dies": 0}, out=out)
    made, runner = store.computation, store.computation.runner
    SIZES.update({name: column.sizes for name, column in made.layout.columns.items()})
    stand_in = StandIn(runner.loop, runner.scenario, runner.spread, runner.plan, runner.seed, runner.chunk)
    return replace(store, computation=replace(made, runner=stand_in))


def every(processes: int, out: Path, dies: int, first: int) -> float:
    """Runs every part that is its own of so many processes; peak memory in MB."""
    runtime.configure()
    store = planned(out, dies)
    for number in range(first, PARTS + 1, processes):
        mg.run_part(store, (number, PARTS))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def files_below(folder: Path) -> int:
    return sum(path.is_file() for path in folder.rglob("*"))


def copies_of_a_status(store: Path, dies: int) -> None:
    """Make the store at a path one of `dies` dies by copies of its first shard of statuses; its columns stay behind."""
    metadata = store / STATUS / "zarr.json"
    held = standing_of(store.parent).dies
    metadata.write_text(metadata.read_text().replace(str(held), str(dies), 1))
    for number in range(1, -(-dies // SHARD)):
        shutil.copy(store / STATUS / "c" / "0", store / STATUS / "c" / str(number))


def main() -> None:
    report = Report()
    runtime.configure()
    dies, many, real, count = (32768, 10**6, 0, 2) if report.quick else (10**6, 10**8, 10**4, 4)
    with tempfile.TemporaryDirectory() as folder:
        out, began = Path(folder) / "lot", time.perf_counter()
        with multiprocessing.get_context("spawn").Pool(count) as pool:
            memory = pool.starmap(every, [(count, out, dies, first) for first in range(1, count + 1)])
        report.row(f"{dies} dies by {count} processes", "", f"{time.perf_counter() - began:.0f} s", "imports included")
        report.row("memory of a process", "<= 1 GB", f"{max(memory):.0f} MB")
        report.row("files", "<= 2000", files_below(out))
        store, began = planned(out, dies), time.perf_counter()
        summary = mg.summarise(store)
        took = time.perf_counter() - began
        report.row("summary", "", f"{took:.1f} s", f"{1e6 * took / dies:.0f} µs per die; {summary.dies} dies")
        copies_of_a_status(store.path, many)
        began = time.perf_counter()
        standing, what = standing_of(out), f"status of {many} dies"
        report.row(what, "< 60 s", f"{time.perf_counter() - began:.1f} s", f"{standing.done} done")
    if real:
        study = mg.default_study()
        loop = study.sweep_arguments["loop"].in_blocks()
        with tempfile.TemporaryDirectory() as folder:
            arguments = {**study.sweep_arguments, "loop": loop, "bound_dies": 0}
            mg.sweep(**{**arguments, "dies": 256})  # compiles
            for where, kept in (("in memory", None), ("with a store", Path(folder) / "lot")):
                began = time.perf_counter()
                mg.sweep(**{**arguments, "dies": real}, out=kept)
                took = time.perf_counter() - began
                by_proportion = f"a million would take {1e6 * took / real / 60.0:.0f} min"
                report.row(f"{real} dies of the loop in blocks, {where}", "", f"{took:.1f} s", by_proportion)
    report.finish()


if __name__ == "__main__":
    main()
