"""What a sweep computes of each die, inside the compiled run."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as P
from jaxtyping import Array, Float

from . import engine
from .device import Scalar, number
from .loop import ClosedLoop, Sample
from .observers.ekf import ExtendedKalmanFilter
from .scenario import Scenario


DIE_AXIS = "die"


class LotMemory(NamedTuple):
    """Running sums of one die."""

    outside: Scalar
    settled: Scalar
    error: Scalar
    squared: Scalar
    nis: Scalar
    window_estimate: Scalar
    window_true: Scalar
    window: Scalar


class LotRecorder(engine.AbstractRecorder[LotMemory, tuple[Scalar, Scalar]]):
    """Sums over the settled part (from `settle` [s] on), the last time outside `tolerance` [rad/s], and window means of
    the rate.
    """

    settle: Scalar = number()
    tolerance: Scalar = number()

    def init(self) -> LotMemory:
        """Zeros: converged from the start, nothing gathered."""
        return LotMemory(*(jnp.zeros(()) for _ in LotMemory._fields))

    def sample(self, memory: LotMemory, sample: Sample) -> LotMemory:
        """Add one sample."""
        estimate, true = sample.estimate.rate, sample.conditions.inertial.rate
        error = estimate - true
        settled = jnp.where(sample.clock.time >= self.settle, 1.0, 0.0)
        nis = 0.0 if sample.estimate.nis is None else sample.estimate.nis
        return LotMemory(
            outside=jnp.where(jnp.abs(error) <= self.tolerance, memory.outside, sample.clock.time),
            settled=memory.settled + settled,
            error=memory.error + settled * error,
            squared=memory.squared + settled * error**2,
            nis=memory.nis + settled * nis,
            window_estimate=memory.window_estimate + estimate,
            window_true=memory.window_true + true,
            window=memory.window + 1.0,
        )

    def block(self, memory: LotMemory) -> tuple[LotMemory, tuple[Scalar, Scalar]]:
        """The window's mean estimate and mean true rate."""
        output = memory.window_estimate / memory.window, memory.window_true / memory.window
        return memory._replace(
            window_estimate=0.0 * memory.window, window_true=0.0 * memory.window, window=0.0 * memory.window
        ), output


class Plan(NamedTuple):
    """The fixed numbers of a sweep's runs: period in s, blocks, samples per block, start of the settled part in s,
    tolerance.
    """

    period: float
    blocks: int
    block: int
    settle: float
    tolerance: float


@eqx.filter_jit
def run_batch(
    loop: ClosedLoop, scenario: Scenario, design: tuple[ClosedLoop, Scenario], words: tuple, plan: Plan, mesh: Mesh
) -> dict[str, Float[Array, "dies ..."]]:
    """The rows of a batch of dies, split evenly over the devices of `mesh`; dies lead in the result."""
    dynamic, static = eqx.partition((loop, scenario, words), eqx.is_array)
    plain = (*design, jax.tree.map(lambda word: word[0], words))
    specs = jax.tree.map(_spec, dynamic, eqx.filter(plain, eqx.is_array))

    def part(dynamic):
        loop, scenario, words = eqx.combine(dynamic, static)
        rows = _rows(loop, scenario, design[0], words, plan)
        return {name: jnp.moveaxis(value, -1, 0) for name, value in rows.items()}

    return jax.shard_map(part, mesh=mesh, in_specs=(specs,), out_specs=P(DIE_AXIS), check_vma=False)(dynamic)


def _spec(value: Array, plain: Array) -> P:
    """Split the trailing axis over devices where a leaf has one entry per die."""
    return P(*(None,) * plain.ndim, DIE_AXIS) if value.ndim > plain.ndim else P()


def _rows(loop: ClosedLoop, scenario: Scenario, design: ClosedLoop, words: tuple, plan: Plan) -> dict[str, Array]:
    recorder = LotRecorder(plan.settle, plan.tolerance)
    done = engine.run(loop, scenario, words, plan.period, plan.blocks, plan.block, recorder, design)
    end = plan.blocks * plan.block * plan.period
    memory, state = done.memory, done.state
    conditions = scenario.at(end - 0.5 * plan.period)
    estimate = loop.observer.estimate(state.observer)
    error = estimate.rate - conditions.inertial.rate
    mean = memory.error / memory.settled
    truth = loop.device.coefficients(conditions.inertial.rate)
    nothing = jnp.full(words[0].shape, jnp.nan)
    has_nis = estimate.nis is not None
    rows = {
        "lost_at": jnp.where(done.alive, jnp.nan, done.blocks_alive * plan.block * plan.period),
        "rate_error_end": error,
        "rate_error_rms": jnp.sqrt(memory.squared / memory.settled),
        "rate_series_std": jnp.sqrt(jnp.maximum(memory.squared / memory.settled - mean**2, 0.0)),
        "rate_std_end": nothing if estimate.rate_variance is None else jnp.sqrt(estimate.rate_variance),
        "convergence_time": jnp.where(memory.outside >= end - 0.5 * plan.period, jnp.nan, memory.outside),
        "nis_mean": memory.nis / memory.settled if has_nis else nothing,
        "nees_end": _nees(loop, state, conditions.offset_drift, truth) if has_nis else nothing,
        "coefficient_error": jnp.stack([e / t - 1.0 for e, t in zip(estimate.theta, truth, strict=True)]),
        "rate_estimate": done.outputs[0],
        "rate_true": done.outputs[1],
    }
    hide = {name: jnp.where(done.alive, value, jnp.nan) for name, value in rows.items() if name != "lost_at"}
    return {**rows, **hide, "status": jnp.where(done.alive, 0, 1).astype(jnp.int8)}


def _nees(loop: ClosedLoop, state: engine.LoopState, drift: tuple, theta: tuple[Scalar, ...]) -> Array:
    """Normalised estimation error squared over all estimated states; their number on average when the filter is
    consistent.
    """
    observer = loop.observer
    assert isinstance(observer, ExtendedKalmanFilter)
    offset = tuple(o + d for o, d in zip(loop.readout.offset, drift, strict=True))
    error = jnp.moveaxis(observer.error(state.observer, state.motion, offset, theta), -1, 0)
    covariance = jnp.moveaxis(observer.covariance(state.observer), -1, 0)
    std = jnp.sqrt(jnp.diagonal(covariance, axis1=1, axis2=2))
    correlation = covariance / (std[:, :, None] * std[:, None, :])
    scaled = error / std
    return jnp.sum(scaled * jnp.linalg.solve(correlation, scaled[:, :, None])[:, :, 0], axis=1)


def mesh_of(devices: list[jax.Device]) -> Mesh:
    """The devices in a row."""
    return Mesh(np.array(devices), (DIE_AXIS,))
