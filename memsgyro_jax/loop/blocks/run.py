"""A run in blocks: its first samples one by one, then block after block in closed form."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from memsgyro_jax.device.gyro import DualMassGyro, Scalar

from .. import engine, noise
from ..controllers.base import AbstractLinearController
from ..loop import ClosedLoop, FilterState, LoopState, Sample
from ..observers.base import AbstractBlockObserver, Clock, Innovation
from ..readout import AbstractLinearReadout
from ..scenario import Constant, Scenario
from . import basis
from .advance import Facts, advanced
from .algebra import over_lanes
from .law import Lanes, same_frequency, tones_of
from .length import renewals
from .maps import Maps, maps_of


BLOCK_STREAM = 2  # of `noise.normal_pair`


def hindrances(loop: ClosedLoop) -> tuple[str, ...]:
    """What keeps `loop` from being advanced by blocks, in words; nothing where it can."""
    found = [f"the device has the effect {effect.label}" for effect in loop.device.effects]
    if isinstance(loop.device, DualMassGyro):
        # With the same noise its rate ended 6 % of the claimed deviation apart, where one mass comes within 1 %.
        found.append("a device of two masses is not advanced by blocks to the accuracy of one mass")
    if loop.device.temperature is not None:
        found.append("the device's Brownian force acts between samples")
    for part, kind in (
        (loop.readout, AbstractLinearReadout),
        (loop.observer, AbstractBlockObserver),
        (loop.controller, AbstractLinearController),
    ):
        if not isinstance(part, kind):
            found.append(f"{type(part).__name__} is no {kind.__name__}")
        elif own := getattr(part, "hindrance", None):
            found.append(own)
    return tuple(found)


def prepared(loop: ClosedLoop, apart: bool = False) -> tuple[ClosedLoop, tuple[str, ...]]:
    """The loop as it can be run, without blocks where a part cannot, and a sentence on that. Tones of one frequency are
    taken as one, unless they are to be kept `apart`, since it will change.
    """
    if loop.blocks is None:
        return loop, ()
    reasons = hindrances(loop)
    if reasons:
        return replace(loop, blocks=None), (f"the loop runs sample by sample, not in blocks: {'; '.join(reasons)}.",)
    if loop.blocks.alike is not None:
        return loop, ()
    return replace(loop, blocks=replace(loop.blocks, alike=same_frequency(loop.controller, apart))), ()


def statistics(loop: ClosedLoop) -> int:
    """How many a block has of each channel."""
    controller: Any = loop.controller
    blocks: Any = loop.blocks
    return 1 + 2 * (2 + len(blocks.alike) + len(controller.frequencies))


def run_in_blocks(
    loop: ClosedLoop, scenario: Scenario, words: tuple[Array, Array], period: Scalar, start: tuple[int, int],
    windows: tuple[int, int], recorder: engine.AbstractRecorder, design: ClosedLoop | None = None,
) -> engine.Run:  # fmt: skip
    """Run `start` (windows, samples of each) sample by sample and then `windows` (windows, blocks of each) in blocks.

    As `engine.run`, but that the recorder takes a block for a sample: at its end, with the clean volts, and with the
    root mean square of the block's normalised innovations (of variance 1) for an innovation.
    """
    begun = engine.run(loop, scenario, words, period, *start, recorder, design)
    course = _Course(loop, scenario, words, period, start[0] * start[1])
    fresh = jnp.asarray(renewals(windows[0] * windows[1], _moves(scenario))).reshape(windows)

    def block(carry, entering):
        state, memory, maps = carry
        number, renewed = entering
        maps = jax.lax.cond(renewed, lambda: course.maps(state, number), lambda: maps)
        state, sample = course.block(state, maps, number)
        return (state, recorder.sample(memory, sample), maps), None

    def window(carry, number):
        state, memory, maps, alive, survived = carry
        numbers = number * windows[1] + jnp.arange(windows[1])
        (new_state, new_memory, maps), _ = jax.lax.scan(block, (state, memory, maps), (numbers, fresh[number]))
        new_memory, output = recorder.block(new_memory)
        alive = alive & engine.healthy(loop, new_state)
        keep = lambda new, old: jnp.where(alive, new, old)  # noqa: E731
        kept = jax.tree.map(keep, (new_state, new_memory), (state, memory))
        return (*kept, maps, alive, survived + alive), output

    shapes = jax.eval_shape(lambda: course.maps(begun.state, jnp.zeros((), int)))
    empty = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes)
    state = course.settled_in(begun.state)
    carry = (state, begun.memory, empty, begun.alive, begun.blocks_alive)
    (state, memory, _, alive, survived), outputs = engine.scan_in_groups(window, carry, windows[0])
    joined = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), begun.outputs, outputs)
    return engine.Run(state, memory, joined, alive, survived)


def _moves(scenario: Scenario) -> bool:
    """Whether what acts on the device may change from block to block, told by the kinds of its profiles."""
    acting = (scenario.rate, *scenario.damping_change, *scenario.cross_rate, *scenario.acceleration)
    return not all(isinstance(profile, Constant) for profile in acting)


class _Course(eqx.Module):
    """What does not change from block to block."""

    loop: ClosedLoop
    scenario: Scenario
    words: tuple[Array, Array]
    period: Scalar
    first: int = eqx.field(static=True)

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

    @property
    def span(self) -> int:
        """Samples of a block."""
        return self.blocks.length

    def settled_in(self, state: LoopState) -> LoopState:
        """`state` with every leaf as a block leaves it."""
        observer = self.observer
        one = jnp.ones(self.words[0].shape)
        believed = observer.believed(state.observer)
        told = observer.believing(state.observer, believed, Innovation((one, one), (one, one)))
        return state._replace(observer=told)

    def maps(self, state: LoopState, number: Array) -> Maps:
        """Linearised where the filter is; the device in the middle of block `number`."""
        loop, blocks = self.loop, self.blocks
        middle = self.scenario.at((self.first + (number + 0.5) * self.span) * self.period)
        theta = loop.observer.estimate(state.observer).theta
        return maps_of(
            loop, loop.device.dynamics(middle.inertial), theta, blocks.alike, self.period, blocks.length, self.lanes
        )

    def block(self, state: LoopState, maps: Maps, number: Array) -> tuple[LoopState, Sample]:
        """The state a block later, and what can be recorded there."""
        loop, lanes = self.loop, self.lanes
        observer = self.observer
        before = self.first + number * self.span
        middle = (before + 0.5 * self.span) * self.period
        drift = self.scenario.at(middle).offset_drift
        facts = Facts(
            tones=self._tones(before * self.period),
            offset=over_lanes(loop.readout.clean((0.0,) * 4, drift), lanes),
            fixed=over_lanes(observer.prior.offset, lanes),
            normal=self._normal(maps, number),
            noise=over_lanes(loop.readout.noise_std(self.period), lanes) ** 2,
            expected=over_lanes(observer.variance(Clock(middle, before, self.period)), lanes),
            walk=over_lanes(observer.walk()[4:], lanes) * (self.span * self.period),
        )
        motion, believed = self._row((jnp.stack(state.motion), observer.believed(state.observer)))
        motion, believed, squares = self._single(advanced(motion, believed, maps, facts, observer.with_offsets))
        size = jnp.sqrt(jnp.mean(squares, axis=0))
        one = jnp.ones_like(size[0])
        told = observer.believing(state.observer, believed, Innovation(tuple(size), (one, one)))
        return self._ended(state._replace(motion=tuple(motion), observer=told), before + self.span)

    def _ended(self, state: LoopState, count: Array) -> tuple[LoopState, Sample]:
        loop, period = self.loop, self.period
        clock = Clock(count * period, count, period)
        estimate, output = loop.observer.estimate(state.observer), None
        if loop.filter is not None and state.output is not None:
            output = FilterState(*loop.filter.step(state.output.held, estimate.rate, self.span * period))
        rate = estimate.rate if output is None else output.rate
        conditions = self.scenario.at((count - 0.5) * period)
        force = loop.controller.command((), estimate, clock)[0]
        volts = loop.readout.clean(state.motion, conditions.offset_drift)
        sample = Sample(clock, conditions, state.motion, volts, force, estimate, rate)
        return state._replace(output=output), sample

    def _tones(self, time: Scalar) -> Array:
        """Sines and cosines of the groups of tones at `time`."""
        tones, entries = tones_of(self.loop.controller), []
        for group in self.blocks.alike:
            angle = over_lanes(2.0 * jnp.pi * tones[group[0]].frequency * time, self.lanes)
            entries += [jnp.sin(angle), jnp.cos(angle)]
        return jnp.stack(entries) if entries else jnp.zeros((0, *self.lanes))

    def _normal(self, maps: Maps, number: Array) -> Array:
        """Standard normal numbers for the statistics of a block."""
        size, draw = len(maps.ones), _drawer(self._row(self.words))
        if not self.blocks.projected:
            return draw(number * size + jnp.arange(size), BLOCK_STREAM)
        samples = self.first + number * self.span + jnp.arange(self.span)
        return basis.projected(maps.angles, maps.whiten, draw(samples, engine.MEASUREMENT_STREAM))


def _drawer(words: tuple[Array, Array]) -> Callable[[Array, int], Array]:
    return lambda counts, stream: jnp.stack(jax.vmap(lambda i: noise.normal_pair(words, i, stream))(counts), axis=1)
