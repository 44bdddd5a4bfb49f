"""What a sweep computes of each die, inside the compiled run."""

import functools
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as P
from jaxtyping import Array, Float, Int, PyTree

from memsgyro_jax.device.gyro import Pair, Scalar, number
from memsgyro_jax.loop import engine
from memsgyro_jax.loop.blocks.length import lengths
from memsgyro_jax.loop.blocks.run import run_in_blocks
from memsgyro_jax.loop.die_by_die import die_by_die, differs
from memsgyro_jax.loop.each_part import each_mapped
from memsgyro_jax.loop.loop import ClosedLoop, LoopState, Sample
from memsgyro_jax.loop.observers import AbstractCovarianceObserver
from memsgyro_jax.loop.scenario import Scenario

from .status import LOST, OK, STATUS


DIE_AXIS = "die"
COVARIANCE = ("standardised", "correlation")  # rows that `nees` turns into a figure
_KEPT = ("lost_at", "coefficient_true")  # rows that a lost die has too
_SINGULAR = 1e-12  # least eigenvalue of a correlation matrix that is inverted


class LotMemory(NamedTuple):
    """Of one die: the last time outside the tolerance, and sums over the present window."""

    outside: Scalar
    error: Scalar
    squared: Scalar
    innovations: Pair


class LotRecorder(engine.AbstractRecorder[LotMemory, tuple[Scalar, Scalar, Pair]]):
    """Over each window the sums of rate error, of its square, and of both channels' squared innovation over its
    variance; and the last time outside `tolerance` [rad/s].
    """

    tolerance: Scalar = number()

    def init(self) -> LotMemory:
        zero = jnp.zeros(())
        return LotMemory(zero, zero, zero, (zero, zero))

    def sample(self, memory: LotMemory, sample: Sample) -> LotMemory:
        error = sample.rate - sample.conditions.inertial.rate
        innovation = sample.estimate.innovation
        squares = (0.0, 0.0) if innovation is None else innovation.squared
        return LotMemory(
            outside=jnp.where(jnp.abs(error) <= self.tolerance, memory.outside, sample.clock.time),
            error=memory.error + error,
            squared=memory.squared + error**2,
            innovations=tuple(sum_ + square for sum_, square in zip(memory.innovations, squares, strict=True)),
        )

    def block(self, memory: LotMemory) -> tuple[LotMemory, tuple[Scalar, Scalar, Pair]]:
        sums = (memory.error, memory.squared, memory.innovations)
        return LotMemory(memory.outside, *jax.tree.map(lambda value: 0.0 * value, sums)), sums


class Plan(NamedTuple):
    """The fixed numbers of a sweep's runs: period in s, windows of equal length, samples of each, start of the settled
    part in s, tolerance.

    In blocks: `start` samples before them, a window of their own, `lead` samples in growing blocks, `stride` blocks in
    a window, and `statistics` that a block has of each channel; zero where samples are run one by one.
    """

    period: float
    blocks: int
    block: int
    settle: float
    tolerance: float
    start: int = 0
    lead: int = 0
    stride: int = 0
    statistics: int = 0

    @property
    def windows(self) -> int:
        """How many there are."""
        return len(self.counts)

    @property
    def samples(self) -> int:
        """Of the whole run."""
        return self.start + self.lead + self.blocks * self.block

    @property
    def sizes(self) -> Int[np.ndarray, "windows stride"]:
        """In blocks: samples of each, those of a window in a row."""
        return lengths(self.start, self.lead, self.block // self.stride, self.stride, self.blocks)

    @property
    def ends(self) -> Int[np.ndarray, " edges"]:
        """The samples until the end of each window, behind a zero."""
        if self.stride:
            return np.concatenate([[0], self.start + np.concatenate([[0], np.cumsum(self.sizes.sum(axis=1))])])
        return np.arange(self.blocks + 1) * self.block

    @property
    def counts(self) -> Int[np.ndarray, " windows"]:
        """What a window is the mean of: samples, or ends of blocks."""
        if self.stride:
            return np.concatenate([[self.start], np.sum(self.sizes > 0, axis=1)])
        return np.full(self.blocks, self.block)

    @property
    def instants(self) -> Float[np.ndarray, " instants"]:
        """In blocks: the middle of the last sample of every block, in s."""
        sizes = self.sizes[self.sizes > 0]
        return (self.start + np.cumsum(sizes) - 0.5) * self.period

    def per_window(self, values: Float[Array, "instants ..."]) -> Float[Array, "windows ..."]:
        """In blocks: means over the `instants` of each window."""
        counts = self.counts[1:]
        places = np.repeat(np.arange(len(counts)), counts)
        sums = jax.ops.segment_sum(values, places, len(counts), indices_are_sorted=True)
        return sums / counts.reshape(-1, *(1,) * (values.ndim - 1))

    @property
    def window_times(self) -> Float[np.ndarray, " windows"]:
        """The middle of each window in s; in blocks the mean of their ends."""
        if not self.stride:
            return (np.arange(self.blocks) + 0.5) * (self.block * self.period)
        counts = self.counts[1:]
        late = np.add.reduceat(self.instants, np.cumsum(counts) - counts) / counts + 0.5 * self.period
        return np.concatenate([[0.5 * self.start * self.period], late])

    @property
    def settled_window(self) -> int:
        """The first window that lies in the settled part; the last window when none does."""
        first = np.searchsorted(self.ends[:-1], self.settle / self.period - 1e-9 * self.block)
        return min(int(first), self.windows - 1)

    @property
    def innovations(self) -> int:
        """Of each channel in the settled part."""
        late = self.counts[self.settled_window :]
        return int(np.sum(late)) * (self.statistics or 1)


def run_batch(
    loop: ClosedLoop,
    scenario: Scenario,
    design: tuple[ClosedLoop, Scenario],
    words: tuple,
    plan: Plan,
    mesh: Mesh,
    lanes: int,
    groups: int | np.ndarray,
) -> dict[str, Float[Array, "dies ..."]]:
    """The rows of a batch of dies, split evenly over the devices of `mesh` and run `lanes` at a time; dies lead.

    Of each device's dies only the first `groups` times `lanes` are run, the rest are zero: one program for any number.
    """
    dynamic, static = eqx.partition((loop, scenario, words), eqx.is_array)
    plain = (*design, jax.tree.map(lambda word: word[0], words))
    varies = differs(dynamic, eqx.filter(plain, eqx.is_array))

    @functools.partial(jax.jit, inline=True)  # traced once for both shapes and values
    def group(dynamic):
        loop, scenario, words = eqx.combine(dynamic, static)
        rows = rows_of(loop, scenario, design, words, plan)
        return {name: jnp.moveaxis(value, -1, 0) for name, value in rows.items()}

    def part(dynamic, groups):
        # Always the same number of dies side by side: the compiler rounds differently for every vector length.
        varied, common = eqx.partition(dynamic, varies)
        each = jax.tree.map(lambda v: jnp.moveaxis(v.reshape((*v.shape[:-1], -1, lanes)), -2, 0), varied)

        def run(number):
            return group(eqx.combine(jax.tree.map(lambda v: v[number], each), common))

        most = words[0].size // (mesh.size * lanes)
        nothing = jax.tree.map(lambda one: jnp.zeros((most, *one.shape), one.dtype), jax.eval_shape(run, 0))
        put = lambda number, rows: jax.tree.map(lambda all_, one: all_.at[number].set(one), rows, run(number))  # noqa: E731
        rows = jax.lax.fori_loop(0, groups, put, nothing)
        return jax.tree.map(lambda v: v.reshape((-1, *v.shape[2:])), rows)

    split = jax.shard_map(
        part, mesh=mesh, in_specs=(shares(dynamic, varies), P()), out_specs=P(DIE_AXIS), check_vma=False
    )
    return split(dynamic, jnp.asarray(groups))


_compiled = eqx.filter_jit(run_batch)
# What XLA moves out of a loop depends on how many devices share the program, and how sums are rounded depends on that.
_compiled_for_processors = eqx.filter_jit(  # type: ignore[call-overload]  # the stubs do not know the keywords of `jax.jit`
    run_batch, compiler_options={"xla_disable_hlo_passes": "while-loop-invariant-code-motion"}
)


def compiled_for(mesh: Mesh) -> Callable[..., dict[str, Float[Array, "dies ..."]]]:
    """`run_batch` for the devices of a mesh."""
    return _compiled_for_processors if mesh.devices.flat[0].platform == "cpu" else _compiled


def trailing(rank: int) -> P:
    """The trailing axis, the dies, split over devices."""
    return P(*(None,) * (rank - 1), DIE_AXIS)


def shares(dies: PyTree, varies: PyTree[bool] | None = None) -> PyTree[P]:
    """How leaves are split over devices: along their trailing axis, but not those that do not vary with it."""
    varies = jax.tree.map(lambda _: True, dies) if varies is None else varies
    return jax.tree.map(lambda value, differs: trailing(value.ndim) if differs else P(), dies, varies)


def picked(dies: PyTree, one: PyTree, places: Int[np.ndarray, " some"]) -> PyTree:
    """The dies at some places. By NumPy: a hundred small JAX operations in each batch took a tenth of a sweep."""
    return jax.tree.map(lambda v, plain: np.asarray(v)[..., places] if np.ndim(v) > np.ndim(plain) else v, dies, one)


def rows_of(
    loop: ClosedLoop, scenario: Scenario, design: tuple[ClosedLoop, Scenario], words: tuple, plan: Plan
) -> dict[str, Array]:
    """The rows of dies side by side, which trail; differentiable by every number of the loop and scenario."""
    if (mapped := each_mapped((loop, scenario), design)) is not None:
        return _rows(*mapped, words, design[0], plan)
    one = (*design, tuple(word[0] for word in words))
    return die_by_die(lambda die, at, key: _rows(die, at, key, design[0], plan), (loop, scenario, words), one)


def _rows(loop: ClosedLoop, scenario: Scenario, words: tuple, design: ClosedLoop, plan: Plan) -> dict[str, Array]:
    recorder = LotRecorder(plan.tolerance)
    if plan.stride:
        done = run_in_blocks(loop, scenario, words, plan.period, (1, plan.start), plan.sizes, recorder, design)
    else:
        done = engine.run(loop, scenario, words, plan.period, plan.blocks, plan.block, recorder, design)
    end, counts = plan.samples * plan.period, plan.counts[:, None] if plan.stride else plan.block
    error, squared, innovations = jax.tree.map(lambda sums: sums / counts, done.outputs)
    settled = slice(plan.settled_window, None)
    conditions = scenario.at(end - 0.5 * plan.period)
    estimate = loop.estimate(done.state)
    truth = loop.device.coefficients(conditions.inertial.rate, conditions.inertial.damping_change)
    rate_true = _window_rates(scenario, plan, words[0].shape)
    outside, mean_square = done.memory.outside, jnp.mean(squared[settled], axis=0)
    nothing = jnp.full(words[0].shape, jnp.nan)
    channels = [jnp.mean(nis[settled], axis=0) if estimate.innovation else nothing for nis in innovations]
    relative = [_relative(e, t) for e, t in zip(estimate.theta, truth, strict=True)]
    # A known coefficient that does not vary is one number for all dies.
    over_dies = lambda numbers: jnp.stack([jnp.broadcast_to(number, words[0].shape) for number in numbers])  # noqa: E731
    rows = {
        "lost_at": jnp.where(done.alive, jnp.nan, jnp.asarray(plan.ends)[done.blocks_alive] * plan.period),
        "rate_error_end": loop.rate(done.state) - conditions.inertial.rate,
        "rate_error_rms": jnp.sqrt(mean_square),
        "rate_series_std": nothing  # one estimate, as at the end of a block, does not scatter
        if np.sum(plan.counts[settled]) < 2
        else jnp.sqrt(jnp.maximum(mean_square - jnp.mean(error[settled], axis=0) ** 2, 0.0)),
        "rate_std_end": nothing if estimate.rate_variance is None else jnp.sqrt(estimate.rate_variance),
        "convergence_time": jnp.where(outside >= end - 0.5 * plan.period, jnp.nan, outside),
        "nis_mean": sum(channels),
        "nis_channel": jnp.stack(channels),
        "coefficient_true": over_dies(truth),
        "coefficient_error": over_dies(relative),
        "rate_estimate": rate_true + error,
        "rate_true": rate_true,
    }
    if isinstance(loop.observer, AbstractCovarianceObserver):
        pair = _standardised(loop, loop.observer, done.state, conditions.offset_drift, truth)
        rows |= dict(zip(COVARIANCE, pair, strict=True))
    hide = {name: jnp.where(done.alive, value, jnp.nan) for name, value in rows.items() if name not in _KEPT}
    return {**rows, **hide, STATUS: jnp.where(done.alive, OK, LOST).astype(jnp.int8)}


def _relative(estimate: Scalar, true: Scalar) -> Scalar:
    """Relative error; NaN for a quantity that is zero."""
    return jnp.where(true == 0.0, jnp.nan, (estimate - true) / true)


def _window_rates(scenario: Scenario, plan: Plan, lanes: tuple[int, ...]) -> Array:
    """Mean true rate of each window; the rate of a sample is that of its middle, that of a block at its end."""
    if plan.stride:
        rates = plan.per_window(jax.vmap(scenario.rate.value)(plan.instants).reshape(len(plan.instants), -1))
        begun = jax.vmap(scenario.rate.value)((jnp.arange(plan.start) + 0.5) * plan.period).reshape(plan.start, -1)
        rates = jnp.concatenate([begun.mean(axis=0)[None], rates])
        return jnp.broadcast_to(rates if lanes else rates[:, 0], (plan.windows, *lanes))

    def window(number: Array) -> Array:
        middles = (number * plan.block + jnp.arange(plan.block) + 0.5) * plan.period
        return jnp.mean(jax.vmap(scenario.rate.value)(middles), axis=0)

    rates = jax.lax.map(window, jnp.arange(plan.blocks))
    return jnp.broadcast_to(rates.reshape(rates.shape + (1,) * (1 + len(lanes) - rates.ndim)), (plan.blocks, *lanes))


def _standardised(
    loop: ClosedLoop, observer: AbstractCovarianceObserver, state: LoopState, drift: tuple, theta: tuple[Scalar, ...]
) -> tuple[Array, Array]:
    """Error in claimed standard deviations and the claimed correlation, over all estimated states; dies trail."""
    offset = tuple(o + d for o, d in zip(loop.readout.offset, drift, strict=True))
    covariance = observer.covariance(state.observer)
    std = jnp.sqrt(jnp.stack([covariance[i, i] for i in range(len(covariance))]))
    return observer.error(state.observer, state.motion, offset, theta) / std, covariance / (std[:, None] * std[None])


def nees(
    standardised: Float[np.ndarray, "dies states"], correlation: Float[np.ndarray, "dies states states"]
) -> Float[np.ndarray, " dies"]:
    """Normalised estimation error squared; the number of states on average when the filter is consistent.

    NaN where something is known exactly, or to rounding: the covariance is singular then, and the figure means nothing.
    Outside the compiled run, since a linear-algebra call on every device at once can wait for itself.
    """
    finite = np.all(np.isfinite(correlation), axis=(1, 2)) & np.all(np.isfinite(standardised), axis=1)
    safe = np.where(finite[:, None, None], correlation, np.eye(correlation.shape[-1]))
    try:
        # C = L Lᵀ: the trace of the inverse, at least one over the least eigenvalue, costs less than that.
        root = np.linalg.inv(np.linalg.cholesky(safe))
        regular = finite & (np.sum(root**2, axis=(1, 2)) < 1.0 / _SINGULAR)
    except np.linalg.LinAlgError:
        regular = np.zeros(len(safe), bool)
    if not np.all(regular[finite]):
        regular = finite & (np.linalg.eigvalsh(safe)[:, 0] > _SINGULAR)
        safe = np.where(regular[:, None, None], safe, np.eye(correlation.shape[-1]))
        root = np.linalg.inv(np.linalg.cholesky(safe))
    white = (root @ np.where(regular[:, None], standardised, 0.0)[..., None])[..., 0]
    return np.where(regular, np.sum(white**2, axis=1), np.nan)


def mesh_of(devices: list[jax.Device]) -> Mesh:
    """The devices in a row."""
    return Mesh(np.array(devices), (DIE_AXIS,))
