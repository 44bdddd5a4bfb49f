"""Monte Carlo over fabricated dies: plan, run, summarise in one call."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from scipy import stats

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import write_json
from memsgyro_jax.base.labelled import MARK, Tabular
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.scenario import AbstractProfile, Scenario

from .folder import place_of
from .layout import Layout
from .parts import DEFAULT_TOLERANCE, PartRun, StoredSweep, computation_of, run_on_dask, run_share, summarise
from .spread import Spread
from .store import Memory
from .stored import StoredRows
from .summary import Summary


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

_FAR = 5.0  # times the middle half of the dies: a normal one comes so far once in 10^11


@dataclass(frozen=True)
class Lot(Tabular):
    """The dies of a sweep: `data` as a Dataset over (die, window, coefficient, parameter), SI units throughout.

    `notes` says what was amiss with the store it went on with, one sentence each.
    """

    settings: Settings
    summary: Summary
    _rows: dict[str, np.ndarray] | StoredRows
    _layout: Layout
    notes: tuple[str, ...] = ()
    along: ClassVar[str] = "die"

    @cached_property
    def data(self) -> "xr.Dataset":
        """The Dataset, made when first asked for: xarray takes half a second to import, and what is in a store is read
        and verified then.
        """
        rows = self._rows.all() if isinstance(self._rows, StoredRows) else self._rows
        return self._layout.dataset(rows).assign_attrs({MARK: "Lot", "printed": str(self.summary)})

    def first(self, dies: int) -> "Lot":
        """The same with the data of the first dies alone, where there are more; the summary remains that of all."""
        if isinstance(self._rows, StoredRows):
            return replace(self, _rows=replace(self._rows, dies=min(dies, self._rows.dies)))
        return replace(self, _rows={name: column[:dies] for name, column in self._rows.items()})

    def __repr__(self) -> str:
        return "\n".join([repr(self.summary), *(f"  note: {note}" for note in self.notes)])

    def to_xarray(self) -> "xr.Dataset":
        """The Dataset."""
        return self.data

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Histogram of the rate error at the end, with the information bound; dies far beyond all others, which would
        flatten it, are only counted.
        """
        ax, error = axes(ax), np.degrees(self.data["rate_error_end"].values)
        error = error[np.isfinite(error)]
        low, middle, high = np.percentile(error, [25.0, 50.0, 75.0]) if error.size else (0.0,) * 3
        near = np.abs(error - middle) <= _FAR * (high - low)
        beyond = f", {np.sum(~near)} of them further off" if not near.all() else ""
        bins, label = max(10, round(np.sqrt(error.size))), f"{error.size} dies{beyond}"
        ax.hist(error[near], bins=bins, density=True, color="C0", alpha=0.6, label=label)
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
    sample_rate: float | str | None = None,
    duration: float | str | None = None,
    settle: float | str | None = None,
    tolerance: float | str = DEFAULT_TOLERANCE,
    seed: int = 0,
    chunk: int | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    dask: str | None = None,
    bound_dies: int = 256,
    progress: Callable[[int, int], None] | None = None,
) -> Lot:
    """Run `dies` dies drawn from `spread` around `loop` and gather their figures of merit.

    `scenario` as in `simulate`; `sample_rate` and `duration` follow the device where they are left out, as in
    `Operation`. Statistics over time start at `settle` [s] (default: half the duration); a die has converged when its
    rate error stays within `tolerance` [rad/s], and yields when it ends there. Die i depends on (`seed`, i) only: not a
    bit of it changes with `dies`, `chunk` (dies per device and batch), the number of CPU devices or a resume. With
    `out`, a folder, the rows go to `out/dies.zarr` as they are computed, the figures to `out/summary.json` at the end;
    `resume=True` goes on with a store of the same configuration and computes again what is damaged in it. Several
    processes, of several machines too, may work on one store at a time: they share its blocks (`plan` and `run_part`
    give each its own). With `dask`, the address of a scheduler, its workers compute and write to
    `out`, which they must see; only a killed one's block is computed again. `progress(done, dies)` is called at first
    and after each batch. The information bound is computed for each of the first `bound_dies` dies (0: not at all),
    which costs about as much as running them; the summary compares each die's error with its own bound.

    Errors, convergence and window means are those of the loop's output, behind its filter where it has one; claimed
    standard deviation, NIS and NEES those of the observer's estimate before the filter, which alone they speak of. The
    bound holds for any use of the same data and prior, with a filter or without. A die whose errors or innovations are
    impossible under what its filter claims (`divergence.LEVEL`) is *diverged*: counted, explained, and part of all
    figures but those that say so. What the filter cannot expect of the run, and a change of it beyond its end, is
    logged before it begins.

    Raises `InputError` for settings that cannot be run, a store of something else, and outside float64.
    """
    if dask is not None and out is None:
        raise InputError("Argument `dask` needs `out`, a folder that all workers see.")
    made = computation_of(
        loop, spread, scenario, dies=dies, sample_rate=sample_rate, duration=duration, settle=settle,
        tolerance=tolerance, seed=seed, chunk=chunk, bound_dies=bound_dies,
    )  # fmt: skip
    if out is None:
        memory = Memory(made.dies, made.runner.block)
        with made.compiling_bounds():
            speed = made.runner.work(memory, made.dies, progress)
        rows = memory.rows
        return Lot(made.settings, made.summary([(0, rows)], [], speed), rows, made.layout)
    store = StoredSweep(place_of(out) / "dies.zarr", made)
    ran = run_share(store, None, resume, progress, True) if dask is None else run_on_dask(store, dask, resume, progress)
    return lot_of(store, ran)


def lot_of(store: StoredSweep, ran: PartRun) -> Lot:
    """The dies of a store, after `ran` has worked on them; their figures lie beside it, in summary.json."""
    made = store.computation
    summary = summarise(store, ran.steps_per_s)
    if isinstance(store.path, Path):
        write_json(store.path.with_name("summary.json"), summary.as_dict())
    return Lot(made.settings, summary, store.rows, made.layout, ran.notes)
