"""Monte Carlo over fabricated dies: draw, run in chunks, store, resume, summarise."""

import re
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

from memsgyro_jax.base import runtime
from memsgyro_jax.base.arguments import quantity, whole
from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.device.propagate import fuses_many_outputs
from memsgyro_jax.loop import noise
from memsgyro_jax.loop.blocks.run import prepared, statistics
from memsgyro_jax.loop.expectation import tell
from memsgyro_jax.loop.filters import check_fits
from memsgyro_jax.loop.loop import ClosedLoop, as_loop
from memsgyro_jax.loop.scenario import AbstractProfile, Scenario, as_scenario
from memsgyro_jax.loop.trace import count_steps

from . import batch as lot
from .batch import DIVERGED, OK, STATUS
from .bounds import own_bounds
from .divergence import divergence_of, impossible, unexpected
from .layout import LABELS, PROCESSOR, DieArray, Layout
from .spread import DEVICE_PREFIX, Draw, Spread
from .store import Store, opened
from .summary import Summary, summarise


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

WINDOWS = 100  # at most about this many window means of the rate are kept per die, however long the run
CHUNKS_PER_BLOCK = 8
_CHIMES = re.compile(r"tones.*frequency$")  # paths of tones that may cease to share a frequency
DEFAULT_TOLERANCE = float(np.radians(20.0))


@dataclass(frozen=True)
class Lot(Shown):
    """The dies of a sweep: `data` as a Dataset over (die, window, coefficient, parameter), SI units throughout.

    `notes` says what was amiss with the store it went on with, one sentence each.
    """

    settings: Settings
    summary: Summary
    _rows: dict[str, np.ndarray]
    _layout: Layout
    notes: tuple[str, ...] = ()

    @cached_property
    def data(self) -> "xr.Dataset":
        """The Dataset, made when first asked for: xarray takes half a second to import."""
        return self._layout.dataset(self._rows)

    def __repr__(self) -> str:
        return "\n".join([repr(self.summary), *(f"  note: {note}" for note in self.notes)])

    def to_xarray(self) -> "xr.Dataset":
        """The Dataset."""
        return self.data

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Histogram of the rate error at the end, with the information bound."""
        ax, error = axes(ax), np.degrees(self.data["rate_error_end"].values)
        error = error[np.isfinite(error)]
        bins, label = max(10, round(np.sqrt(error.size))), f"{error.size} dies"
        ax.hist(error, bins=bins, density=True, color="C0", alpha=0.6, label=label)
        if self.summary.bound is not None:
            bound = np.degrees(self.summary.bound)
            at = np.linspace(*ax.get_xlim(), 300)
            ax.plot(at, stats.norm.pdf(at, 0.0, bound), color="k", lw=1.2, label=f"information bound {bound:.3g} deg/s")
        ax.set_xlabel("rate error at the end [deg/s]")
        ax.set_ylabel("density [s/deg]")
        ax.legend(loc="best", frameon=False)
        return ax


def sweep(
    loop: ClosedLoop,
    spread: Spread,
    scenario: Scenario | AbstractProfile | float = 1.0,
    *,
    dies: int = 256,
    sample_rate: float | str = 100e3,
    duration: float | str = 0.1,
    settle: float | str | None = None,
    tolerance: float | str = DEFAULT_TOLERANCE,
    seed: int = 0,
    chunk: int | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    bound_dies: int = 256,
    progress: Callable[[int, int], None] | None = None,
) -> Lot:
    """Run `dies` dies drawn from `spread` around `loop` and gather their figures of merit.

    `scenario` as in `simulate`. Statistics over time start at `settle` [s] (default: half the duration); a die has
    converged when its rate error stays within `tolerance` [rad/s], and yields when it ends there. Die i depends on
    (`seed`, i) only: not a bit of it changes with `dies`, `chunk` (dies per device and batch), the number of CPU
    devices or a resume. With `out`, a folder, the rows go to `out/dies.zarr` as they are computed; `resume=True` goes
    on with a store of the same configuration and computes again what is damaged in it. Several processes, of several
    machines too, may work on one store at a time: they share its blocks. `progress(done, dies)` is called after each
    batch. The information bound is computed for each of the first `bound_dies` dies (0: not at all), which costs about
    as much as running them; the summary compares each die's error with its own bound.

    Errors, convergence and window means are those of the loop's output, behind its filter where it has one; claimed
    standard deviation, NIS and NEES those of the observer's estimate before the filter, which alone they speak of. The
    bound holds for any use of the same data and prior, with a filter or without. A die whose errors or innovations are
    impossible under what its filter claims (`divergence.LEVEL`) is *diverged*: counted, explained, and part of all
    figures but those that say so. What the filter cannot expect of the run is logged before it begins.

    Raises `InputError` for settings that cannot be run, a store of something else, and outside float64.
    """
    runtime.require_float64("sweep")
    loop, seed = as_loop(loop), whole("seed", seed)
    dies, bound_dies = whole("dies", dies, 1), whole("bound_dies", bound_dies)
    sample_rate, duration = quantity("sample_rate", sample_rate, "Hz"), quantity("duration", duration, "s")
    settle = 0.5 * duration if settle is None else quantity("settle", settle, "s")
    tolerance, chunk = quantity("tolerance", tolerance, "rad/s"), chunk and whole("chunk", chunk, 1)
    scenario, loop = as_scenario(scenario), loop.sampled_at(sample_rate, duration=duration)
    if not any(item.path.startswith(f"{DEVICE_PREFIX}effects.") for item in spread.resolved(loop)):
        loop = loop.present
    count_steps(sample_rate, duration)
    _check(settle, duration, tolerance, chunk)
    loop, hindered = prepared(loop, apart=any(_CHIMES.search(item.path) for item in spread.resolved(loop)))
    plan = _plan(loop, sample_rate, duration, settle, tolerance)
    tell(notes := (*unexpected(loop, scenario, spread, seed, dies, sample_rate, duration), *hindered))
    settings = Settings.of(loop, scenario, spread, plan, sample_rate=sample_rate, duration=duration, seed=seed)
    devices = jax.local_devices()
    lanes = _lanes(devices[0].platform)
    runner = _Runner(loop, scenario, spread, plan, seed, chunk or lanes, lot.mesh_of(devices), lanes)
    layout = runner.layout(settings)
    place = nullcontext() if out is None else opened(Path(out) / "dies.zarr", layout, dies, runner.block, resume)
    with place as store:
        rows, speed = _run_all(runner, store, dies, progress)
        told = tuple(store.notes) if store else ()
    bounds = own_bounds(loop, scenario, spread, seed, min(dies, bound_dies), sample_rate, duration)
    divergence = divergence_of(rows, loop, scenario, plan)
    return Lot(settings, summarise(rows, plan, settings, loop, bounds, divergence, notes, speed), rows, layout, told)


@dataclass(frozen=True)
class _Runner:
    """Computes chunks by number; the same chunk gives the same bits on any device, in any company."""

    loop: ClosedLoop
    scenario: Scenario
    spread: Spread
    plan: lot.Plan
    seed: int
    chunk: int
    mesh: jax.sharding.Mesh
    lanes: int

    def batches(self, block: int, dies: int) -> Iterator[dict[str, np.ndarray]]:
        """The rows of one block, batch by batch: a chunk for each device at a time, up to the block's end or `dies`.

        A block is drawn and written as one: drawing for every batch took a sixth of the time, writing every chunk a
        third.
        """
        numbers = np.arange(block * self.block, min((block + 1) * self.block, dies))
        drawn = self.spread.draw(self.loop, self.scenario, self.seed, numbers)
        if drawn.loop.filter is not None:
            check_fits(drawn.loop.filter, self.loop.output_rate(1.0 / self.plan.period))
        keyed = jnp.asarray(self.spread.noise(numbers))
        words = jax.tree.map(np.asarray, noise.die_words(jax.random.key(self.seed), keyed))
        chunks = -(-len(numbers) // self.chunk)
        for first in range(0, chunks, self.mesh.size):
            count = min(chunks - first, self.mesh.size)
            # A last batch that does not fill the devices repeats its last chunk: one shape, one compilation.
            batch = [first + min(n, count - 1) for n in range(self.mesh.size)]
            # A chunk that does not fill the lanes repeats its last die.
            inside = np.minimum(np.arange(-(-self.chunk // self.lanes) * self.lanes), self.chunk - 1)
            places = np.concatenate([n * self.chunk + inside for n in batch])
            rows = self._run(drawn, words, np.minimum(places, len(numbers) - 1))
            chosen = np.concatenate([n * len(inside) + np.arange(self.chunk) for n in range(count)])
            yield {name: value[chosen] for name, value in rows.items()}

    @property
    def block(self) -> int:
        """Dies in a block."""
        return self.chunk * CHUNKS_PER_BLOCK

    def _run(self, drawn: Draw, words: tuple[np.ndarray, ...], places: np.ndarray) -> dict[str, np.ndarray]:
        design = (self.loop, self.scenario)
        loop, scenario = lot.picked((drawn.loop, drawn.scenario), design, places)
        chosen = tuple(word[places] for word in words)
        rows = lot.run_batch(loop, scenario, design, chosen, self.plan, self.mesh, self.lanes)
        found = jax.tree.map(np.asarray, rows)
        pair = [found.pop(name) for name in lot.COVARIANCE if name in found]
        found["nees_end"] = lot.nees(*pair) if pair else np.full(len(places), np.nan)
        astray = impossible(found, pair[0] if pair else None, self.plan, self.loop.filter is not None)
        found[STATUS] = np.where(astray & (found[STATUS] == OK), np.int8(DIVERGED), found[STATUS])
        return {**found, "drawn": drawn.table[places], "redrawn": drawn.redrawn[places].astype(float)}

    def layout(self, settings: Settings) -> Layout:
        """The arrays of a lot, and what its Dataset and store say about how they were made."""
        names, windows = self.loop.device.model.names, self.plan.windows
        parameters = [item.path for item in self.spread.resolved(self.loop)]
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
            "coefficient_true": DieArray(("coefficient",), (len(names),), "SI"),
            "coefficient_error": DieArray(("coefficient",), (len(names),), "1"),
            "rate_estimate": DieArray(("window",), (windows,), "rad/s"),
            "rate_true": DieArray(("window",), (windows,), "rad/s"),
            "drawn": DieArray(("parameter",), (len(parameters),), "SI"),
            "redrawn": one,
        }
        labels = {"coefficient": list(names), "parameter": parameters, "channel": ["x", "y"]}
        made_by = {PROCESSOR: f"{self.mesh.devices.flat[0].device_kind} {runtime.processor()}"}
        attributes = {**settings.as_dict(), **made_by, **self.plan._asdict(), LABELS: labels}
        return Layout(columns, {"time": ("window", self.plan.window_times, "s")}, attributes)


def _run_all(
    runner: _Runner, store: Store | None, dies: int, progress: Callable[[int, int], None] | None
) -> tuple[dict[str, np.ndarray], float | None]:
    """The rows of all dies, computed or found in the store, and steps per second after the first batch."""
    kept: list[dict[str, np.ndarray]] = []
    done, timed, busy = 0, 0, None
    for number in store.unfinished() if store else range(-(-dies // runner.block)):
        parts, done, began = [], store.done if store else done, time.perf_counter()
        for rows in runner.batches(number, dies):
            parts.append(rows)
            count = len(rows[STATUS])
            done = min(done + count, dies)
            if progress:
                progress(done, dies)
            if busy is None:  # the first batch compiles
                busy, began = 0.0, time.perf_counter()
            else:
                timed += count
        whole = {name: _joined([part[name] for part in parts]) for name in parts[0]}
        if store:
            store.write(number, whole)
        else:
            kept.append(whole)
        busy = (busy or 0.0) + time.perf_counter() - began
    speed = timed * runner.plan.samples / busy if busy and timed else None
    found = store.rows if store else {name: np.concatenate([part[name] for part in kept])[:dies] for name in kept[0]}
    return found, speed


def _joined(parts: list[np.ndarray]) -> np.ndarray:
    """Rows of several batches; what is not a number in one and the same way, for zarr leaves out chunks of it."""
    rows = np.concatenate(parts)
    return np.where(np.isnan(rows), np.nan, rows) if np.issubdtype(rows.dtype, np.floating) else rows


def _lanes(platform: str) -> int:
    """Dies side by side: in a core's cache on a CPU, many on a GPU; without fused loops each of them must be long."""
    if platform != "cpu":
        return 8192
    return 32 if fuses_many_outputs() else 128


def _plan(loop: ClosedLoop, sample_rate: float, duration: float, settle: float, tolerance: float) -> lot.Plan:
    """Windows as near to `WINDOWS` as divide the number of samples; a rest is dropped when none does. In blocks as many
    of them in a window.
    """
    steps = count_steps(sample_rate, duration)
    if loop.blocks is not None:
        stride = loop.blocks.stride(steps, WINDOWS)
        start, window = loop.blocks.first(steps, stride), loop.blocks.length * stride
        count = statistics(loop)
        return lot.Plan(1.0 / sample_rate, (steps - start) // window, window, settle, tolerance, start, stride, count)
    fits = [n for n in range(1, min(2 * WINDOWS, steps) + 1) if steps % n == 0]
    best = min(fits, key=lambda n: abs(np.log(n / WINDOWS)))
    blocks = best if best >= WINDOWS // 4 or steps < WINDOWS else WINDOWS
    return lot.Plan(1.0 / sample_rate, blocks, steps // blocks, settle, tolerance)


def _check(settle: float, duration: float, tolerance: float, chunk: int | None) -> None:
    if not 0.0 <= settle < duration:
        raise InputError(
            f"Argument `settle` must lie within the duration of {duration:g} s, but {settle:g} s was given."
        )
    if not tolerance > 0.0:
        raise InputError(f"Argument `tolerance` must be positive, but {tolerance:g} rad/s was given.")
    if chunk is not None and chunk < 1:
        raise InputError(f"Argument `chunk` must be at least 1, but {chunk} was given.")
