"""Computes the dies of a sweep, block by block, and says what their store looks like."""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base import runtime
from memsgyro_jax.base.labels import LABELS, UNITS_ALONG
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.device.propagate import fuses_many_outputs
from memsgyro_jax.loop import noise
from memsgyro_jax.loop.blocks.run import statistics
from memsgyro_jax.loop.filters import check_fits
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.scenario import Scenario
from memsgyro_jax.loop.sensitivities import units_of
from memsgyro_jax.loop.trace import count_steps

from . import batch as lot
from .divergence import impossible
from .layout import PROCESSOR, DieArray, Layout
from .spread import Draw, Root, Spread
from .status import DIVERGED, OK, STATUS
from .store import Memory, Store


WINDOWS = 100  # at most about this many window means of the rate are kept per die, however long the run
CHUNKS_PER_BLOCK = 8
STEPS_PER_CALL = 20_000_000  # of one device, sample by sample: some seconds on a core


@dataclass(frozen=True)
class Runner:
    """Computes chunks by number; the same chunk gives the same bits on any device, in any company."""

    loop: ClosedLoop
    scenario: Scenario
    spread: Spread
    plan: lot.Plan
    seed: int
    chunk: int

    @property
    def mesh(self) -> jax.sharding.Mesh:
        """The devices of this process."""
        return lot.mesh_of(jax.local_devices())

    @property
    def lanes(self) -> int:
        """Dies side by side on each of them."""
        return side_by_side(self.mesh.devices.flat[0].platform)

    def work(self, store: Store | Memory, dies: int, progress: Callable[[int, int], None] | None) -> float | None:
        """Compute the blocks that a store wants, while the devices are at one of them drawing the next; gives steps per
        second after the first batch.
        """
        timed, busy, drawn, wanted = 0, None, dict[int, _Drawn](), set(store.missing)
        # A compiled call waits for its end (Equinox looks for errors then), in a thread of its own.
        devices = ThreadPoolExecutor(1)
        if progress and wanted:
            progress(store.done, store.wanted)
        try:
            for number in store.unfinished():
                parts, done, began = [], store.done, time.perf_counter()
                given = drawn.pop(number, None) or self._drawn(number, dies)
                batches = [(devices.submit(self._run, given, p), p, chosen) for p, chosen in self._batches(given, dies)]
                drawn = {number + 1: self._drawn(number + 1, dies)} if number + 1 in wanted else {}
                for found, places, chosen in batches:
                    rows = self._judged(given, places, found.result())
                    parts.append({name: value[chosen] for name, value in rows.items()})
                    done = min(done + len(chosen), store.wanted)
                    if progress:
                        progress(done, store.wanted)
                    if busy is None:  # the first batch compiles
                        busy, began = 0.0, time.perf_counter()
                    else:
                        timed += len(chosen)
                store.write(number, {name: _joined([part[name] for part in parts]) for name in parts[0]})
                busy = (busy or 0.0) + time.perf_counter() - began
        finally:
            devices.shutdown(cancel_futures=True)
        return timed * self.plan.samples / busy if busy and timed else None

    @property
    def block(self) -> int:
        """Dies in a block."""
        return self.chunk * CHUNKS_PER_BLOCK

    def _together(self, dies: int) -> int:
        """Chunks in a batch: all of a block of dies, as what lies between two calls keeps the devices waiting; fewer
        where a call would take long.
        """
        each = -(-min(dies, self.block) // (self.chunk * self.mesh.size))
        steps = 0 if self.loop.blocks is not None else self.plan.samples * self.chunk
        calls = min(each, -(-each * steps // STEPS_PER_CALL) or 1)
        return self.mesh.size * -(-each // calls)

    def _drawn(self, block: int, dies: int) -> "_Drawn":
        """The dies of a block, up to its end or `dies`: drawing for every batch took a sixth of the time."""
        numbers = np.arange(block * self.block, min((block + 1) * self.block, dies))
        drawn = self.spread.draw(self.loop, self.scenario, self.seed, numbers)
        if drawn.loop.filter is not None:
            check_fits(drawn.loop.filter, self.loop.output_rate(1.0 / self.plan.period))
        keyed = jnp.asarray(self.spread.noise(numbers))
        return _Drawn(drawn, jax.tree.map(np.asarray, noise.die_words(jax.random.key(self.seed), keyed)))

    def _batches(self, given: "_Drawn", dies: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """The places of a batch's dies in their block, and which of these are wanted, batch by batch."""
        count = len(given.words[0])
        chunks, together = -(-count // self.chunk), self._together(dies)
        for first in range(0, chunks, together):
            some = min(chunks - first, together)
            # A last batch that does not fill the devices repeats its last chunk: one shape, one compilation.
            batch = [first + min(n, some - 1) for n in range(together)]
            # A chunk that does not fill the lanes repeats its last die.
            inside = np.minimum(np.arange(-(-self.chunk // self.lanes) * self.lanes), self.chunk - 1)
            places = np.concatenate([n * self.chunk + inside for n in batch])
            chosen = np.concatenate([n * len(inside) + np.arange(self.chunk) for n in range(some)])
            yield np.minimum(places, count - 1), chosen

    def _run(self, given: "_Drawn", places: np.ndarray) -> dict[str, np.ndarray]:
        design, drawn = (self.loop, self.scenario), given.draw
        loop, scenario = lot.picked((drawn.loop, drawn.scenario), design, places)
        chosen = tuple(word[places] for word in given.words)
        rows = lot.compiled_for(self.mesh)(loop, scenario, design, chosen, self.plan, self.mesh, self.lanes)
        return jax.tree.map(np.asarray, rows)

    def _judged(self, given: "_Drawn", places: np.ndarray, found: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The rows of a batch that was run."""
        pair = [found.pop(name) for name in lot.COVARIANCE if name in found]
        found["nees_end"] = lot.nees(*pair) if pair else np.full(len(places), np.nan)
        astray = impossible(found, pair[0] if pair else None, self.plan, self.loop.filter is not None)
        found[STATUS] = np.where(astray & (found[STATUS] == OK), np.int8(DIVERGED), found[STATUS])
        drawn = given.draw
        return {**found, "drawn": drawn.table[places], "redrawn": drawn.redrawn[places].astype(float)}

    def layout(self, settings: Settings) -> Layout:
        """The arrays of a lot, and what its Dataset and store say about how they were made."""
        names, windows = self.loop.device.model.names, self.plan.windows
        parameters, root = [v.path for v in self.spread.resolved(self.loop)], Root(self.loop, self.scenario)
        rate, time, one = (DieArray((), (), unit) for unit in ("rad/s", "s", "1"))
        columns = {
            "lost_at": time,
            "rate_error_end": rate,
            "rate_error_rms": rate,
            "rate_series_std": rate,
            "rate_std_end": rate,
            "convergence_time": time,
            "nis_mean": one,
            "nis_channel": DieArray(("channel",), (2,), "1"),
            "nees_end": one,
            "coefficient_true": DieArray(("coefficient",), (len(names),), None),
            "coefficient_error": DieArray(("coefficient",), (len(names),), "1"),
            "rate_estimate": DieArray(("window",), (windows,), "rad/s"),
            "rate_true": DieArray(("window",), (windows,), "rad/s"),
            "drawn": DieArray(("parameter",), (len(parameters),), None),
            "redrawn": one,
        }
        labels = {"coefficient": list(names), "parameter": parameters, "channel": ["x", "y"]}
        units = {"coefficient": units_of(self.loop.device.model), "parameter": [root.unit(p) for p in parameters]}
        made_by = {PROCESSOR: f"{self.mesh.devices.flat[0].device_kind} {runtime.processor()}"}
        attributes = {**settings.as_dict(), **made_by, **self.plan._asdict()}
        attributes |= {LABELS: labels, UNITS_ALONG: units}
        return Layout(columns, {"time": ("window", self.plan.window_times, "s")}, attributes)


class _Drawn(NamedTuple):
    """The dies of a block, and the words that key their noise."""

    draw: Draw
    words: tuple[np.ndarray, ...]


def _joined(parts: list[np.ndarray]) -> np.ndarray:
    """Rows of several batches; what is not a number in one and the same way, for zarr leaves out chunks of it."""
    rows = np.concatenate(parts)
    return np.where(np.isnan(rows), np.nan, rows) if np.issubdtype(rows.dtype, np.floating) else rows


def side_by_side(platform: str) -> int:
    """Dies side by side: in a core's cache on a CPU, many on a GPU; without fused loops each of them must be long."""
    if platform != "cpu":
        return 8192
    return 32 if fuses_many_outputs() else 128


def default_chunk() -> int:
    """Dies per device and batch."""
    return side_by_side(jax.local_devices()[0].platform)


def windows_of(loop: ClosedLoop, sample_rate: float, duration: float, settle: float, tolerance: float) -> lot.Plan:
    """Windows as near to `WINDOWS` as divide the number of samples; a rest is dropped when none does. In blocks as many
    of them in a window, unless the run is too short for one.
    """
    steps = count_steps(sample_rate, duration)
    if loop.blocks is not None:
        stride = loop.blocks.stride(steps, WINDOWS)
        (start, lead), window = loop.blocks.first(steps, stride), loop.blocks.length * stride
        blocks, numbers = (steps - start - lead) // window, (start, lead, stride, statistics(loop))
        if lead or blocks:
            return lot.Plan(1.0 / sample_rate, blocks, window, settle, tolerance, *numbers)
    fits = [n for n in range(1, min(2 * WINDOWS, steps) + 1) if steps % n == 0]
    best = min(fits, key=lambda n: abs(np.log(n / WINDOWS)))
    blocks = best if best >= WINDOWS // 4 or steps < WINDOWS else WINDOWS
    return lot.Plan(1.0 / sample_rate, blocks, steps // blocks, settle, tolerance)
