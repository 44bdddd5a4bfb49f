"""A run in blocks: its first samples one by one, then block after block in closed form."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.device.gyro import MotionModel, Scalar
from memsgyro_jax.device.propagate import AbstractDiscretisation

from .. import engine, noise
from ..controllers.base import AbstractLinearController
from ..loop import ClosedLoop, FilterState, LoopState, Sample
from ..observers.base import AbstractBlockObserver, Clock, Innovation
from ..own_parts import inner, overridden
from ..readout import AbstractLinearReadout
from ..scenario import Constant, Scenario
from . import basis
from .advance import Facts, advanced
from .algebra import matrix_over_lanes, over_lanes
from .law import Lanes, same_frequency, strikes_modes, tones_of
from .length import lengths, pace_of, renewals
from .maps import Maps, maps_of
from .true_maps import TrueMaps, ramp_of, true_maps_of


BLOCK_STREAM = 2  # of `noise.normal_pair`


def hindrances(loop: ClosedLoop) -> tuple[str, ...]:
    """What keeps `loop` from being advanced by blocks, in words; nothing where it can."""
    found = [f"the device has the effect {effect.label}" for effect in loop.device.effects]
    if loop.device.temperature is not None:
        found.append("the device's Brownian force acts between samples")
    for part, kind, of_samples in (
        (loop.readout, AbstractLinearReadout, ("measure",)),
        (loop.observer, AbstractBlockObserver, ("update",)),
        (loop.controller, AbstractLinearController, ("init", "command", "measured", "output")),
        (loop.discretisation, AbstractDiscretisation, ("advance",)),
        (loop, ClosedLoop, ("step",)),
    ):
        if not isinstance(part, kind):
            found.append(f"{type(part).__name__} is no {kind.__name__}")
        elif own := getattr(part, "hindrance", None) or overridden(inner(part), *of_samples):
            found.append(own)
    return tuple(found)


def prepared(loop: ClosedLoop, apart: bool = False) -> tuple[ClosedLoop, tuple[str, ...]]:
    """The loop as it can be run, without blocks where a part cannot, and a sentence on that, or on what blocks change.
    Tones of one frequency are taken as one, unless they are to be kept `apart`, since it will change.
    """
    if loop.blocks is None:
        return loop, ()
    reasons = hindrances(loop)
    if reasons:
        return replace(loop, blocks=None), (f"the loop runs sample by sample, not in blocks: {'; '.join(reasons)}.",)
    blocks = loop.blocks
    start = pace_of(loop.device).start if blocks.start is None else blocks.start
    alike = same_frequency(loop.controller, apart) if blocks.alike is None else blocks.alike
    ramps = strikes_modes(loop.controller, loop.device) if blocks.ramps is None else blocks.ramps
    ready = replace(loop, blocks=replace(blocks, start=start, alike=alike, ramps=ramps))
    return ready, _approximations(ready, blocks.length)


def _approximations(loop: ClosedLoop, length: int) -> tuple[str, ...]:
    """What a filter in blocks of `length` takes otherwise than sample by sample, in words."""
    constant = taken_as_constant(loop)
    if not constant:
        return ()
    late = f"it follows up to {length // 2} samples later, and claims too little where the walk is fast"
    return (f"{constant}: {late} (shorter blocks, or samples, do not).",)


def taken_as_constant(loop: ClosedLoop) -> str:
    """What a filter in blocks holds constant within them although it walks, in words; empty where there is nothing."""
    observer: Any = loop.observer
    if loop.blocks is None:
        return ""
    names, walks = observer.states[4:], observer.walk()[4:]
    pairs = zip((*names, *("what moves them",) * (len(walks) - len(names))), walks, strict=True)
    walking = [name for name, intensity in pairs if is_concrete(intensity) and np.any(np.asarray(intensity) > 0.0)]
    of = f"in blocks of {loop.blocks.length} samples the filter takes what walks ({', '.join(walking)}) as constant"
    return of if walking else ""


def statistics(loop: ClosedLoop) -> int:
    """How many a block has of each channel."""
    controller: Any = loop.controller
    blocks: Any = loop.blocks
    return 1 + 2 * (2 + len(blocks.alike) + len(controller.frequencies) + 2 * bool(blocks.ramps))


def run_in_blocks(
    loop: ClosedLoop, scenario: Scenario, words: tuple[Array, Array], period: Scalar, start: tuple[int, int],
    sizes: Int[np.ndarray, "windows stride"], recorder: engine.AbstractRecorder, design: ClosedLoop | None = None,
) -> engine.Run:  # fmt: skip
    """Run `start` (windows, samples of each) sample by sample and then windows of blocks of `sizes` samples, powers of
    two, or none.

    As `engine.run`, but that the recorder takes a block for a sample: at its end, with the clean volts, and with one
    innovation for all of the block's, whose square and the logarithm of whose variance are their means; the period of
    its clock is the block's length.
    """
    begun = engine.run(loop, scenario, words, period, *start, recorder, design)
    if not sizes.size:
        return begun
    flat = sizes.ravel()
    course = BlockCourse(loop, scenario, words, period, int(flat.max(initial=1)))
    entering = jax.tree.map(jnp.asarray, crossing(loop, scenario, start[0] * start[1], sizes))

    def one(carry, span):
        state, memory, maps = carry
        state, sample = course.block(state, maps, span)
        return state, recorder.sample(memory, sample), maps

    def block(carry, entering):
        state, memory, maps = carry
        span, renewed = entering
        maps = jax.lax.cond(renewed, lambda: course.maps(state, span), lambda: maps)
        carry = state, memory, maps
        if flat.all():
            return one(carry, span), None
        there = jnp.asarray(flat > 0)[span.number]
        return jax.lax.cond(there, lambda: one(carry, span), lambda: carry), None

    def window(carry, number):
        state, memory, maps, alive, survived = carry
        inside = jax.tree.map(lambda parts: parts[number], entering)
        (new_state, new_memory, maps), _ = jax.lax.scan(block, (state, memory, maps), inside)
        new_memory, output = recorder.block(new_memory)
        alive = alive & engine.healthy(loop, new_state)
        keep = lambda new, old: jnp.where(alive, new, old)  # noqa: E731
        kept = jax.tree.map(keep, (new_state, new_memory), (state, memory))
        return (*kept, maps, alive, survived + alive), output

    state = course.settled_in(begun.state)
    carry = (state, begun.memory, course.no_maps(begun.state), begun.alive, begun.blocks_alive)
    (state, memory, _, alive, survived), outputs = engine.scan_in_groups(window, carry, len(sizes))
    joined = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), begun.outputs, outputs)
    return engine.Run(state, memory, joined, alive, survived)


def sizes_of(loop: ClosedLoop, samples: int) -> tuple[int, tuple[int, ...]]:
    """How many samples of a run go one by one, and the sizes of the blocks behind them."""
    blocks = loop.blocks
    if blocks is None:
        return samples, ()
    start, lead = blocks.first(samples)
    rest = (samples - start - lead) // blocks.length
    return start, tuple(lengths(start, lead, blocks.length, 1, rest).ravel().tolist())


class Span(NamedTuple):
    """Where a block lies: its number, the samples before it, and how often one sample is doubled to it."""

    number: Int[Array | np.ndarray, "*blocks"]
    before: Int[Array | np.ndarray, "*blocks"]
    doublings: Int[Array | np.ndarray, "*blocks"]

    @property
    def length(self) -> Int[Array, ""]:
        """Samples."""
        return 1 << self.doublings


def crossing(
    loop: ClosedLoop, scenario: Scenario, first: int, sizes: Int[np.ndarray, "windows stride"]
) -> tuple["Span", Bool[np.ndarray, "windows stride"]]:
    """Where blocks of `sizes` samples lie behind the `first` samples, and before which of them maps are made."""
    flat = sizes.ravel()
    before = (first + np.cumsum(flat) - flat).reshape(sizes.shape)
    numbers = np.arange(flat.size).reshape(sizes.shape)
    doublings = np.log2(np.maximum(sizes, 1)).astype(int)
    return Span(numbers, before, doublings), renewals(sizes, _factor(loop, scenario))


def _factor(loop: ClosedLoop, scenario: Scenario) -> float:
    """By how much blocks may grow in number until maps are made anew: not at all where what acts on the device may
    change from block to block, told by the kinds of its profiles.
    """
    acting = (scenario.rate, *scenario.damping_change, *scenario.cross_rate, *scenario.acceleration)
    return pace_of(loop.device).factor if all(isinstance(profile, Constant) for profile in acting) else 1.0


class BlockCourse(eqx.Module):
    """What does not change from block to block, and how each is crossed; `backwards` where a derivative goes so."""

    loop: ClosedLoop
    scenario: Scenario
    words: tuple[Array, Array]
    period: Scalar
    longest: int = eqx.field(static=True)
    backwards: bool = eqx.field(static=True, default=False)

    @property
    def lanes(self) -> Lanes:
        """The dies; a single one is a row of one."""
        return self.words[0].shape or (1,)

    def _row(self, tree: Any) -> Any:
        return tree if self.words[0].shape else jax.tree.map(lambda leaf: leaf[..., None], tree)

    def _single(self, tree: Any) -> Any:
        return tree if self.words[0].shape else jax.tree.map(lambda leaf: leaf[..., 0], tree)

    @property
    def blocks(self) -> Any:  # never None here
        """How the loop is advanced."""
        return self.loop.blocks

    @property
    def observer(self) -> Any:  # an `AbstractBlockObserver` here
        """The filter."""
        return self.loop.observer

    def settled_in(self, state: LoopState) -> LoopState:
        """`state` with every leaf as a block leaves it."""
        observer = self.observer
        one = jnp.ones(self.words[0].shape)
        believed = observer.believed(state.observer)
        told = observer.believing(state.observer, believed, Innovation((one, one), (one, one)))
        return state._replace(observer=told)

    def no_maps(self, state: LoopState) -> Maps:
        """Zeros in their place before the first are made."""
        shapes = jax.eval_shape(lambda: self.maps(state, Span(*(jnp.zeros((), int),) * 3)))
        return jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes)

    def maps(self, state: LoopState, span: Span) -> Maps:
        """Linearised where the filter is; the device in the middle of the block."""
        loop, blocks = self.loop, self.blocks
        middle = self.scenario.at((span.before + 0.5 * span.length) * self.period)
        theta = loop.observer.estimate(state.observer).theta
        doublings = span.doublings, self.longest.bit_length() - 1
        dynamics = loop.device.dynamics(middle.inertial)
        maps = maps_of(loop, dynamics, theta, blocks.alike, self.period, doublings, self.lanes, self.backwards)
        if isinstance(self.scenario.rate, Constant):
            return maps
        return maps._replace(ramp=ramp_of(loop, dynamics, theta, maps, self.period, doublings, self.lanes))

    def true_maps(self, state: LoopState, model: MotionModel, span: Span) -> TrueMaps:
        """How the truth could be otherwise, in the coefficients of `model`."""
        loop = self.loop
        middle = self.scenario.at((span.before + 0.5 * span.length) * self.period)
        theta = loop.observer.estimate(state.observer).theta
        doublings = span.doublings, self.longest.bit_length() - 1
        dynamics = loop.device.dynamics(middle.inertial)
        return true_maps_of(loop, model, dynamics, theta, self.period, doublings, self.lanes)

    def block(self, state: LoopState, maps: Maps, span: Span) -> tuple[LoopState, Sample]:
        """The state a block later, and what can be recorded there."""
        loop, lanes = self.loop, self.lanes
        observer = self.observer
        before, elapsed = span.before, span.length * self.period
        middle = before * self.period + 0.5 * elapsed
        drift = self.scenario.at(middle).offset_drift
        facts = Facts(
            tones=self.tones(before * self.period),
            offset=over_lanes(loop.readout.clean((0.0,) * 4, drift), lanes),
            fixed=over_lanes(observer.prior.offset, lanes),
            normal=self._normal(maps, span),
            noise=over_lanes(loop.readout.noise_std(self.period), lanes) ** 2,
            expected=over_lanes(observer.variance(Clock(middle, before, self.period)), lanes),
            walk=over_lanes(observer.walk()[4:], lanes) * elapsed,
            moves=self._moves(elapsed),
            slope=over_lanes(self._slope(span), lanes),
        )
        motion, believed = self._row((jnp.stack(state.motion), observer.believed(state.observer)))
        motion, believed, read = self._single(advanced(motion, believed, maps, facts, observer.with_offsets))
        told = observer.believing(state.observer, believed, read)
        return self._ended(state._replace(motion=tuple(motion), observer=told), span)

    def _slope(self, span: Span) -> Scalar:
        """Of the true rate, from the first sample of a block to its last."""
        first, last = (span.before + 0.5) * self.period, (span.before + span.length - 0.5) * self.period
        if isinstance(self.scenario.rate, Constant):
            return 0.0 * first
        rise = self.scenario.rate.value(last) - self.scenario.rate.value(first)
        return rise / jnp.maximum(last - first, self.period)  # a single sample has none

    def _moves(self, elapsed: Scalar) -> Array | None:
        """What the constants of the filter move by in a block, for a unit of each."""
        moves = self.observer.moves()
        return None if moves is None else matrix_over_lanes(moves, self.lanes) * elapsed

    def _ended(self, state: LoopState, span: Span) -> tuple[LoopState, Sample]:
        loop, period, count = self.loop, self.period, span.before + span.length
        clock = Clock(count * period, count, period)
        estimate, output = loop.observer.estimate(state.observer), None
        if loop.filter is not None and state.output is not None:
            output = FilterState(*loop.filter.step(state.output.held, estimate.rate, span.length * period))
        rate = estimate.rate if output is None else output.rate
        conditions = self.scenario.at((count - 0.5) * period)
        force = loop.controller.command((), estimate, clock)[0]
        volts = loop.readout.clean(state.motion, conditions.offset_drift)
        taken = clock._replace(period=span.length * period)
        return state._replace(output=output), Sample(taken, conditions, state.motion, volts, force, estimate, rate)

    def tones(self, time: Scalar) -> Float[Array, "2·tones lanes"]:
        """Sines and cosines of the groups of tones at `time`."""
        tones, entries = tones_of(self.loop.controller), []
        for group in self.blocks.alike:
            angle = over_lanes(2.0 * jnp.pi * tones[group[0]].frequency * time, self.lanes)
            entries += [jnp.sin(angle), jnp.cos(angle)]
        return jnp.stack(entries) if entries else jnp.zeros((0, *self.lanes))

    def _normal(self, maps: Maps, span: Span) -> Array:
        """Standard normal numbers for the statistics of a block."""
        size, draw = len(maps.ones), _drawer(self._row(self.words))
        if not self.blocks.projected:
            return draw(span.number * size + jnp.arange(size), BLOCK_STREAM)
        places = jnp.arange(self.longest)
        drawn = jnp.where(
            (places < span.length)[:, None, None], draw(span.before + places, engine.MEASUREMENT_STREAM), 0.0
        )
        return basis.projected(maps.angles, maps.whiten, drawn)


def _drawer(words: tuple[Array, Array]) -> Callable[[Array, int], Array]:
    return lambda counts, stream: jnp.stack(jax.vmap(lambda i: noise.normal_pair(words, i, stream))(counts), axis=1)
