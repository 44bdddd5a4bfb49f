"""What the studies share: options, runs over many noise seeds, and the table of claimed beside obtained.

A study says at its top, in literals that `memsgyro studies` reads without running it, where it belongs, which rows of
`rows.toml` it answers and which of its pictures shows which printed figure:

    PLACE = "thesis 5.2"
    ANSWERS = ("T14", "T15")
    FIGURES = {"5.7": "motion", "5.8": "coefficients"}

and calls `report.answer(...)` for each of these rows before `report.finish()`. Parts of a row may be answered by
several studies. Nothing is to be registered elsewhere.
"""

import argparse
import inspect
import json
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, fields
from datetime import date
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from memsgyro_jax import ClosedLoop, Lowpass
from memsgyro_jax.base import runtime
from memsgyro_jax.loop import engine, noise
from memsgyro_jax.loop.scenario import as_scenario


matplotlib.use("agg")

HOLDS, PARTLY, FAILS = "holds", "holds in part", "does not hold"
BEYOND = "left open there, shown here"


@dataclass(frozen=True)
class Answer:
    """What became of one row, in words with figures; none may be blank.

    Args:
        row: its name in `rows.toml`.
        claimed: what is printed.
        obtained: the same on the correct plant.
        reading: what comes out under the reading that explains the claim; "not needed" where it holds as it stands.
        verdict: `HOLDS`, `PARTLY`, `FAILS` or `BEYOND`.
        why: one sentence.
    """

    row: str
    claimed: str
    obtained: str
    reading: str
    verdict: str
    why: str

    def __post_init__(self):
        blank = [field.name for field in fields(self) if not getattr(self, field.name).strip()]
        if blank or self.verdict not in (HOLDS, PARTLY, FAILS, BEYOND):
            raise ValueError(f"row {self.row}: blank {blank}, verdict {self.verdict!r}")


class Report:
    """Collects claims and pictures of one study under `studies/out/NAME`.

    `data` is the help of an optional argument, a folder with measurements that the study needs; the study finds it in
    the attribute of that name. `numbers` are further options that are whole numbers, name to default and help.
    """

    def __init__(self, data: str | None = None, numbers: Mapping[str, tuple[int, str]] | None = None):
        caller = inspect.stack()[1]
        study, told = Path(caller.filename), caller.frame.f_globals
        parser = argparse.ArgumentParser(description=told["__doc__"])
        parser.add_argument("--quick", action="store_true", help="fewer seeds and shorter runs, under 30 s")
        parser.add_argument("--out", type=Path, default=study.parent / "out" / study.stem, help="folder for results")
        if data is not None:
            parser.add_argument("data", type=Path, nargs="?", help=data)
        for name, (default, text) in (numbers or {}).items():
            parser.add_argument(f"--{name}", type=int, default=default, help=f"{text} ({default})")
        options = parser.parse_args()
        self.numbers = {name: getattr(options, name) for name in numbers or {}}
        self.data = getattr(options, "data", None)
        self.quick, self.folder, self.title, self.rows = options.quick, options.out, study.stem, []
        self.wanted, self.answers = tuple(told.get("ANSWERS", ())), []
        self.figures = tuple(told.get("FIGURES", {}).values())
        self.folder.mkdir(parents=True, exist_ok=True)

    def row(self, what: str, claimed: object, obtained: object, remark: str = "") -> None:
        self.rows.append({"what": what, "claimed": claimed, "obtained": obtained, "remark": remark})

    def found(self, what: str) -> object:
        """What a row of this table obtained."""
        return next(row["obtained"] for row in self.rows if row["what"] == what)

    def answer(self, row: str, *, claimed: str, obtained: str, reading: str, verdict: str, why: str) -> None:
        """The table of all rows shows it; see `Answer`."""
        self.answers.append(Answer(row, claimed, obtained, reading, verdict, why))

    def picture(self, figure, name: str) -> None:
        figure.savefig(self.folder / f"{name}.png", dpi=130)

    def finish(self) -> None:
        """Prints and writes the table, and the answers, of which none that was promised may be missing."""
        told = {"quick": self.quick, "date": date.today().isoformat(), "answers": [asdict(a) for a in self.answers]}
        missing = set(self.wanted) ^ {a.row for a in self.answers}
        missing |= {name for name in self.figures if not (self.folder / f"{name}.png").exists()}
        if missing:
            raise ValueError(f"promised and not given, or given and not promised: {sorted(missing)}")
        (self.folder / "answers.json").write_text(json.dumps(told, indent=1, ensure_ascii=False), encoding="utf-8")
        table = Table("what", "claimed", "obtained", "remark", title=self.title + (" (quick)" if self.quick else ""))
        for row in self.rows:
            table.add_row(*(escape(f"{v:.4g}" if isinstance(v, float) else str(v)) for v in row.values()))
        console = Console(record=True, width=150)
        console.print(table)
        console.save_text(str(self.folder / "table.txt"))
        (self.folder / "table.json").write_text(json.dumps(self.rows, indent=1, default=float))
        print(f"table and pictures: {self.folder}")


class Seeds(NamedTuple):
    """Runs that differ in their noise: estimates at the end of each of `time` (points,), dies on the last axis."""

    time: np.ndarray
    rate_true: np.ndarray  # rad/s, (points, dies or 1)
    rate: np.ndarray  # rad/s, (points, dies)
    filtered: np.ndarray  # the rate after `lowpass`, (points, dies)
    theta: np.ndarray  # (points, coefficients, dies)
    offset: np.ndarray  # V, (points, 2, dies)
    motion: np.ndarray  # m and m/s, (points, 4, dies)
    lost: int  # dies
    state: Any  # of the loop at the end, dies on the last axis


class _Keep(engine.AbstractRecorder):
    lowpass: Lowpass
    loop: ClosedLoop

    def init(self):
        estimate = self.loop.observer.estimate(self.loop.init().observer)
        zeros = jax.tree.map(jnp.zeros_like, (estimate.theta, estimate.offset, self.loop.start))
        return self.lowpass.init(), (jnp.zeros(()), jnp.zeros(()), jnp.zeros(()), *zeros)

    def sample(self, memory, sample):
        rate = sample.estimate.rate
        filtered, state = self.lowpass.step(memory[0], rate, sample.clock.period)
        true, seen = sample.conditions.inertial.rate, sample.estimate
        kept = (true, rate, filtered, seen.theta, seen.offset, sample.motion)
        return state, jax.tree.map(lambda value: value + 0.0 * rate, kept)  # one value per run, also of constants

    def block(self, memory):
        return memory, memory[1]


def seeds(loop, scenario, *, count, sample_rate, duration, points=200, bandwidth=10.0, order=3, design=None) -> Seeds:
    """`count` runs of `loop`; leaves of the scenario may have one value per run, those of the loop too beside a
    `design` that has one."""
    loop, block = loop.sampled_at(sample_rate, design), round(sample_rate * duration) // points
    design = design and design.sampled_at(sample_rate)
    words = noise.die_words(jax.random.key(2010), jnp.arange(count))
    keep = _Keep(Lowpass(bandwidth, order), design or loop)
    given = alike((loop, as_scenario(scenario), words, jnp.asarray(1.0 / sample_rate)))
    done = _run(*given, points, block, *alike((keep, design)))
    lost = int(count - np.sum(done.alive))
    if lost:
        print(f"{lost} of {count} runs were lost")
    stacked = [np.stack([np.asarray(a) for a in part], axis=1) if isinstance(part, tuple) else np.asarray(part)
               for part in done.outputs]  # fmt: skip
    return Seeds(np.arange(1, points + 1) * block / sample_rate, *stacked, lost, done.state)


_run = eqx.filter_jit(engine.run)


def alike(tree):
    """Its numbers as arrays of NumPy make them: one that came from a number of Python would ask for another program."""
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)) if eqx.is_array(leaf) else leaf, tree)


def at_once(function, cases):
    """`function` of each of `cases`, in their order: as many at a time as there are processors, threads of one process.

    A run keeps one processor busy; JAX leaves the others to other threads while it compiles and computes.
    """
    with ThreadPoolExecutor(runtime.usable_cores()) as pool:
        return list(pool.map(function, cases))


def draw_motion(trace):
    """A figure of one `mg.Trace`: the read-out's volts, and the estimated beside the true displacements."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.6), layout="constrained")
    for i, axis in enumerate("xy"):
        left.plot(1e3 * trace.time, 1e3 * trace.volts[:, i], f"C{i}", lw=0.8, label=axis)
        right.plot(1e3 * trace.time, 1e6 * trace.motion_estimate[:, i], f"C{i}", lw=0.8, label=f"{axis}, estimated")
        right.plot(1e3 * trace.time, 1e6 * trace.motion[:, i], "k--", lw=0.5, label="true" if i else None)
    left.set(xlabel="time [ms]", ylabel="read-out [mV]")
    right.set(xlabel="time [ms]", ylabel="displacement [µm]")
    for ax in (left, right):
        ax.legend(frameon=False, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return figure


def draw_coefficients(loop, time, theta, true_rate, offset=None):
    """A figure of estimates over time, each over its true value: `theta` (samples, coefficients), the rate in deg/s."""
    names, truth = loop.device.model.names, np.asarray(loop.device.coefficients(0.0))
    shown = [(name, theta[:, i] / truth[i], 1.0) for i, name in enumerate(names) if truth[i] != 0.0]
    shown += [(f"{name} [deg/s]", dps(theta[:, names.index(name)]), dps(true_rate)) for name in names if "rate" in name]
    if offset is not None:
        shown += [(f"offset {a} [mV]", 1e3 * offset[:, i], None) for i, a in enumerate("xy")]
    figure, axes = plt.subplots(-(-len(shown) // 4), 4, figsize=(12, 2.2 * -(-len(shown) // 4)), layout="constrained")
    for ax in axes.flat[len(shown) :]:
        ax.set_axis_off()
    for ax, (name, value, true) in zip(axes.flat, shown, strict=False):
        ax.plot(1e3 * time, value, lw=0.8)
        if true is not None:
            ax.plot(1e3 * time, np.broadcast_to(true, time.shape), "k--", lw=0.6)
        settled = value[len(value) // 4 :]
        ends = np.append(settled, [] if true is None else true)
        room = 0.5 * np.ptp(ends) or 0.1  # of one that is known
        ax.set(title=name if "[" in name else f"{name} / true", ylim=(ends.min() - room, ends.max() + room))
        ax.ticklabel_format(axis="y", useOffset=False)
    for ax in axes[-1]:
        ax.set_xlabel("time [ms]")
    return figure


def draw_path(ax, trace):
    """The path of the mass over the axes that turn with it."""
    ax.plot(1e6 * trace.motion[:, 0], 1e6 * trace.motion[:, 1], lw=0.4)
    ax.set(xlabel="x [µm]", ylabel="y [µm]", aspect="equal")


def dps(rate):
    return np.degrees(np.asarray(rate))


def rms(error, axis=None):
    return np.sqrt(np.mean(np.square(error), axis=axis))


def interval(error, count=2000):
    """Root mean square of `error` (points, runs), and the 95 % interval of it that the drawing of runs leaves."""
    power = np.mean(np.square(error), axis=0)
    drawn = np.random.default_rng(0).integers(len(power), size=(count, len(power)))
    low, high = np.quantile(np.sqrt(np.mean(power[drawn], axis=1)), (0.025, 0.975))
    return float(np.sqrt(np.mean(power))), float(low), float(high)
