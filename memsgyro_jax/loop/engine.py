"""Runs a closed loop over time for one die or a batch of dies: one compiled scan, whatever is recorded of it.

Time is scanned in blocks. At the end of a block a die that was lost is put back to the block's start and stays there,
so that no NaN outlives a block; checking every sample would cost a tenth of the run time.
"""

import abc
import math
from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from memsgyro_jax.device.gyro import Scalar

from . import noise
from .loop import ClosedLoop, LoopState, Sample
from .observers.base import Clock
from .scenario import Conditions, Scenario


Memory = TypeVar("Memory")
Output = TypeVar("Output")

MEASUREMENT_STREAM = 0  # streams of `noise.normal_pair`; 1 and 2 are those of random walks and of blocks
FORCE_STREAMS = (3, 4)
FLICKER_STREAM = 16  # and on, one for each state


class AbstractRecorder(eqx.Module, Generic[Memory, Output]):
    """What is kept of a run: a running memory per sample and an output per block."""

    @abc.abstractmethod
    def init(self) -> Memory:
        """The memory before the first sample."""

    @abc.abstractmethod
    def sample(self, memory: Memory, sample: Sample) -> Memory:
        """The memory after one more sample."""

    @abc.abstractmethod
    def block(self, memory: Memory) -> tuple[Memory, Output]:
        """The memory and the output at the end of a block."""


class Run(NamedTuple):
    """The end of a run: state, recorder's memory, its outputs stacked over blocks, and which dies were never lost."""

    state: LoopState
    memory: Any
    outputs: Any
    alive: Bool[Array, "*lanes"]
    blocks_alive: Int[Array, "*lanes"]


class Since(NamedTuple):
    """Where a run goes on: the end of what was run so far, its blocks, and the samples of the whole."""

    end: Run
    blocks: Int[Array, ""] | int
    samples: Int[Array, ""] | int


def unbegun(
    loop: ClosedLoop,
    recorder: AbstractRecorder,
    lanes: tuple[int, ...],
    design: ClosedLoop | None = None,
) -> Run:
    """A run of no blocks yet."""
    state, memory = beginning(loop, recorder, lanes, design)
    return Run(state, memory, None, jnp.ones(lanes, bool), jnp.zeros(lanes, int))


def run(
    loop: ClosedLoop,
    scenario: Scenario,
    words: tuple[Array, Array],
    period: Scalar,
    blocks: int,
    block: int,
    recorder: AbstractRecorder,
    design: ClosedLoop | None = None,
    since: "Since | None" = None,
) -> Run:
    """Run `blocks` blocks of `block` samples with noise keyed by `words` (see `noise.die_words`).

    The shape of `words` is that of the batch of dies; leaves of `loop` and `scenario` may have it as trailing axes. A
    batched loop needs its unbatched `design` beside it, which tells component axes from dies. With `since` the run goes
    on where another has ended.
    """

    def sample(carry, entering):
        return one_sample(loop, period, recorder, carry, entering), None

    def one_block(carry, number):
        state, memory, alive, survived = carry
        number = number + first
        (new_state, new_memory), _ = jax.lax.scan(
            sample, (state, memory), entering(scenario, words, period, block, number, whole, warm, flickers)
        )
        new_memory, output = recorder.block(new_memory)
        alive = alive & healthy(loop, new_state)
        keep = lambda new, old: jnp.where(alive, new, old)  # noqa: E731
        kept = jax.tree.map(keep, (new_state, new_memory), (state, memory))
        return (*kept, alive, survived + alive), output

    begun, first, samples = since or Since(unbegun(loop, recorder, words[0].shape, design), 0, blocks * block)
    whole = samples if loop.device.effects else None
    warm = loop.device.temperature is not None
    flickers = flickers_of(loop)
    start = (begun.state, begun.memory, begun.alive, begun.blocks_alive)
    (state, memory, alive, survived), outputs = scan_in_groups(one_block, start, blocks)
    return Run(state, memory, outputs, alive, survived)


class Entering(NamedTuple):
    """What enters the loop from outside at a sample: its number, the conditions, and standard normal numbers, those of
    the read-out and, where the device knows its temperature, the four of the motion, and where the read-out flickers, a
    pair for each state.
    """

    index: Int[Array, ""]
    conditions: Conditions
    draws: tuple[Array, Array]
    shaking: tuple[Array, ...] | None
    flicker: tuple[tuple[Array, Array], ...] | None = None


def entering(
    scenario: Scenario,
    words: tuple[Array, Array],
    period: Scalar,
    block: int,
    number: Array,
    samples: int | None = None,
    warm: bool = False,
    flickers: int = 0,
) -> Entering:
    """What enters at each of the `block` samples of block `number`, along a leading axis; `samples` are those of the
    whole run, where effects must know what part of it has passed; `warm` is a device that knows its temperature,
    `flickers` are the states of the read-out's flicker.
    """
    index = number * block + jnp.arange(block)
    conditions = jax.vmap(scenario.at)((index + 0.5) * period)
    if samples is not None:
        conditions = eqx.tree_at(
            lambda c: c.progress, conditions, (index + 0.5) / samples, is_leaf=lambda leaf: leaf is None
        )
    draws = jax.vmap(lambda i: noise.normal_pair(words, i, MEASUREMENT_STREAM))(index)
    shaking = None
    if warm:
        pairs = [jax.vmap(lambda i, s=stream: noise.normal_pair(words, i, s))(index) for stream in FORCE_STREAMS]
        shaking = (*pairs[0], *pairs[1])
    states = range(FLICKER_STREAM, FLICKER_STREAM + flickers)
    flicker = tuple(jax.vmap(lambda i, s=stream: noise.normal_pair(words, i, s))(index) for stream in states) or None
    return Entering(index, conditions, draws, shaking, flicker)


def flickers_of(loop: ClosedLoop) -> int:
    """How many states the flicker of a loop's read-out has."""
    flicker = loop.readout.flicker
    return 0 if flicker is None else len(flicker.corners)


def one_sample(
    loop: ClosedLoop, period: Scalar, recorder: AbstractRecorder, carry: tuple[LoopState, Any], entering: Entering
) -> tuple[LoopState, Any]:
    """State and recorder's memory one sample later."""
    state, memory = carry
    clock = Clock(entering.index * period, entering.index, period)
    flicker = () if entering.flicker is None else (entering.flicker,)
    state, taken = loop.step(state, entering.conditions, entering.draws, clock, entering.shaking, *flicker)
    return state, recorder.sample(memory, taken)


def beginning(
    loop: ClosedLoop, recorder: AbstractRecorder, lanes: tuple[int, ...], design: ClosedLoop | None = None
) -> tuple[LoopState, Any]:
    """State and recorder's memory before the first sample, repeated for the dies."""
    ranks = jax.eval_shape(lambda: ((design or loop).init(), recorder.init()))
    return jax.tree.map(
        lambda value, like: over_dies(value, len(like.shape), lanes), (loop.init(), recorder.init()), ranks
    )


_FLAT = 256  # blocks up to which one loop stacks the outputs


def scan_in_groups(body: Callable, start: tuple, count: int) -> tuple[tuple, Any]:
    """`jax.lax.scan` of `body` over 0 … count-1, as a loop of loops when there are many.

    With multi-output fusion XLA copies the stacked outputs at every turn instead of writing a row, so that one loop
    costs count²: 100 000 rows took minutes. Two loops cost count^1.5.
    """
    group = 1 if count <= _FLAT else max(n for n in range(1, math.isqrt(count) + 1) if count % n == 0)
    if group == 1:
        return jax.lax.scan(body, start, jnp.arange(count))
    end, stacked = jax.lax.scan(
        lambda carry, numbers: jax.lax.scan(body, carry, numbers), start, jnp.arange(count).reshape(-1, group)
    )
    return end, jax.tree.map(lambda rows: rows.reshape(count, *rows.shape[2:]), stacked)


def healthy(loop: ClosedLoop, state: LoopState) -> Bool[Array, "*lanes"]:
    """Whether truth and estimate are finite and the mass is within its travel."""
    estimate = loop.estimate(state)
    numbers = (*state.motion, *estimate.motion, *estimate.theta, *estimate.offset)
    within = (jnp.abs(state.motion[0]) <= loop.travel) & (jnp.abs(state.motion[1]) <= loop.travel)
    if loop.filter is not None:
        numbers = (*numbers, loop.rate(state))
    numbers = (*numbers, *state.own)
    if estimate.rate_variance is not None:
        within = within & (estimate.rate_variance >= 0.0)
    return within & jnp.isfinite(sum(numbers))


def over_dies(value: Array, rank: int, lanes: tuple[int, ...]) -> Array:
    """`value`, of `rank` component axes, repeated for every die unless it already differs between them."""
    value = jnp.asarray(value)
    if value.ndim == rank:
        value = value.reshape(value.shape + (1,) * len(lanes))
    return jnp.broadcast_to(value, value.shape[:rank] + lanes)
