"""The loss of a lot of dies as a function of what is free: a value per die, and its derivatives, forwards by few
numbers and backwards by many.

Common random numbers: the dies and their noise are those of their numbers, whatever is tried, so two settings differ by
what they do and not by luck.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec as P
from jaxtyping import Array, Bool, Float

from memsgyro_jax.base.provenance import fingerprint
from memsgyro_jax.loop import engine, noise
from memsgyro_jax.loop.loop import ClosedLoop, Sample
from memsgyro_jax.loop.scenario import Scenario
from memsgyro_jax.montecarlo import batch as lot
from memsgyro_jax.montecarlo.spread import AbstractDistribution, Spread

from .adjoint import Backwards, Kept
from .descent import Judged
from .losses import AbstractLoss
from .tunable import Tunables, placed


class Timing(NamedTuple):
    """Sample period in s, blocks, and samples per block."""

    period: float
    blocks: int
    block: int


class LossRecorder(engine.AbstractRecorder[Any, tuple[()]]):
    """Carries a loss through a run."""

    loss: AbstractLoss

    def init(self):
        """The loss's memory."""
        return self.loss.init()

    def sample(self, memory: Any, sample: Sample) -> Any:
        """One more sample."""
        return self.loss.sample(memory, sample)

    def block(self, memory: Any) -> tuple[Any, tuple[()]]:
        """Nothing to hand out before the end."""
        return memory, ()


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
        normal = dict(zip((i.path for i in items), spread.normal(len(items), seed, numbers).T, strict=True))
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
        pick = lambda value, plain: np.asarray(value)[..., places] if np.ndim(value) > np.ndim(plain) else value  # noqa: E731
        loop, scenario = jax.tree.map(pick, (self.loop, self.scenario), self.design)
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
            rows = self._rows(self._part(places, each), derivative)
            parts.append([np.asarray(row) for row in rows])
        return tuple(np.concatenate(rows, axis=-1)[..., : self.dies] for rows in zip(*parts, strict=True))

    def _rows(self, part: "Portion", derivative: bool) -> tuple[Array, ...]:
        if len(self.tunables.paths) < _MANY:
            return _along(part) if derivative else _losses(part)
        loss, alive, kept = _keeping(part)
        return (loss, alive, _back(part, kept)) if derivative else (loss, alive)

    def _part(self, places: np.ndarray, each: np.ndarray) -> "Portion":
        part = self.some(places)
        return Portion(part.loop, part.scenario, part.words, jnp.asarray(each[:, places]), jnp.asarray(part.places),
                    self.loss, self.design, self.tunables.paths, self.around, self.timing, self.mesh)  # fmt: skip

    def memory(self, *, derivative: bool) -> float:
        """What the compiled programs allocate beside their arguments, in bytes per die; compiles them."""
        places = np.arange(self.lanes * self.mesh.size) % self.dies
        part = self._part(places, np.repeat(self.tunables.values[:, None], self.dies, axis=1))
        if len(self.tunables.paths) < _MANY:
            return _temporary(_along if derivative else _losses, part) / self.lanes
        kept = _keeping(part)[2]
        passed = sum(leaf.nbytes for leaf in jax.tree.leaves(kept)) / self.mesh.size
        programs = [_temporary(_keeping, part), *([_temporary(_back, part, kept)] if derivative else [])]
        return (passed + max(programs)) / self.lanes


def _temporary(program: Any, *arguments: Any) -> int:
    return program.lower(*arguments).compile().compiled.memory_analysis().temp_size_in_bytes


def noise_of(values: Values) -> float:
    """Standard deviation of the loss over the dies; where all are alike, its size."""
    loss = values.loss[values.alive]
    spread = float(np.std(loss)) if loss.size > 1 else 0.0
    return spread if spread > 0.0 else max(float(np.max(np.abs(loss), initial=0.0)), np.finfo(float).tiny)


def evaluated(
    objective: Objective, tunables: Tunables, coordinates: np.ndarray, penalty: float, readings: float
) -> Judged:
    """The loss as a descent wants it, by the coordinates; what is known beforehand counts once in `readings`."""
    values, stretch = objective.slopes(tunables.numbers(coordinates)), tunables.stretch(coordinates)
    whole, slope = objective.total(values, penalty)
    assert slope is not None
    assert values.slopes is not None
    known, pull = tunables.prior(coordinates)
    whole, slope = whole + known / readings, slope * stretch + pull / readings
    error = noise_of(values) / float(np.sqrt(max(1, np.sum(values.alive))))
    return Judged(whole, slope, values.slopes[:, values.alive] * stretch[:, None], error)


@eqx.filter_jit
def _combined(loss: AbstractLoss, values: Array) -> tuple[Array, Array]:
    return jax.value_and_grad(loss.combine)(values)


_MANY = 6  # free numbers from which on it is cheaper to go backwards


class Portion(NamedTuple):
    """As many dies of an objective as fill the devices, evenly split over them, each with its own free numbers."""

    loop: ClosedLoop
    scenario: Scenario
    words: tuple
    numbers: Float[Array, "n dies"]
    places: Float[Array, "n dies"]
    loss: AbstractLoss
    design: tuple[ClosedLoop, Scenario]
    paths: tuple[str, ...]
    around: tuple[AbstractDistribution | None, ...]
    timing: Timing
    mesh: jax.sharding.Mesh

    @property
    def varying(self) -> tuple:
        """What may differ between dies."""
        return self.loop, self.scenario, self.words, self.numbers, self.places

    def own(self, numbers: Array) -> Float[Array, "n dies"]:
        """The value of each free number for each die: the design's or the die's place around it."""
        own = [
            number if kind is None else kind.value(number, place)
            for number, kind, place in zip(numbers, self.around, self.places, strict=True)
        ]
        return jnp.stack(own)

    def tuned(self, own: Array) -> ClosedLoop:
        """The loop with these values."""
        return placed(self.loop, self.paths, list(own))

    @property
    def backwards(self) -> Backwards:
        """The run of these dies as `adjoint` differentiates it."""
        return Backwards(self.tuned, self.scenario, self.words, self.timing, LossRecorder(self.loss), self.loss.value,
                         self.design[0])  # fmt: skip

    def at(self, numbers: Array) -> tuple[Array, Array]:
        """Losses and survival by running through."""
        recorder = LossRecorder(self.loss)
        done = engine.run(self.tuned(self.own(numbers)), self.scenario, self.words, *self.timing, recorder,
                          self.design[0])  # fmt: skip
        loss = jnp.broadcast_to(self.loss.value(done.memory), self.words[0].shape)
        return loss, done.alive & jnp.isfinite(loss)


@eqx.filter_jit
def _losses(part: Portion) -> tuple[Array, Array]:
    """Losses and survival."""
    return _split(lambda part: part.at(part.numbers), part, (_last(1), _last(1)))


@eqx.filter_jit
def _along(part: Portion) -> tuple[Array, Array, Array]:
    """The same with slopes, forwards: every sample carries its derivative by each number along."""

    def along(part: Portion):
        def one(unit):
            tangent = jnp.broadcast_to(unit[:, None], part.numbers.shape)
            loss, slope, alive = jax.jvp(part.at, (part.numbers,), (tangent,), has_aux=True)
            return loss, alive, slope

        return jax.vmap(one, out_axes=(None, None, 0))(jnp.eye(len(part.paths)))

    return _split(along, part, (_last(1), _last(1), _last(2)))


@eqx.filter_jit
def _keeping(part: Portion) -> tuple[Array, Array, Kept]:
    """Losses, survival, and what the way back needs."""

    def losses(part: Portion) -> tuple[Array, Array, Kept]:
        return part.backwards.losses(part.own(part.numbers))

    return _split(losses, part, _every(eqx.filter_eval_shape(losses, part)))


@eqx.filter_jit
def _back(part: Portion, kept: Kept) -> Array:
    """The slopes, backwards."""

    def back(part: Portion, kept: Kept):
        own, chain = jax.vjp(part.own, part.numbers)
        return chain(part.backwards.slopes(own, kept))[0]

    return _split(back, part, _last(2), kept)


def _split(function: Callable, part: Portion, out: Any, *more: Any) -> Any:
    """`function` of a part and of arrays by dies, run on every device with its share of the dies."""
    dynamic, static = eqx.partition(part.varying, eqx.is_array)
    plain = (*part.design, tuple(word[0] for word in part.words), part.numbers[:, 0], part.places[:, 0])
    plain = eqx.filter(plain, eqx.is_array)
    shares = jax.tree.map(lambda value, one: _last(value.ndim) if value.ndim > one.ndim else P(), dynamic, plain)

    def local(dynamic, more):
        return function(part._replace(**dict(zip(Portion._fields, eqx.combine(dynamic, static), strict=False))), *more)

    run = jax.shard_map(local, mesh=part.mesh, in_specs=(shares, _every(more)), out_specs=out, check_vma=False)
    return run(dynamic, more)


def _every(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: _last(leaf.ndim), tree)


def _last(rank: int) -> P:
    """The trailing axis, the dies, split over the devices."""
    return P(*(None,) * (rank - 1), lot.DIE_AXIS)
