"""What the dies of a lot give out over time, as means over short windows."""

from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree

from memsgyro_jax.device.gyro import Scalar
from memsgyro_jax.loop import engine, noise
from memsgyro_jax.loop.die_by_die import die_by_die
from memsgyro_jax.loop.each_part import each_mapped
from memsgyro_jax.loop.loop import ClosedLoop, Sample
from memsgyro_jax.loop.scenario import Scenario
from memsgyro_jax.montecarlo import batch as lot
from memsgyro_jax.montecarlo.spread import Spread
from memsgyro_jax.tuning.tunable import leaf_at, placed


_LANES, _FEWEST = 32, 4  # dies side by side, at most and at least


class Outputs(NamedTuple):
    """Of every die the mean rate given out over each window [rad/s], the mean quadrature (NaN where none is read), and
    whether it was never lost; `period` is that of the windows [s].
    """

    rate: Float[np.ndarray, "dies windows"]
    quadrature: Float[np.ndarray, "dies windows"]
    alive: Bool[np.ndarray, " dies"]
    period: float

    def apart(self, lots: int) -> "list[Outputs]":
        """Those of each of so many lots that were run one after the other."""
        each = [np.split(part, lots) for part in (self.rate, self.quadrature, self.alive)]
        return [Outputs(*parts, self.period) for parts in zip(*each, strict=True)]  # type: ignore[call-arg]


class _Sums(NamedTuple):
    rate: Scalar
    quadrature: Scalar


class _Recorder(engine.AbstractRecorder[_Sums, _Sums]):
    """Sums over each window."""

    def init(self) -> _Sums:
        return _Sums(jnp.zeros(()), jnp.zeros(()))

    def sample(self, memory: _Sums, sample: Sample) -> _Sums:
        read = sample.estimate.readings
        return _Sums(memory.rate + sample.rate, memory.quadrature + (0.0 if read is None else read.quadrature))

    def block(self, memory: _Sums) -> tuple[_Sums, _Sums]:
        return jax.tree.map(jnp.zeros_like, memory), memory


def lot_outputs(
    loop: ClosedLoop, spread: Spread, scenario: Scenario, *, dies: int, seed: int, sample_rate: float, windows: int,
    window: int, raised: Sequence[Collection[str]] = ((),), by: float = 1.0, silent: bool = False,
    stretch: int | None = None, progress: Callable[[float], None] | None = None,
) -> Outputs:  # fmt: skip
    """Run `dies` dies of `spread` around `loop` for `windows` windows of `window` samples each; a die is that of a
    sweep with the same seed. `loop` must have been `sampled_at` the sample rate.

    The lot is run once, or once for each of `raised`, one after the other in the outputs: with the numbers at these
    paths of the loop `by` times as large; `silent` takes the noise from the dies once they are drawn. A long
    run may be made of stretches of so many windows, by the program of a shorter one; `progress` is told
    the share that is done.
    """
    numbers = np.tile(np.arange(dies), len(raised))
    drawn = spread.draw(loop, scenario, seed, np.arange(dies))
    if silent:
        loop, drawn = loop.silent, replace(drawn, loop=drawn.loop.silent)
    design = (loop, scenario)
    words = jax.tree.map(np.asarray, noise.die_words(jax.random.key(seed), jnp.asarray(spread.noise(np.arange(dies)))))
    devices = jax.local_devices()
    lanes, stretch = _lanes(len(numbers), len(devices)), stretch or windows
    firsts = range(0, len(numbers), lanes)
    done = dict.fromkeys(firsts, 0.0)

    def told(first: int, share: float) -> None:
        done[first] = share
        if progress is not None:
            progress(sum(done.values()) / len(done))

    def batch(first: int) -> tuple[np.ndarray, ...]:
        lane = np.minimum(first + np.arange(lanes), len(numbers) - 1)
        places = numbers[lane]
        one, conditions = lot.picked((drawn.loop, drawn.scenario), design, places)
        one = _larger(one, raised, lane // dies, by)
        given = _plain((one, conditions, design, tuple(word[places] for word in words), 1.0 / sample_rate))
        with jax.default_device(devices[first // lanes % len(devices)]):
            parts = _in_stretches(given, windows, window, stretch, partial(told, first))
        return tuple(part[..., : len(numbers) - first] for part in parts)

    with ThreadPoolExecutor(len(devices)) as workers:
        parts = list(workers.map(batch, firsts)) if len(firsts) > 1 else [batch(0)]
    rate, quadrature, alive = (np.concatenate(part, axis=-1).T for part in zip(*parts, strict=True))
    known = jax.eval_shape(lambda: loop.estimate(loop.init())).readings is not None
    quadrature = quadrature / window if known else np.full_like(quadrature, np.nan)
    return Outputs(rate / window, quadrature, alive, window / sample_rate)


def _in_stretches(
    given: "_Given", windows: int, window: int, stretch: int, told: Callable[[float], None]
) -> tuple[np.ndarray, ...]:
    """Sums over the windows, and which dies were never lost."""
    end, found = _begun(given), []
    for first in range(0, windows, stretch):
        since = engine.Since(end, np.asarray(first), np.asarray(windows * window))
        end, sums = _run(given, since, stretch, window)
        found.append(jax.tree.map(np.asarray, sums))
        told(min(1.0, (first + stretch) / windows))
    rate, quadrature = (np.concatenate(part)[:windows] for part in zip(*found, strict=True))
    return rate, quadrature, np.asarray(end.alive)


def _lanes(dies: int, devices: int) -> int:
    """Dies side by side, a power of two: 4 take a third of the time of 32; many are shared by all devices."""
    share = dies if dies <= _LANES // 2 else -(-dies // devices)
    return int(np.clip(1 << (share - 1).bit_length(), _FEWEST, _LANES))


def _larger(loop: ClosedLoop, raised: Sequence[Collection[str]], which: np.ndarray, by: float) -> ClosedLoop:
    """Each lane's loop with the numbers that are raised there."""
    paths = sorted({path for some in raised for path in some})
    factors = [np.where([path in some for some in raised], by, 1.0)[which] for path in paths]
    return placed(loop, paths, [leaf_at(loop, path) * factor for path, factor in zip(paths, factors, strict=True)])


def _plain(tree: PyTree) -> PyTree:
    """Numbers of one kind, weak or not, so that one program serves all tests."""
    return jax.tree.map(lambda leaf: np.asarray(leaf) if isinstance(leaf, np.ndarray | jax.Array) else leaf, tree)


_Given = tuple[ClosedLoop, Scenario, tuple[ClosedLoop, Scenario], tuple[np.ndarray, ...], np.ndarray]


@eqx.filter_jit
def _begun(given: _Given) -> engine.Run:
    loop, scenario, design, words, _ = given
    if (mapped := each_mapped((loop, scenario), design)) is not None:
        begun = engine.unbegun(mapped[0], _Recorder(), words[0].shape, design[0])
    else:
        plain = (design[0], tuple(word[0] for word in words))
        begun = die_by_die(lambda one, key: engine.unbegun(one, _Recorder(), key[0].shape), (loop, words), plain)
    return jax.tree.map(lambda leaf: jax.lax.convert_element_type(leaf, leaf.dtype), begun)  # strong, as at the end


@eqx.filter_jit
def _run(given: _Given, since: engine.Since, windows: int, window: int) -> tuple[engine.Run, tuple[Array, Array]]:
    loop, scenario, design, words, period = given

    def done_of(loop: ClosedLoop, scenario: Scenario, words: tuple, end: engine.Run) -> engine.Run:
        return engine.run(
            loop, scenario, words, period, windows, window, _Recorder(), design[0], since._replace(end=end)
        )

    rest = (words, since.end)
    if (mapped := each_mapped((loop, scenario), design)) is not None:
        done = done_of(*mapped, *rest)
    else:
        one = (*design, *jax.tree.map(lambda leaf: leaf[..., 0], rest))
        done = die_by_die(done_of, (loop, scenario, *rest), one)
    return done._replace(outputs=None), (done.outputs.rate, done.outputs.quadrature)
