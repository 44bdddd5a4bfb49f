"""What the studies share: options, runs over many noise seeds, and the table of claimed beside obtained."""

import argparse
import inspect
import json
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from memsgyro_jax import ClosedLoop, Lowpass
from memsgyro_jax.loop import engine, noise
from memsgyro_jax.loop.scenario import as_scenario


matplotlib.use("agg")


class Report:
    """Collects claims and pictures of one study under `studies/out/NAME`.

    `data` is the help of an optional argument, a folder with measurements that the study needs; the study finds it in
    the attribute of that name. `numbers` are further options that are whole numbers, name to default and help.
    """

    def __init__(self, data: str | None = None, numbers: Mapping[str, tuple[int, str]] | None = None):
        study = Path(inspect.stack()[1].filename)
        parser = argparse.ArgumentParser(description=inspect.stack()[1].frame.f_globals["__doc__"])
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
        self.folder.mkdir(parents=True, exist_ok=True)

    def row(self, what: str, claimed: object, obtained: object, remark: str = "") -> None:
        self.rows.append({"what": what, "claimed": claimed, "obtained": obtained, "remark": remark})

    def picture(self, figure, name: str) -> None:
        figure.savefig(self.folder / f"{name}.png", dpi=130)

    def finish(self) -> None:
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


def seeds(loop, scenario, *, count, sample_rate, duration, points=200, bandwidth=10.0, order=3) -> Seeds:
    """`count` runs of `loop`; leaves of the scenario may have one value per run."""
    loop, block = loop.sampled_at(sample_rate), round(sample_rate * duration) // points
    words = noise.die_words(jax.random.key(2010), jnp.arange(count))
    keep = _Keep(Lowpass(bandwidth, order), loop)
    done = _run(loop, as_scenario(scenario), words, 1.0 / sample_rate, points, block, keep)
    lost = int(count - np.sum(done.alive))
    if lost:
        print(f"{lost} of {count} runs were lost")
    stacked = [np.stack([np.asarray(a) for a in part], axis=1) if isinstance(part, tuple) else np.asarray(part)
               for part in done.outputs]  # fmt: skip
    return Seeds(np.arange(1, points + 1) * block / sample_rate, *stacked)


_run = eqx.filter_jit(engine.run)


def dps(rate):
    return np.degrees(np.asarray(rate))


def rms(error, axis=None):
    return np.sqrt(np.mean(np.square(error), axis=axis))
