"""The losses of dies in blocks and their derivatives: the first samples as sample by sample (`adjoint`), then the state
before every block is kept, and the way back crosses one after the other.

Blocks share maps. Behind the last block that takes them they are made again, what all these blocks pull at them adds
up, and before the first it is handed on to the state that they were made of.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from memsgyro_jax.loop import engine
from memsgyro_jax.loop.blocks.length import lengths
from memsgyro_jax.loop.blocks.run import BlockCourse, Span, crossing, run_in_blocks
from memsgyro_jax.loop.loop import ClosedLoop

from .adjoint import Carry, Flat, Judgement, Kept, Numbers, Portion, apart, flat_of


class KeptInBlocks(NamedTuple):
    """What the first samples left, the state before every block, and at the end."""

    begun: Kept
    starts: Flat
    end: Flat


class _Crossed(NamedTuple):
    """Of each block: where it lies, whether maps are made before it, whether others are made after it, and before which
    block its own were.
    """

    span: Span
    renewed: Bool[Array | np.ndarray, "*blocks"]
    last: Bool[Array | np.ndarray, "*blocks"]
    source: Int[Array | np.ndarray, "*blocks"]


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
        loop, course = self._tuned(own), self._course(own)
        alive, begun = self._kept(own)
        state, memory = self._unflat(*begun.end)
        state = course.settled_in(state)

        def forward(carry, crossed):
            before, maps, alive = carry
            maps = jax.lax.cond(crossed.renewed, lambda: course.maps(before[0], crossed.span), lambda: maps)
            after = self._block(course, before, maps, crossed.span)
            return (after, maps, alive & engine.healthy(loop, after[0])), flat_of(before)

        begin = ((state, memory), course.no_maps(state), alive)
        (end, _, alive), starts = jax.lax.scan(forward, begin, self._crossed())
        return self._judgement(end[1], alive, loop), KeptInBlocks(begun, starts, flat_of(end))

    def back(self, numbers: Numbers, kept: Any) -> Numbers:
        """The slopes, backwards; those of a lost die mean nothing."""
        own, chain = jax.vjp(self._own, numbers)

        def made(own, real, rest, span):
            return self._course(own).maps(self._unflat(real, rest)[0], span)

        def back(carry, was):
            pull, slopes, at_maps, maps = carry
            crossed, (real, rest) = was
            span = crossed.span._replace(number=apart(crossed.span.number))
            source, before = jax.tree.map(lambda rows: rows[crossed.source], (self._crossed().span, kept.starts))
            maps = jax.lax.cond(crossed.last, lambda: made(own, before[0], before[1], source), lambda: maps)

            def block(own, real, maps):
                return flat_of(self._block(self._course(own), self._unflat(real, rest), maps, span))

            _, turned, _ = jax.vjp(block, own, real, maps, has_aux=True)
            more, pull, there = turned(pull)
            slopes, at_maps = slopes + more, jax.tree.map(jnp.add, at_maps, there)

            def handed_on():
                _, turned = jax.vjp(lambda own, real: made(own, real, rest, span), own, real)
                more, further = turned(at_maps)
                return pull + further, slopes + more, jax.tree.map(jnp.zeros_like, at_maps)

            carry = jax.lax.cond(crossed.renewed, handed_on, lambda: (pull, slopes, at_maps))
            return (*carry, maps), None

        begun, (real, rest) = kept.begun, kept.begun.end
        nothing = self._course(own).no_maps(self._unflat(real, rest)[0])
        start = (*self._pulled(own, kept.end), nothing, nothing)
        (pull, slopes, _, _), _ = jax.lax.scan(back, start, (self._crossed(), kept.starts), reverse=True)

        def settled(own, real):
            state, memory = self._unflat(real, rest)
            return flat_of((self._course(own).settled_in(state), memory))[0]

        more, pull = jax.vjp(settled, own, real)[1](pull)
        return chain(self._back(own, begun, pull, slopes + more))[0]

    def _course(self, own: Numbers) -> BlockCourse:
        return BlockCourse(self._tuned(own), self.scenario, self.words, self.timing.period, max(self.sizes))

    def _block(self, course: BlockCourse, carry: Carry, maps: Any, span: Span) -> Carry:
        state, sample = course.block(carry[0], maps, span)
        return state, self.loss.sample(carry[1], sample)

    def _crossed(self) -> _Crossed:
        sizes = np.asarray(self.sizes)
        span, renewed = crossing(*self.design, self.timing.blocks * self.timing.block, sizes)
        source = np.maximum.accumulate(np.where(renewed, np.arange(len(renewed)), 0))
        return jax.tree.map(jnp.asarray, _Crossed(span, renewed, np.append(renewed[1:], True), source))


def sizes_of(loop: ClosedLoop, samples: int) -> tuple[int, tuple[int, ...]]:
    """How many samples of a run go one by one, and the sizes of the blocks behind them."""
    blocks = loop.blocks
    if blocks is None:
        return samples, ()
    start, lead = blocks.first(samples)
    rest = (samples - start - lead) // blocks.length
    return start, tuple(lengths(start, lead, blocks.length, 1, rest).ravel().tolist())
