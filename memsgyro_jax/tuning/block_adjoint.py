"""The losses of dies in blocks and their derivatives: the first samples as sample by sample (`adjoint`), then the state
before every block is kept, and the way back crosses one after the other.

Blocks share maps. These are made again from the state before the first block that takes them, and what all these
blocks pull at them adds up, to be handed on to that state.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from memsgyro_jax.loop import engine
from memsgyro_jax.loop.blocks.run import BlockCourse, Span, crossing, run_in_blocks

from .adjoint import Carry, Flat, Judgement, Kept, Numbers, Portion, apart


class KeptInBlocks(NamedTuple):
    """What the first samples left, the state before every block, and at the end."""

    begun: Kept
    starts: Flat
    end: Flat


class PortionInBlocks(Portion):
    """Dies under a loss whose loop goes in blocks: `sizes` samples in each, after those of `timing`."""

    sizes: tuple[int, ...] = eqx.field(static=True, default=())

    def through(self, numbers: Numbers) -> Judgement:
        """Losses by running through."""
        loop, timing = self._tuned(self._own(numbers)), self.timing
        start = timing.blocks, timing.block
        sizes = np.reshape(self.sizes, (-1, 1))
        done = run_in_blocks(loop, self.scenario, self.words, timing.period, start, sizes, self.loss, self.design[0])
        return self._judgement(done.memory, done.alive, loop)

    def keeping(self, numbers: Numbers) -> tuple[Judgement, KeptInBlocks]:
        """Losses, and what the way back needs."""
        own = self._own(numbers)
        loop, course = self._tuned(own), self._course(own, backwards=False)
        alive, begun = self._kept(own)
        state, memory = self._unflat(*begun.end)
        state = course.settled_in(state)

        def forward(carry, crossed):
            (before, maps, alive), (span, renewed) = carry, crossed
            maps = jax.lax.cond(renewed, lambda: course.maps(before[0], span), lambda: maps)
            after = self._block(course, before, maps, span)
            return (after, maps, alive & engine.healthy(loop, after[0])), self._flat(before)

        begin = ((state, memory), course.no_maps(state), alive)
        (end, _, alive), starts = jax.lax.scan(forward, begin, jax.tree.map(jnp.asarray, self._crossed()))
        return self._judgement(end[1], alive, loop), KeptInBlocks(begun, starts, self._flat(end))

    def back(self, numbers: Numbers, kept: Any) -> Numbers:
        """The slopes, backwards; those of a lost die mean nothing."""
        own, chain = jax.vjp(self._own, numbers)

        spans, renewed = self._crossed()
        firsts = np.flatnonzero(renewed)
        shared = jnp.asarray(firsts), jnp.asarray(np.diff(firsts, append=len(renewed)))

        def before(place):
            span, (real, rest) = jax.tree.map(lambda rows: jnp.asarray(rows)[place], (spans, kept.starts))
            return span._replace(number=apart(span.number)), real, rest

        def back(carry, taken):
            first, count = taken
            span, real, rest = before(first)
            maps, made = jax.vjp(lambda own, real: self._course(own).maps(self._unflat(real, rest)[0], span), own, real)

            def one(number, pulls):
                pull, slopes, at_maps = pulls
                span, real, rest = before(first + count - 1 - number)

                def block(own, real, maps):
                    return self._flat(self._block(self._course(own), self._unflat(real, rest), maps, span))

                _, turned, _ = jax.vjp(block, own, real, maps, has_aux=True)
                more, pull, there = turned(pull)
                return pull, slopes + more, jax.tree.map(jnp.add, at_maps, there)

            pull, slopes, at_maps = jax.lax.fori_loop(0, count, one, (*carry, jax.tree.map(jnp.zeros_like, maps)))
            more, further = made(at_maps)
            return (pull + further, slopes + more), None

        begun, (real, rest) = kept.begun, kept.begun.end
        (pull, slopes), _ = jax.lax.scan(back, self._pulled(own, kept.end), shared, reverse=True)

        def settled(own, real):
            state, memory = self._unflat(real, rest)
            return self._flat((self._course(own).settled_in(state), memory))[0]

        more, pull = jax.vjp(settled, own, real)[1](pull)
        return chain(self._back(own, begun, pull, slopes + more))[0]

    def _course(self, own: Numbers, backwards: bool = True) -> BlockCourse:
        return BlockCourse(self._tuned(own), self.scenario, self.words, self.timing.period, max(self.sizes), backwards)

    def _block(self, course: BlockCourse, carry: Carry, maps: Any, span: Span) -> Carry:
        state, sample = course.block(carry[0], maps, span)
        return state, self.loss.sample(carry[1], sample)

    def _crossed(self) -> tuple[Span, Bool[np.ndarray, " blocks"]]:
        """Where the blocks lie, and before which of them maps are made."""
        return crossing(*self.design, self.timing.blocks * self.timing.block, np.asarray(self.sizes))
