"""A loss of a run and its derivatives by any number of free numbers at once: backwards through time.

The way forward keeps the state before every block. The way back runs a block again, keeps the state before each of its
samples, and goes back through them. With as many samples in a block as there are blocks a run of n samples keeps 2√n
states of a die, and one way back serves all numbers.

A state is kept as one array: XLA on CPU writes a row of one array in place, but copies several anew at every sample.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from memsgyro_jax.device.gyro import Scalar
from memsgyro_jax.loop import engine
from memsgyro_jax.loop.loop import ClosedLoop, LoopState
from memsgyro_jax.loop.scenario import Scenario


Carry = tuple[LoopState, Any]
Flat = tuple[Float[Array, "size lanes"], Any]  # the real numbers of a state in one array, and what is none


class Kept(NamedTuple):
    """The states before every block, along a leading axis, and at the end."""

    starts: Flat
    end: Flat


class Backwards(NamedTuple):
    """A run to be differentiated by the numbers that `make` puts into its loop, a set for each die.

    `timing` is the period in s, the blocks, and the samples per block. `judge` reads the losses of the dies from the
    memory of `recorder`, which must not change at the end of a block.
    """

    make: Callable[[Float[Array, "n lanes"]], ClosedLoop]
    scenario: Scenario
    words: tuple[Array, Array]
    timing: tuple[Scalar, int, int]
    recorder: engine.AbstractRecorder
    judge: Callable[[Any], Float[Array, " lanes"]]
    design: ClosedLoop

    def losses(self, numbers: Float[Array, "n lanes"]) -> tuple[Float[Array, " lanes"], Bool[Array, " lanes"], Kept]:
        """The losses, which dies were not lost, and what the way back needs."""
        loop = self.make(numbers)

        def forward(carry, number):
            before, alive = carry
            after, _ = jax.lax.scan(lambda *at: (self._sample(loop, *at), None), before, self._entering(number))
            return (after, alive & engine.healthy(loop, after[0])), _flat(before)

        begin = (self._begin(numbers), jnp.ones(self.words[0].shape, bool))
        (end, alive), starts = jax.lax.scan(forward, begin, jnp.arange(self.timing[1]))
        loss = self._judged(end)
        return loss, alive & jnp.isfinite(loss), Kept(starts, _flat(end))

    def slopes(self, numbers: Float[Array, "n lanes"], kept: Kept) -> Float[Array, "n lanes"]:
        """The derivatives of each die's loss by its numbers; those of a lost die mean nothing."""

        loop = self.make(numbers)

        def one_back(carry, was):
            (real, rest), entering = was
            pull, slopes = carry

            def sample(numbers, real):
                return _flat(self._sample(self.make(numbers), self._unflat(real, rest), entering))

            _, back, _ = jax.vjp(sample, numbers, real, has_aux=True)
            more, pull = back(pull)
            return (pull, slopes + more), None

        def block_back(carry, was):
            number, start = was
            entering = self._entering(_apart(number))
            _, states = jax.lax.scan(
                lambda state, at: (self._sample(loop, state, at), _flat(state)), self._unflat(*start), entering
            )
            return jax.lax.scan(one_back, carry, (states, entering), reverse=True)

        real, rest = kept.end
        loss, judged = jax.vjp(lambda real: self._judged(self._unflat(real, rest)), real)
        carry = (*judged(jnp.ones_like(loss)), jnp.zeros_like(numbers))
        blocks = (jnp.arange(self.timing[1]), kept.starts)
        (pull, slopes), _ = jax.lax.scan(block_back, carry, blocks, reverse=True)
        _, begun = jax.vjp(lambda numbers: _flat(self._begin(numbers))[0], numbers)
        return slopes + begun(pull)[0]

    def _begin(self, numbers: Array) -> Carry:
        return engine.beginning(self.make(numbers), self.recorder, self.words[0].shape, self.design)

    def _entering(self, number: Array) -> engine.Entering:
        return engine.entering(self.scenario, self.words, self.timing[0], self.timing[2], number, samples=self._samples)

    @property
    def _samples(self) -> int | None:
        return self.timing[1] * self.timing[2] if self.design.device.effects else None

    def _sample(self, loop: ClosedLoop, carry: Carry, entering: engine.Entering) -> Carry:
        return engine.one_sample(loop, self.timing[0], self.recorder, carry, entering)

    def _judged(self, carry: Carry) -> Array:
        return jnp.broadcast_to(self.judge(carry[1]), self.words[0].shape)

    def _unflat(self, real: Array, rest: Any) -> Carry:
        lanes = self.words[0].shape
        like = jax.eval_shape(lambda: engine.beginning(self.design, self.recorder, lanes))
        shapes, tree = jax.tree.flatten(eqx.filter(like, lambda leaf: jnp.issubdtype(leaf.dtype, jnp.inexact)))
        # Derivatives of `split` are put together by one concatenation, those of slices by adding padded arrays.
        parts = jax.lax.split(real, [math.prod(leaf.shape[:-1]) for leaf in shapes])
        parts = [part.reshape(leaf.shape) for part, leaf in zip(parts, shapes, strict=True)]
        return eqx.combine(jax.tree.unflatten(tree, parts), rest)


def _apart(number: Int[Array, ""]) -> Int[Array, ""]:
    """`number`, through a sort. XLA on CPU makes a loop with all loops inside it one function, which takes time as the
    square of its length to compile; not a loop with a sort."""
    return jax.lax.sort(jnp.stack([number, number + 1]))[0]


def _flat(state: Any) -> Flat:
    real, rest = eqx.partition(state, eqx.is_inexact_array)
    return jnp.concatenate([leaf.reshape(-1, leaf.shape[-1]) for leaf in jax.tree.leaves(real)]), rest
