"""Computes the dies of a sweep, block by block, and says what their store looks like."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base import runtime
from memsgyro_jax.base.display import stated_at
from memsgyro_jax.base.labelled import LABELS, UNITS_ALONG
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
from .batch import DIVERGED, OK, STATUS
from .divergence import impossible
from .layout import PROCESSOR, DieArray, Layout
from .spread import Draw, Root, Spread
from .store import Memory, Store


WINDOWS = 100  # at most about this many window means of the rate are kept per die, however long the run
CHUNKS_PER_BLOCK = 8


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

    def batches(self, block: int, dies: int) -> Iterator[dict[str, np.ndarray]]:
        """The rows of one block, batch by batch, up to the block's end or `dies`.

        A block is drawn and written as one: drawing for every batch took a sixth of the time, writing every chunk a
        third.
        """
        numbers = np.arange(block * self.block, min((block + 1) * self.block, dies))
        drawn = self.spread.draw(self.loop, self.scenario, self.seed, numbers)
        if drawn.loop.filter is not None:
            check_fits(drawn.loop.filter, self.loop.output_rate(1.0 / self.plan.period))
        keyed = jnp.asarray(self.spread.noise(numbers))
        words = jax.tree.map(np.asarray, noise.die_words(jax.random.key(self.seed), keyed))
        chunks, together = -(-len(numbers) // self.chunk), self._together(dies)
        for first in range(0, chunks, together):
            count = min(chunks - first, together)
            # A last batch that does not fill the devices repeats its last chunk: one shape, one compilation.
            batch = [first + min(n, count - 1) for n in range(together)]
            # A chunk that does not fill the lanes repeats its last die.
            inside = np.minimum(np.arange(-(-self.chunk // self.lanes) * self.lanes), self.chunk - 1)
            places = np.concatenate([n * self.chunk + inside for n in batch])
            rows = self._run(drawn, words, np.minimum(places, len(numbers) - 1))
            chosen = np.concatenate([n * len(inside) + np.arange(self.chunk) for n in range(count)])
            yield {name: value[chosen] for name, value in rows.items()}

    def work(self, store: Store | Memory, dies: int, progress: Callable[[int, int], None] | None) -> float | None:
        """Compute the blocks that a store wants; gives steps per second after the first batch."""
        timed, busy = 0, None
        for number in store.unfinished():
            parts, done, began = [], store.done, time.perf_counter()
            for rows in self.batches(number, dies):
                parts.append(rows)
                count = len(rows[STATUS])
                done = min(done + count, store.wanted)
                if progress:
                    progress(done, store.wanted)
                if busy is None:  # the first batch compiles
                    busy, began = 0.0, time.perf_counter()
                else:
                    timed += count
            store.write(number, {name: _joined([part[name] for part in parts]) for name in parts[0]})
            busy = (busy or 0.0) + time.perf_counter() - began
        return timed * self.plan.samples / busy if busy and timed else None

    @property
    def block(self) -> int:
        """Dies in a block."""
        return self.chunk * CHUNKS_PER_BLOCK

    def _together(self, dies: int) -> int:
        """Chunks in a batch: one for each device, in blocks of samples as many as a block of dies has, since a call
        takes as long as some of those.
        """
        if self.loop.blocks is None:
            return self.mesh.size
        chunks = -(-min(dies, self.block) // self.chunk)
        return self.mesh.size * -(-chunks // self.mesh.size)

    def _run(self, drawn: Draw, words: tuple[np.ndarray, ...], places: np.ndarray) -> dict[str, np.ndarray]:
        design = (self.loop, self.scenario)
        loop, scenario = lot.picked((drawn.loop, drawn.scenario), design, places)
        chosen = tuple(word[places] for word in words)
        rows = lot.compiled_for(self.mesh)(loop, scenario, design, chosen, self.plan, self.mesh, self.lanes)
        found = jax.tree.map(np.asarray, rows)
        pair = [found.pop(name) for name in lot.COVARIANCE if name in found]
        found["nees_end"] = lot.nees(*pair) if pair else np.full(len(places), np.nan)
        astray = impossible(found, pair[0] if pair else None, self.plan, self.loop.filter is not None)
        found[STATUS] = np.where(astray & (found[STATUS] == OK), np.int8(DIVERGED), found[STATUS])
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
        units = {"coefficient": units_of(self.loop.device.model), "parameter": [stated_at(root, p) for p in parameters]}
        made_by = {PROCESSOR: f"{self.mesh.devices.flat[0].device_kind} {runtime.processor()}"}
        attributes = {**settings.as_dict(), **made_by, **self.plan._asdict()}
        attributes |= {LABELS: labels, UNITS_ALONG: units}
        return Layout(columns, {"time": ("window", self.plan.window_times, "s")}, attributes)


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
    of them in a window.
    """
    steps = count_steps(sample_rate, duration)
    if loop.blocks is not None:
        stride = loop.blocks.stride(steps, WINDOWS)
        (start, lead), window = loop.blocks.first(steps, stride), loop.blocks.length * stride
        numbers = (start, lead, stride, statistics(loop))
        return lot.Plan(1.0 / sample_rate, (steps - start - lead) // window, window, settle, tolerance, *numbers)
    fits = [n for n in range(1, min(2 * WINDOWS, steps) + 1) if steps % n == 0]
    best = min(fits, key=lambda n: abs(np.log(n / WINDOWS)))
    blocks = best if best >= WINDOWS // 4 or steps < WINDOWS else WINDOWS
    return lot.Plan(1.0 / sample_rate, blocks, steps // blocks, settle, tolerance)
