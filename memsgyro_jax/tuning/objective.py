"""The loss of a lot of dies as a function of what is free: a value per die, and its derivatives, forwards by few
numbers and backwards by many.

Common random numbers: the dies and their noise are those of their numbers, whatever is tried, so two settings differ by
what they do and not by luck.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from memsgyro_jax.base.provenance import fingerprint
from memsgyro_jax.loop import noise
from memsgyro_jax.loop.blocks.run import sizes_of, statistics
from memsgyro_jax.loop.die_by_die import die_by_die, differs, from_outside
from memsgyro_jax.loop.each_part import each_mapped
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.scenario import Scenario
from memsgyro_jax.montecarlo import batch as lot
from memsgyro_jax.montecarlo.spread import AbstractDistribution, Spread

from .adjoint import Portion, Timing
from .block_adjoint import PortionInBlocks
from .descent import Judged
from .losses import AbstractLoss
from .tunable import Tunables


class Values(NamedTuple):
    """Loss of each die (dies,), which were not lost, and where asked for the derivative by each free number (n, dies),
    zero for a lost die.
    """

    loss: Float[np.ndarray, " dies"]
    alive: Bool[np.ndarray, " dies"]
    slopes: Float[np.ndarray, "n dies"] | None = None


@dataclass(frozen=True)
class Objective:
    """The dies `dies` (their global numbers) of a lot under a loss. Make one with `Objective.of`.

    A free number that also differs between dies is the design value that they lie `around`, each at its own place.
    """

    tunables: Tunables
    loss: AbstractLoss
    loop: ClosedLoop
    scenario: Scenario
    design: tuple[ClosedLoop, Scenario]
    words: tuple[np.ndarray, ...]
    timing: Timing
    mesh: jax.sharding.Mesh
    lanes: int
    around: tuple[AbstractDistribution | None, ...]
    places: Float[np.ndarray, "n dies"]
    keep: Path | None = None

    @classmethod
    def of(
        cls, loop: ClosedLoop, scenario: Scenario, spread: Spread, tunables: Tunables, loss: AbstractLoss, *,
        dies: Sequence[int] | np.ndarray, timing: Timing, seed: int, lanes: int = 32, keep: Path | None = None,
    ) -> "Objective":  # fmt: skip
        """Draw the dies. With `keep`, a folder, each evaluation is kept there and never computed again."""
        numbers = np.asarray(dies, int)
        drawn = spread.draw(loop, scenario, seed, numbers)
        items = spread.resolved(loop)
        normal = dict(zip((i.path for i in items), drawn.normal.T, strict=True))
        kinds = {item.path: item.distribution for item in items}
        around = tuple(kinds.get(path) for path in tunables.paths)
        places = [np.zeros(len(numbers)) if kind is None else kind.place(normal[path])
                  for kind, path in zip(around, tunables.paths, strict=True)]  # fmt: skip
        words = jax.tree.map(np.asarray, noise.die_words(jax.random.key(seed), jnp.asarray(numbers)))
        mesh = lot.mesh_of(jax.local_devices())
        return cls(
            tunables, loss, drawn.loop, drawn.scenario, (loop, scenario), words, timing, mesh, lanes, around,
            np.stack(places), keep,
        )  # fmt: skip

    @property
    def dies(self) -> int:
        """How many."""
        return len(self.words[0])

    def values(self, numbers: Float[np.ndarray, "n *dies"]) -> Values:
        """The losses at `numbers` in SI, one set for all dies or (n, dies) one for each."""
        loss, alive = self._run(numbers, derivative=False)
        return Values(loss, alive.astype(bool))

    def slopes(self, numbers: Float[np.ndarray, " n"]) -> Values:
        """The losses and their derivatives by the free numbers."""
        loss, alive, slopes = self._run(numbers, derivative=True)
        alive = alive.astype(bool) & np.all(np.isfinite(slopes), axis=0)
        return Values(loss, alive, np.where(alive, slopes, 0.0))

    def total(self, values: Values, penalty: float) -> tuple[float, Float[np.ndarray, " n"] | None]:
        """The loss of the lot, a lost die counting `penalty`, and its gradient."""
        filled = jnp.asarray(np.where(values.alive, values.loss, penalty))
        whole, weights = _combined(self.loss, filled)
        return float(whole), None if values.slopes is None else values.slopes @ np.asarray(weights)

    def some(self, places: np.ndarray) -> "Objective":
        """The dies at `places` (positions in this lot, which may repeat) as an objective of its own."""
        loop, scenario = lot.picked((self.loop, self.scenario), self.design, places)
        words = tuple(word[places] for word in self.words)
        return replace(self, loop=loop, scenario=scenario, words=words, places=self.places[:, places])

    def _run(self, numbers: np.ndarray, derivative: bool) -> tuple[np.ndarray, ...]:
        numbers = np.asarray(numbers, float)
        each = np.broadcast_to(numbers.reshape(len(numbers), -1), (len(numbers), self.dies))
        if self.keep is None:
            return self._computed(each, derivative)
        what = (self.loop, self.scenario, self.words, self.loss, self.timing, self.tunables.paths, self.around,
                self.places, each, derivative)  # fmt: skip
        kept = self.keep / f"{fingerprint(*what)}.npz"
        if kept.exists():
            with np.load(kept) as rows:
                return tuple(rows[name] for name in sorted(rows.files))
        found = self._computed(each, derivative)
        self.keep.mkdir(parents=True, exist_ok=True)
        part = kept.with_suffix(".part.npz")
        np.savez(part, *found)
        part.replace(kept)
        return found

    def _computed(self, each: np.ndarray, derivative: bool) -> tuple[np.ndarray, ...]:
        together = self.lanes * self.mesh.size
        parts = []
        for first in range(0, self.dies, together):
            # The last die fills up the last batch: one shape, one compilation, however many dies.
            places = np.minimum(np.arange(first, first + together), self.dies - 1)
            parts.append([np.asarray(row) for row in self._rows(places, each, derivative)])
        return tuple(np.concatenate(rows, axis=-1)[..., : self.dies] for rows in zip(*parts, strict=True))

    def _rows(self, places: np.ndarray, each: np.ndarray, derivative: bool) -> tuple[Array, ...]:
        part, numbers = self._part(places), jnp.asarray(each[:, places])
        kind = type(part)
        if self._forwards:
            if not derivative:
                return _split(kind.through, self.mesh, part, numbers)
            judgement, slopes = _split(kind.along, self.mesh, part, numbers)
            return *judgement, slopes
        judgement, kept = _split(kind.keeping, self.mesh, part, numbers)
        return (*judgement, _split(kind.back, self.mesh, part, numbers, kept)) if derivative else judgement

    @property
    def _forwards(self) -> bool:
        return len(self.tunables.paths) < _MANY and not self._sizes[1]

    @property
    def _sizes(self) -> tuple[int, tuple[int, ...]]:
        return sizes_of(self.loop, self.timing.blocks * self.timing.block)

    @property
    def readings(self) -> float:
        """How many the loss counts, of all dies: samples, or where the loop goes in blocks their statistics."""
        begins, (start, sizes) = float(self.loss.begins()) / self.timing.period, self._sizes
        if not sizes:
            return self.dies * (self.timing.blocks * self.timing.block - begins)
        late = int(np.sum(start + np.cumsum(sizes) >= begins))
        return self.dies * (max(start - begins, 0.0) + late * statistics(self.loop))

    def _part(self, places: np.ndarray) -> Portion:
        part = self.some(places)
        given = (part.loop, part.scenario, part.words, jnp.asarray(part.places), self.design, self.loss, self.around,
                 self.tunables.paths)  # fmt: skip
        start, sizes = self._sizes
        return (
            PortionInBlocks(*given, Timing.of(self.timing.period, start), sizes)
            if sizes
            else Portion(*given, self.timing)
        )

    def memory(self, *, derivative: bool) -> float:
        """What the compiled programs allocate beside their arguments, in bytes per die; compiles them."""
        places = np.arange(self.lanes * self.mesh.size) % self.dies
        given = self._part(places), jnp.asarray(np.repeat(self.tunables.values[:, None], len(places), axis=1))
        kind = type(given[0])
        if self._forwards:
            return self._temporary(kind.along if derivative else kind.through, *given) / self.lanes
        kept = _split(kind.keeping, self.mesh, *given)[1]
        passed = sum(leaf.nbytes for leaf in jax.tree.leaves(kept)) / self.mesh.size
        programs = [self._temporary(kind.keeping, *given)]
        if derivative:
            programs.append(self._temporary(kind.back, *given, kept))
        return (passed + max(programs)) / self.lanes

    def _temporary(self, function: Callable, *given: Any) -> int:
        program: Any = _split
        return program.lower(function, self.mesh, *given).compile().compiled.memory_analysis().temp_size_in_bytes


def noise_of(values: Values) -> float:
    """Standard deviation of the loss over the dies; where all are alike, its size."""
    loss = values.loss[values.alive]
    spread = float(np.std(loss)) if loss.size > 1 else 0.0
    return spread if spread > 0.0 else max(float(np.max(np.abs(loss), initial=0.0)), np.finfo(float).tiny)


class Judge(Protocol):
    """What sums up losses: an objective, or pieces of a record."""

    @property
    def tunables(self) -> Tunables:
        """What is free."""

    def total(self, values: Values, penalty: float) -> tuple[float, Float[np.ndarray, " n"] | None]:
        """The loss of all, what is lost counting `penalty`, and its gradient."""


def evaluated(judge: Judge, values: Values, coordinates: np.ndarray, penalty: float, readings: float) -> Judged:
    """Losses and slopes at some coordinates as a descent wants them; what is known beforehand counts once in
    `readings`.
    """
    stretch = judge.tunables.stretch(coordinates)
    whole, slope = judge.total(values, penalty)
    assert slope is not None
    assert values.slopes is not None
    known, pull = judge.tunables.prior(coordinates)
    error = noise_of(values) / float(np.sqrt(max(1, np.sum(values.alive))))
    slopes = values.slopes[:, values.alive] * stretch[:, None]
    return Judged(whole + known / readings, slope * stretch + pull / readings, slopes, error)


@eqx.filter_jit
def _combined(loss: AbstractLoss, values: Array) -> tuple[Array, Array]:
    return jax.value_and_grad(loss.combine)(values)


_MANY = 6  # free numbers from which on it is cheaper to go backwards
_RANKS = {
    Portion.through: (1, 1),
    Portion.along: ((1, 1), 2),
    Portion.back: 2,
    PortionInBlocks.through: (1, 1),
    PortionInBlocks.back: 2,
}  # of what needs no tracing to know it


@eqx.filter_jit
def _split(function: Callable, mesh: jax.sharding.Mesh, part: Portion, *rows: Any) -> Any:
    """`function` of a portion and of arrays by dies, run on every device with its share of the dies."""
    (loop, scenario), known = part.design, _RANKS.get(function)
    one = replace(part, loop=loop, scenario=scenario, words=tuple(w[0] for w in part.words), places=part.places[:, 0])
    if from_outside(part.design, part.loss):
        whole = from_outside(part.loss) or each_mapped((part.loop, part.scenario), part.design) is None
        function = partial(_alone if whole else _each, function, one)
    dynamic, static = eqx.partition(part, eqx.is_array)
    shares = lot.shares(dynamic, differs(dynamic, eqx.filter(one, eqx.is_array)))
    specs = (shares, *(lot.shares(tree) for tree in rows))
    ranks = known or jax.tree.map(lambda row: row.ndim, eqx.filter_eval_shape(function, part, *rows))
    out = jax.tree.map(lot.trailing, ranks)

    def local(dynamic, *rows):
        return function(eqx.combine(dynamic, static), *rows)

    return jax.shard_map(local, mesh=mesh, in_specs=specs, out_specs=out, check_vma=False)(dynamic, *rows)


def _each(function: Callable, one: Portion, part: Portion, *rows: Any) -> Any:
    """`function` of a portion whose parts from outside are mapped over the dies each by itself."""
    mapped = each_mapped((part.loop, part.scenario), (one.loop, one.scenario))
    assert mapped is not None
    loop, scenario = mapped
    return function(replace(part, loop=loop, scenario=scenario), *rows)


def _alone(function: Callable, one: Portion, part: Portion, *rows: Any) -> Any:
    """`function` of a portion with parts from outside, die by die; `one` is the like of a single die."""
    return die_by_die(function, (part, *rows), (one, *jax.tree.map(lambda row: row[..., 0], rows)))
