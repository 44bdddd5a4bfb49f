"""The losses of dies that run side by side, and their derivatives: forwards by few numbers, backwards through time by
many at once.

There the way forward keeps the state before every block. The way back runs a block again, keeps the state before each
of its samples, and goes back through them. With as many samples in a block as there are blocks a run of n samples keeps
2√n states of a die, and one way back serves all numbers.

A state is kept as one array: XLA on CPU writes a row of one array in place, but copies several anew at every sample.
"""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from memsgyro_jax.loop import engine
from memsgyro_jax.loop.loop import ClosedLoop, LoopState
from memsgyro_jax.loop.scenario import Scenario
from memsgyro_jax.montecarlo.spread import AbstractDistribution

from .losses import AbstractLoss
from .tunable import placed


Carry = tuple[LoopState, Any]
Flat = tuple[Float[Array, "size dies"], Any]  # the real numbers of a state in one array, and what is none
Numbers = Float[Array, "n dies"]
Judgement = tuple[Float[Array, " dies"], Bool[Array, " dies"]]  # losses, and which dies were not lost


class Timing(NamedTuple):
    """Sample period in s, blocks, and samples per block."""

    period: float
    blocks: int
    block: int

    @classmethod
    def of(cls, period: float, samples: int) -> "Timing":
        """As many blocks as samples in each, as near as divides the samples: the way back keeps the start of each block
        and each sample of one.
        """
        blocks = max(n for n in range(1, math.isqrt(samples) + 1) if samples % n == 0)
        return cls(period, blocks, samples // blocks)


class Kept(NamedTuple):
    """The states before every block, along a leading axis, and at the end."""

    starts: Flat
    end: Flat


class Portion(eqx.Module):
    """Dies under a loss, as many as run at once, varied from a `design`.

    A free number, at one of `paths`, that also differs between dies is the design value that they lie `around`, each at
    its own place. The loss must not change its memory at the end of a block.
    """

    loop: ClosedLoop
    scenario: Scenario
    words: tuple
    places: Numbers
    design: tuple[ClosedLoop, Scenario]
    loss: AbstractLoss
    around: tuple[AbstractDistribution | None, ...]
    paths: tuple[str, ...] = eqx.field(static=True)
    timing: Timing = eqx.field(static=True)

    def through(self, numbers: Numbers) -> Judgement:
        """Losses by running through."""
        loop = self._tuned(self._own(numbers))
        done = engine.run(loop, self.scenario, self.words, *self.timing, self.loss, self.design[0])
        return self._judgement(done.memory, done.alive, loop)

    def along(self, numbers: Numbers) -> tuple[Judgement, Numbers]:
        """Losses and slopes, forwards: every sample carries its derivative by each number along."""

        def one(unit):
            tangent = jnp.broadcast_to(unit.reshape(-1, *(1,) * (numbers.ndim - 1)), numbers.shape)
            loss, slope, alive = jax.jvp(self.through, (numbers,), (tangent,), has_aux=True)
            return (loss, alive), slope

        return jax.vmap(one, out_axes=(None, 0))(jnp.eye(len(self.paths)))

    def keeping(self, numbers: Numbers) -> tuple[Judgement, Any]:
        """Losses, and what the way back needs."""
        own = self._own(numbers)
        alive, kept = self._kept(own)
        return self._judgement(self._unflat(*kept.end)[1], alive, self._tuned(own)), kept

    def back(self, numbers: Numbers, kept: Any) -> Numbers:
        """The slopes, backwards; those of a lost die mean nothing."""
        own, chain = jax.vjp(self._own, numbers)
        return chain(self._back(own, kept, *self._pulled(own, kept.end)))[0]

    def _kept(self, own: Numbers) -> tuple[Bool[Array, " dies"], Kept]:
        """Which dies stay within their travel, and the states on the way."""
        loop = self._tuned(own)

        def forward(carry, number):
            before, alive = carry
            after, _ = jax.lax.scan(lambda *at: (self._sample(loop, *at), None), before, self._entering(number))
            return (after, alive & engine.healthy(loop, after[0])), self._flat(before)

        begin = (self._begin(own), jnp.ones(self.words[0].shape, bool))
        (end, alive), starts = jax.lax.scan(forward, begin, jnp.arange(self.timing.blocks))
        return alive, Kept(starts, self._flat(end))

    def _pulled(self, own: Numbers, end: Flat) -> tuple[Array, Numbers]:
        """The derivative of the losses by the real numbers of the state at the end, and by the numbers directly."""
        real, rest = end
        loss, judged = jax.vjp(lambda real, own: self._judged(self._unflat(real, rest)[1], self._tuned(own)), real, own)
        pull, slopes = judged(jnp.ones_like(loss))
        return pull, slopes

    def _back(self, own: Numbers, kept: Kept, pull: Array, slopes: Numbers) -> Numbers:
        """`slopes` and what the pull on the end's state adds to them."""
        loop = self._tuned(own)

        def one_back(carry, was):
            (real, rest), entering = was
            pull, slopes = carry

            def sample(own, real):
                return self._flat(self._sample(self._tuned(own), self._unflat(real, rest), entering))

            _, back, _ = jax.vjp(sample, own, real, has_aux=True)
            more, pull = back(pull)
            return (pull, slopes + more), None

        def block_back(carry, was):
            number, start = was
            entering = self._entering(apart(number))
            _, states = jax.lax.scan(
                lambda state, at: (self._sample(loop, state, at), self._flat(state)), self._unflat(*start), entering
            )
            return jax.lax.scan(one_back, carry, (states, entering), reverse=True)

        blocks = (jnp.arange(self.timing.blocks), kept.starts)
        (pull, slopes), _ = jax.lax.scan(block_back, (pull, slopes), blocks, reverse=True)
        _, begun = jax.vjp(lambda own: self._flat(self._begin(own))[0], own)
        return slopes + begun(pull)[0]

    def _own(self, numbers: Numbers) -> Numbers:
        """The value of each free number for each die: the design's or the die's place around it."""
        rows = zip(numbers, self.around, self.places, strict=True)
        return jnp.stack([number if kind is None else kind.value(number, place) for number, kind, place in rows])

    def _tuned(self, own: Numbers) -> ClosedLoop:
        return placed(self.loop, self.paths, list(own))

    def _begin(self, own: Numbers) -> Carry:
        return engine.beginning(self._tuned(own), self.loss, self.words[0].shape, self.design[0])

    def _entering(self, number: Array) -> engine.Entering:
        device, timing = self.design[0].device, self.timing
        samples, warm = timing.blocks * timing.block if device.effects else None, device.temperature is not None
        flickers = engine.flickers_of(self.design[0])
        return engine.entering(self.scenario, self.words, timing.period, timing.block, number, samples, warm, flickers)

    def _sample(self, loop: ClosedLoop, carry: Carry, entering: engine.Entering) -> Carry:
        return engine.one_sample(loop, self.timing.period, self.loss, carry, entering)

    def _judged(self, memory: Any, loop: ClosedLoop) -> Float[Array, " dies"]:
        return jnp.broadcast_to(self.loss.value(memory) + self.loss.of_loop(loop), self.words[0].shape)

    def _judgement(self, memory: Any, alive: Bool[Array, " dies"], loop: ClosedLoop) -> Judgement:
        loss = self._judged(memory, loop)
        return loss, alive & jnp.isfinite(loss)

    def _flat(self, state: Any) -> Flat:
        """A state's real numbers in one array, and the rest."""
        real, rest = eqx.partition(state, eqx.is_inexact_array)
        return jnp.concatenate([leaf.reshape(-1, *self.words[0].shape) for leaf in jax.tree.leaves(real)]), rest

    def _unflat(self, real: Array, rest: Any) -> Carry:
        like = jax.eval_shape(lambda: engine.beginning(self.design[0], self.loss, self.words[0].shape))
        shapes, tree = jax.tree.flatten(eqx.filter(like, lambda leaf: jnp.issubdtype(leaf.dtype, jnp.inexact)))
        # Derivatives of `split` are put together by one concatenation, those of slices by adding padded arrays.
        lanes = len(self.words[0].shape)
        parts = jax.lax.split(real, [math.prod(leaf.shape[: leaf.ndim - lanes]) for leaf in shapes])
        parts = [part.reshape(leaf.shape) for part, leaf in zip(parts, shapes, strict=True)]
        return eqx.combine(jax.tree.unflatten(tree, parts), rest)


def apart(number: Int[Array, ""]) -> Int[Array, ""]:
    """`number`, through a sort. XLA on CPU makes a loop with all loops inside it one function, which takes time as the
    square of its length to compile; not a loop with a sort."""
    return jax.lax.sort(jnp.stack([number, number + 1]))[0]
