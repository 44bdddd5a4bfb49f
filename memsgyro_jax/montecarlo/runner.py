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
CHUNKS_PER_BLOCK, MORE_IN_BLOCKS = 8, 4
STEPS_PER_CALL = 20_000_000  # of one device, sample by sample: some seconds on a core
SAMPLES_PER_BLOCK = 200_000_000  # of a larger block of dies: as many seconds


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
        """Compute the blocks that a store wants, while the devices are at one of them judging and writing the last and
        drawing the next; gives steps per second after the first call.
        """
        drawn, wanted, last, pace = dict[int, _Drawn](), set(store.missing), None, _Pace()
        told = (lambda done: progress(min(done, store.wanted), store.wanted)) if progress else lambda done: None
        if wanted:
            told(store.done)
        # A compiled call waits for its end (Equinox looks for errors then), in a thread of its own.
        devices = ThreadPoolExecutor(1)
        try:
            for number in store.unfinished():
                pace.start()
                given = None if number is None else drawn.pop(number, None) or self._drawn(number, dies)
                calls = [(call, devices.submit(self._run, given, call)) for call in self._calls(given)] if given else []
                if last:
                    store.write(last[0], self._rows(*last[1:]))
                    told(store.done)
                found, done = [], store.done
                if number is not None and number + 1 in wanted:
                    drawn = {number + 1: self._drawn(number + 1, dies)}
                for call, running in calls:
                    found.append((call, running.result()))
                    pace.count(len(call.chosen))
                    done += len(call.chosen)
                    if len(found) < len(calls):
                        told(done)
                last = None if number is None else (number, given, found)
                pace.stop()
        finally:
            devices.shutdown(cancel_futures=True)
        return pace.dies_per_second and pace.dies_per_second * self.plan.samples

    @property
    def block(self) -> int:
        """Dies in a block: more of them where a call takes so short that what lies between two counts."""
        few = self.chunk * CHUNKS_PER_BLOCK
        short = self.loop.blocks is not None and MORE_IN_BLOCKS * few * self.plan.samples <= SAMPLES_PER_BLOCK
        return MORE_IN_BLOCKS * few if short else few

    @property
    def _together(self) -> int:
        """Chunks of each device in a call: its share of a block, as what lies between two calls keeps the devices
        waiting; fewer where a call would take long.
        """
        each = -(-self.block // (self.chunk * self.mesh.size))
        steps = 0 if self.loop.blocks is not None else self.plan.samples * self.chunk
        return -(-each // min(each, -(-each * steps // STEPS_PER_CALL) or 1))

    def _drawn(self, block: int, dies: int) -> "_Drawn":
        """The dies of a block, up to its end or `dies`: drawing for every batch took a sixth of the time."""
        numbers = np.arange(block * self.block, min((block + 1) * self.block, dies))
        drawn = self.spread.draw(self.loop, self.scenario, self.seed, numbers)
        if drawn.loop.filter is not None:
            check_fits(drawn.loop.filter, self.loop.output_rate(1.0 / self.plan.period))
        keyed = jnp.asarray(self.spread.noise(numbers))
        return _Drawn(drawn, jax.tree.map(np.asarray, noise.die_words(jax.random.key(self.seed), keyed)))

    def _calls(self, given: "_Drawn") -> Iterator["_Call"]:
        """The dies of a block, call by call; the devices take turns at its chunks."""
        count, size, most = len(given.words[0]), self.mesh.size, self._together
        # A chunk that does not fill the lanes repeats its last die.
        inside = np.minimum(np.arange(-(-self.chunk // self.lanes) * self.lanes), self.chunk - 1)
        chunks = -(-count // self.chunk)
        for first in range(0, chunks, most * size):
            some = min(chunks - first, most * size)
            turns = -(-some // size)
            numbers = np.minimum(np.arange(most)[None] * size + np.arange(size)[:, None], some - 1).ravel()
            places = ((first + numbers)[:, None] * self.chunk + inside).ravel()
            where = np.arange(some) % size * most + np.arange(some) // size
            chosen = (where[:, None] * len(inside) + np.arange(self.chunk)).ravel()
            chosen = chosen[: count - first * self.chunk]
            yield _Call(np.minimum(places, count - 1), chosen, turns * (len(inside) // self.lanes))

    def _run(self, given: "_Drawn", call: "_Call") -> dict[str, np.ndarray]:
        design, drawn = (self.loop, self.scenario), given.draw
        loop, scenario = lot.picked((drawn.loop, drawn.scenario), design, call.places)
        words = tuple(word[call.places] for word in given.words)
        run = lot.compiled_for(self.mesh)
        rows = run(loop, scenario, design, words, self.plan, self.mesh, self.lanes, np.asarray(call.groups))
        return jax.tree.map(np.asarray, rows)

    def _rows(self, given: "_Drawn", found: list[tuple["_Call", dict[str, np.ndarray]]]) -> dict[str, np.ndarray]:
        """Of the dies of a block, whose calls have ended."""
        parts = []
        for call, rows in found:
            wanted = {name: value[call.chosen] for name, value in rows.items()}
            parts.append(self._judged(given, call.places[call.chosen], wanted))
        return {name: _joined([part[name] for part in parts]) for name in parts[0]}

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


class _Call(NamedTuple):
    """Dies that run in one call: the `places` in their block of all that lie side by side, which of these are `chosen`
    in order, and how many `groups` of lanes each device runs.
    """

    places: np.ndarray
    chosen: np.ndarray
    groups: int


class _Pace:
    """How fast dies are computed once the first call, which compiles, has ended; what others are waited for apart."""

    def __init__(self) -> None:
        self._spent, self._began, self._compiling, self._dies = 0.0, 0.0, 0.0, 0

    def start(self) -> None:
        self._began = time.perf_counter()

    def stop(self) -> None:
        self._spent += time.perf_counter() - self._began

    def count(self, dies: int) -> None:
        """So many dies have come; the first of all are not timed."""
        if self._compiling:
            self._dies += dies
        else:
            self._compiling = self._spent + time.perf_counter() - self._began

    @property
    def dies_per_second(self) -> float | None:
        return self._dies / (self._spent - self._compiling) if self._dies else None


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
