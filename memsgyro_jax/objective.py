"""The loss of a lot of dies as a function of what is free: a value per die, and its derivatives by forward mode.

Common random numbers: the dies and their noise are those of their numbers, whatever is tried, so two settings differ by
what they do and not by luck.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from . import batch, engine, noise
from .loop import ClosedLoop, Sample
from .losses import AbstractLoss
from .scenario import Scenario
from .spread import Spread
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
    """The dies `dies` (their global numbers) of a lot under a loss. Make one with `Objective.of`."""

    tunables: Tunables
    loss: AbstractLoss
    loop: ClosedLoop
    scenario: Scenario
    design: tuple[ClosedLoop, Scenario]
    words: tuple[np.ndarray, ...]
    timing: Timing
    mesh: jax.sharding.Mesh
    lanes: int

    @classmethod
    def of(
        cls, loop: ClosedLoop, scenario: Scenario, spread: Spread, tunables: Tunables, loss: AbstractLoss, *,
        dies: Sequence[int] | np.ndarray, timing: Timing, seed: int, lanes: int = 32,
    ) -> "Objective":  # fmt: skip
        """Draw the dies."""
        numbers = np.asarray(dies, int)
        drawn = spread.draw(loop, scenario, seed, numbers)
        words = jax.tree.map(np.asarray, noise.die_words(jax.random.key(seed), jnp.asarray(numbers)))
        mesh = jax.sharding.Mesh(np.array(jax.local_devices()), ("die",))
        return cls(tunables, loss, drawn.loop, drawn.scenario, (loop, scenario), words, timing, mesh, lanes)

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
        whole, weights = jax.value_and_grad(self.loss.combine)(filled)
        return float(whole), None if values.slopes is None else values.slopes @ np.asarray(weights)

    def some(self, places: np.ndarray) -> "Objective":
        """The dies at `places` (positions in this lot, which may repeat) as an objective of its own."""
        pick = lambda value, plain: np.asarray(value)[..., places] if np.ndim(value) > np.ndim(plain) else value  # noqa: E731
        loop, scenario = jax.tree.map(pick, (self.loop, self.scenario), self.design)
        words = tuple(word[places] for word in self.words)
        return Objective(
            self.tunables, self.loss, loop, scenario, self.design, words, self.timing, self.mesh, self.lanes
        )

    def _run(self, numbers: np.ndarray, derivative: bool) -> tuple[np.ndarray, ...]:
        places = batch.padded(self.dies, self.lanes, self.mesh)
        numbers = np.asarray(numbers, float)
        each = np.broadcast_to(numbers.reshape(len(numbers), -1), (len(numbers), self.dies))[:, places]
        full = self.some(places)
        rows = _evaluate(
            full.loop, full.scenario, full.words, jnp.asarray(each), self.design, self.loss, self.tunables.paths,
            self.timing, self.mesh, self.lanes, derivative,
        )  # fmt: skip
        return tuple(np.asarray(row)[..., : self.dies] for row in rows)


@eqx.filter_jit
def _evaluate(
    loop: ClosedLoop, scenario: Scenario, words: tuple, numbers: Array, design: tuple, loss: AbstractLoss,
    paths: tuple[str, ...], timing: Timing, mesh: jax.sharding.Mesh, lanes: int, derivative: bool,
) -> tuple[Array, ...]:  # fmt: skip
    dynamic, static = eqx.partition((loop, scenario, words, numbers), eqx.is_array)
    plain = eqx.filter((*design, tuple(word[0] for word in words), numbers[:, 0]), eqx.is_array)
    varies = jax.tree.map(lambda value, one: value.ndim > one.ndim, dynamic, plain)

    def group(dynamic):
        loop, scenario, words, numbers = eqx.combine(dynamic, static)

        def at(numbers):
            tuned = placed(loop, paths, list(numbers))
            done = engine.run(tuned, scenario, words, *timing, LossRecorder(loss), design[0])
            value = jnp.broadcast_to(loss.value(done.memory), words[0].shape)
            return value, done.alive & jnp.isfinite(value)

        if not derivative:
            value, alive = at(numbers)
            return value, alive.astype(float)

        def along(unit):
            tangent = jnp.broadcast_to(unit[:, None], numbers.shape)
            value, slope, alive = jax.jvp(at, (numbers,), (tangent,), has_aux=True)
            return value, alive.astype(float), slope

        value, alive, slopes = jax.vmap(along, out_axes=(None, None, 0))(jnp.eye(len(paths)))
        return value, alive, slopes

    return batch.in_groups(group, dynamic, varies, mesh, lanes)
