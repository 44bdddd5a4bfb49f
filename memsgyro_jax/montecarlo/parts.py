"""A sweep in parts: planned once, run by as many processes as there are, summarised when asked."""

import re
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from memsgyro_jax.base import runtime
from memsgyro_jax.base.arguments import quantity, refuse_traced, whole
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.farm import farmed, require_scheduler
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.loop.blocks.run import prepared
from memsgyro_jax.loop.expectation import tell
from memsgyro_jax.loop.loop import ClosedLoop, as_loop
from memsgyro_jax.loop.observers.base import check_claims
from memsgyro_jax.loop.operation import run_of
from memsgyro_jax.loop.port_shapes import check_ports
from memsgyro_jax.loop.scenario import AbstractProfile, Scenario, as_scenario
from memsgyro_jax.loop.settling import not_at_rest
from memsgyro_jax.loop.trace import count_steps
from memsgyro_jax.loop.unreached import unreached
from memsgyro_jax.loop.unsuited import unsuited

from .batch import Plan
from .bounds import compiled_beside, own_bounds, why_unbounded
from .caveats import Order
from .divergence import divergence_of, unexpected
from .folder import RemotePath, place_of
from .layout import Layout
from .runner import Runner, default_chunk, windows_of
from .spread import DEVICE_PREFIX, Spread, as_spread
from .store import opened
from .stored import StoredRows
from .summary import Summary, figures_of
from .tally import Tally


_CHIMES = re.compile(r"tones.*frequency$")  # paths of tones that may cease to share a frequency
DEFAULT_TOLERANCE = float(np.radians(20.0))


@dataclass(frozen=True)
class Computation:
    """What a sweep computes: how, of how many dies, and what should be known before (`notes`)."""

    runner: Runner
    settings: Settings
    dies: int
    bound_dies: int
    notes: tuple[str, ...]

    @property
    def layout(self) -> Layout:
        """Of its columns."""
        return self.runner.layout(self.settings)

    @property
    def plan(self) -> Plan:
        """Of its runs."""
        return self.runner.plan

    def summary(
        self, groups: Iterable[tuple[int, dict[str, np.ndarray]]], amiss: list[str], speed: float | None
    ) -> Summary:
        """Of columns that come part by part, with the first die of each; `amiss` is what is told of them by then."""
        runner, settings, bounded = self.runner, self.settings, min(self.dies, self.bound_dies)
        tally = Tally(self.plan, bounded, Order.of(runner.loop))
        for first, rows in groups:
            tally.add(rows, first)
        if tally.computed < self.dies:
            amiss = [f"{tally.computed} of {self.dies} dies are there: figures are of those alone", *amiss]
        bounds = own_bounds(*self._of_bounds)
        divergence = divergence_of(*tally.diverged, runner.loop, runner.scenario, self.plan, self._drawn)
        why = why_unbounded(runner.loop, runner.scenario, settings.duration) if bounded and bounds is None else None
        return figures_of(tally, settings, runner.loop, bounds, why, divergence, self.notes, tuple(amiss), speed)

    def compiling_bounds(self) -> AbstractContextManager[None]:
        """Inside it the program of the dies' bounds is compiled beside all else, which a summary then finds."""
        return compiled_beside(*self._of_bounds)

    @property
    def _of_bounds(self) -> tuple[ClosedLoop, Scenario, Spread, int, int, float, float]:
        runner, settings, bounded = self.runner, self.settings, min(self.dies, self.bound_dies)
        run = settings.sample_rate, settings.duration
        return runner.loop, runner.scenario, runner.spread, runner.seed, bounded, *run

    def _drawn(self, dies: np.ndarray) -> tuple[ClosedLoop, Scenario]:
        """Dies by their numbers, which trail."""
        drawn = self.runner.spread.draw(self.runner.loop, self.runner.scenario, self.runner.seed, dies)
        return drawn.loop, drawn.scenario


@dataclass(frozen=True)
class StoredSweep(Shown):
    """A sweep whose dies go to the store at `path`, `out/dies.zarr`. It may be sent to other processes."""

    path: Path | RemotePath
    computation: Computation

    @property
    def dies(self) -> int:
        """How many are wanted."""
        return self.computation.dies

    @property
    def blocks(self) -> int:
        """How many there are to share: one is computed, written and, if it is lost, repeated as a whole."""
        return self.rows.blocks

    @property
    def rows(self) -> StoredRows:
        """The dies that are there."""
        return StoredRows(self.path, self.computation.layout, self.dies, self.computation.runner.block)

    def __repr__(self) -> str:
        made_of = self.computation.settings.fingerprint
        return f"{self.path}: {self.dies} dies in {self.blocks} blocks, fingerprint {made_of}"


@dataclass(frozen=True)
class PartRun(Shown):
    """What `run_part` did: of the `dies` of its share it computed `computed`, the others were there. `notes` says what
    was amiss with the store, `steps_per_s` how fast it went, None where a single batch left nothing to time.
    """

    dies: int
    computed: int
    notes: tuple[str, ...]
    steps_per_s: float | None

    def __repr__(self) -> str:
        said = f"{self.computed} of {self.dies} dies computed"
        if not self.dies:
            said = "no dies in this part: parts take whole blocks of dies, of which there are fewer than parts"
        elif self.computed < self.dies:
            said += ", the others were there"
        return "\n".join([said, *self.notes])


def plan(
    loop: ClosedLoop,
    spread: Spread,
    scenario: Scenario | AbstractProfile | float = 1.0,
    *,
    out: str | Path,
    dies: int = 256,
    sample_rate: float | str | None = None,
    duration: float | str | None = None,
    settle: float | str | None = None,
    tolerance: float | str = DEFAULT_TOLERANCE,
    seed: int = 0,
    chunk: int | None = None,
    bound_dies: int = 256,
) -> StoredSweep:
    """The store of a sweep in the folder `out`, created at once or not at all, or joined where it is there already.

    Arguments and errors are those of `sweep`; `out` may also be an address of fsspec (`s3://bucket/lot`), where nothing
    can be leased: two processes with the same share compute it twice, to the same bits. Any number of processes may
    plan the same sweep; what one of them gives to `run_part` or `summarise` is good for any.
    """
    computation = computation_of(
        loop, spread, scenario, dies=dies, sample_rate=sample_rate, duration=duration, settle=settle,
        tolerance=tolerance, seed=seed, chunk=chunk, bound_dies=bound_dies,
    )  # fmt: skip
    made = StoredSweep(place_of(out) / "dies.zarr", computation)
    with opened(made.path, computation.layout, made.dies, computation.runner.block, True, range(0)):
        return made


def run_part(
    store: StoredSweep, part: tuple[int, int] = (1, 1), *, progress: Callable[[int, int], None] | None = None
) -> PartRun:
    """Compute part k of n, counted from one: of its share of the blocks those that are not there or not sound.

    A share is its own: a part computes no other's blocks, so that its time is known before. Blocks that another process
    works on are waited for, and taken over if that dies: at the end the share is done, and running a part again is
    going on with it. `progress(done, dies)` is called at first and after each batch.

    Raises `InputError` for a part that is none, and for what `sweep` refuses of a store.
    """
    blocks, (number, count) = store.blocks, part
    if not 1 <= number <= count:
        raise InputError(f"Argument `part` must be (k, n) with 1 <= k <= n, but is ({number}, {count}).")
    share = range((number - 1) * blocks // count, number * blocks // count)
    return run_share(store, share, True, progress)


def run_share(
    store: StoredSweep, share: range | None, resume: bool, progress: Callable[[int, int], None] | None,
    summarised: bool = False,
) -> PartRun:  # fmt: skip
    """Compute what these blocks, or all, want; without `resume` in a store that nobody has begun. What is to be
    `summarised` after it will need bounds.
    """
    made = store.computation
    with opened(store.path, made.layout, made.dies, made.runner.block, resume, share) as work:
        before = work.done
        with made.compiling_bounds() if summarised else nullcontext():
            speed = made.runner.work(work, made.dies, progress)
        return PartRun(work.wanted, work.done - before, tuple(work.notes), speed)


def run_on_dask(
    store: StoredSweep, scheduler: str, resume: bool, progress: Callable[[int, int], None] | None
) -> PartRun:
    """Let the workers of a Dask scheduler compute what is missing, a block a task."""
    require_scheduler(scheduler)  # before there is a store, in whose way the right address would find it
    made, blocks = store.computation, store.blocks
    with opened(store.path, made.layout, made.dies, made.runner.block, resume) as work:
        before, notes, missing = work.done, tuple(work.notes), work.missing
    done = before
    if progress and missing:
        progress(done, store.dies)
    for _, ran in farmed(partial(_block, store), missing, scheduler):
        done += ran
        if progress:
            progress(done, store.dies)
    # Blocks that others were at when they were looked for, and shards that nobody has put together.
    rest = run_share(store, range(blocks), True, None)
    return PartRun(rest.dies, done - before + rest.computed, (*notes, *rest.notes), None)


def _block(store: StoredSweep, number: int) -> int:
    return run_share(store, range(number, number + 1), True, None).computed


def summarise(store: StoredSweep, speed: float | None = None) -> Summary:
    """The figures of the dies that are there, read shard by shard and verified; damaged ones count as not computed,
    which `notes` tells.

    Counts, yield and root mean squares are exact, medians and percentiles too up to 65 536 dies; beyond they lie within
    1 part in 8192 (`sketch.Sketch`). `speed` in steps per second is passed on.
    """
    amiss: list[str] = []
    return store.computation.summary(store.rows.groups(amiss), amiss, speed)


def computation_of(
    loop: ClosedLoop,
    spread: Spread,
    scenario: Scenario | AbstractProfile | float,
    *,
    dies: int,
    sample_rate: float | str | None,
    duration: float | str | None,
    settle: float | str | None,
    tolerance: float | str,
    seed: int,
    chunk: int | None,
    bound_dies: int,
) -> Computation:
    """What `sweep` was asked for. Raises `InputError` for settings that cannot be run, for an observer whose covariance
    is of another shape than its states, and outside float64.
    """
    runtime.require_float64("sweep")
    plain = "plain numbers, or map `simulate` over a lot that `Spread.draw` has drawn"
    refuse_traced("A sweep keeps a table of its dies and", plain, loop, spread, scenario)
    loop, spread, seed = as_loop(loop), as_spread(spread), whole("seed", seed)
    dies, bound_dies = whole("dies", dies, 1), whole("bound_dies", bound_dies)
    sample_rate, duration = run_of(loop, sample_rate, duration)
    settle = 0.5 * duration if settle is None else quantity("settle", settle, "s")
    tolerance, chunk = quantity("tolerance", tolerance, "rad/s"), chunk and whole("chunk", chunk, 1)
    scenario, loop = as_scenario(scenario), loop.sampled_at(sample_rate, duration=duration)
    check_ports(loop, scenario, 1.0 / sample_rate)
    check_claims(loop.observer)
    paths = [item.path for item in spread.resolved(loop)]
    if not any(path.startswith(f"{DEVICE_PREFIX}effects.") for path in paths):
        loop = loop.present
    count_steps(sample_rate, duration)
    _check(settle, duration, tolerance, chunk)
    loop, hindered = prepared(loop, apart=parts_tones(paths))
    windows = windows_of(loop, sample_rate, duration, settle, tolerance)
    late = () if any(path.endswith(".at") for path in paths) else unreached(scenario, duration)  # dies have their own
    told = (*hindered, *unsuited(loop), *not_at_rest(loop, settle, duration), *late)
    tell(notes := (*unexpected(loop, scenario, spread, seed, dies, sample_rate, duration), *told))
    settings = Settings.of(loop, scenario, spread, windows, sample_rate=sample_rate, duration=duration, seed=seed)
    runner = Runner(loop, scenario, spread, windows, seed, chunk or default_chunk())
    return Computation(runner, settings, dies, bound_dies, notes)


def parts_tones(paths: Iterable[str]) -> bool:
    """Whether tones may cease to share a frequency where numbers at these paths move."""
    return any(_CHIMES.search(path) for path in paths)


def _check(settle: float, duration: float, tolerance: float, chunk: int | None) -> None:
    if not 0.0 <= settle < duration:
        raise InputError(
            f"Argument `settle` must lie within the duration of {duration:g} s, but {settle:g} s was given."
        )
    if not tolerance > 0.0:
        raise InputError(f"Argument `tolerance` must be positive, but {tolerance:g} rad/s was given.")
    if chunk is not None and chunk < 1:
        raise InputError(f"Argument `chunk` must be at least 1, but {chunk} was given.")
