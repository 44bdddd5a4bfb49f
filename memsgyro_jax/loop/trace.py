"""One closed-loop run of one die, kept sample by sample."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base import runtime
from memsgyro_jax.base.arguments import whole
from memsgyro_jax.base.concrete import check_positive, is_concrete
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.plainly import at_once
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.device.gyro import Inertial
from memsgyro_jax.device.propagate import State4

from . import engine, noise
from .blocks.length import Blocks, lengths
from .blocks.run import prepared, run_in_blocks
from .expectation import expectations, tell
from .loop import ClosedLoop, Sample, as_loop
from .operation import run_of
from .port_shapes import check_ports
from .scenario import AbstractProfile, Scenario, as_scenario
from .settling import not_rested_first
from .trace_result import Trace
from .unreached import unreached
from .unsuited import unsuited


class _Row(NamedTuple):
    """What a trace keeps of a sample."""

    time: jax.Array
    rate: jax.Array
    motion: State4
    offset: tuple
    volts: tuple
    force: tuple
    estimate: Any
    output: jax.Array


class TraceRecorder(engine.AbstractRecorder[_Row, _Row]):
    """Keeps the last sample of each block; `empty` gives the shapes."""

    empty: _Row

    def init(self) -> _Row:
        """Zeros."""
        return self.empty

    def sample(self, memory: _Row, sample: Sample) -> _Row:
        """The sample itself."""
        return _row(sample)

    def block(self, memory: _Row) -> tuple[_Row, _Row]:
        """The last sample."""
        return memory, memory


def simulate(
    loop: ClosedLoop,
    scenario: Scenario | AbstractProfile | float = 0.0,
    *,
    sample_rate: float | str | None = None,
    duration: float | str | None = None,
    seed: int = 0,
    die: int = 0,
    decimation: int = 1,
) -> Trace:
    """Run one die of `loop` for `duration` [s] at `sample_rate` [Hz] and keep every `decimation`-th sample. Both follow
    the device where they are left out, as in `Operation`: its higher mode is sampled 26.6 times per period.

    `scenario` is a `Scenario`, a profile of the rate, or a constant rate in rad/s. Noise depends on (`seed`, `die`)
    only. Every number of `loop` and `scenario` may be differentiated and mapped from outside (`jax.grad`,
    `jax.vmap`); settings and status are then filled in as far as they are known. What the observer cannot expect of
    the run, a moving rate that it holds constant say, and a change that lies beyond its end are logged before it
    begins. Raises `InputError` for a sample rate that cannot carry the device's modes, and outside float64.

    A loop `in_blocks` keeps the ends of its blocks, and before them as many samples as `decimation` says, or somewhat
    more. Its volts are without noise, its `nis` that of the block's statistics.
    """
    runtime.require_float64("simulate")
    loop, seed, die, decimation = as_loop(loop), whole("seed", seed), whole("die", die), whole("decimation", decimation)
    sample_rate, duration = run_of(loop, sample_rate, duration)
    steps = count_steps(sample_rate, duration)
    if not 1 <= decimation <= steps:
        raise InputError(
            f"Argument `decimation` must lie between 1 and the {steps} samples, but {decimation} was given."
        )
    _require_one_die(loop)
    scenario, loop = as_scenario(scenario), loop.sampled_at(sample_rate, duration=duration)
    check_ports(loop, scenario, 1.0 / sample_rate)
    ran, hindered = prepared(loop.present)
    ill = (*expectations(loop, scenario, sample_rate, duration), *unsuited(loop), *not_rested_first(loop, duration))
    tell((*ill, *unreached(scenario, duration), *hindered))
    words = noise.die_words(jax.random.key(seed), jnp.asarray(die))
    rows = _Rows.of(ran.blocks, steps, decimation)
    done = _compiled(ran, scenario, words, 1.0 / sample_rate, rows)
    settings = Settings.of(loop, scenario, sample_rate=sample_rate, duration=duration, seed=seed)
    end = scenario.at((rows.ends[-1] - 0.5) / sample_rate).inertial
    return _as_trace(done, loop, loop.device.coefficients(end.rate, end.damping_change), settings, rows)


Trace.run = staticmethod(simulate)


def _require_one_die(loop: ClosedLoop) -> None:
    readout = loop.readout
    numbers = (loop.device.dynamics(Inertial()), readout.scale, readout.offset, loop.start, loop.travel)
    lot = max(map(jnp.shape, jax.tree.leaves(numbers)), key=len)
    if lot:
        raise InputError(
            f"Argument `loop` must be one die, but holds {lot[-1]} along the last axis of its numbers, as `draw` gives "
            "them; give the design and the spread to `sweep`, or map over that axis by `jax.vmap`."
        )


def count_steps(sample_rate: float, duration: float) -> int:
    """Samples in `duration`; raises `InputError` unless both are positive, and there is at least one."""
    check_positive("sample_rate", sample_rate)
    if not (np.isfinite(duration) and duration > 0.0):
        raise InputError(f"Argument `duration` must be a positive number of seconds, but {duration} was given.")
    steps = round(sample_rate * duration)
    if steps < 1:
        raise InputError(
            f"Argument `duration` must hold at least one sample at {sample_rate:g} Hz, but {duration:g} s was given."
        )
    return steps


class _Rows(NamedTuple):
    """Rows of samples run one by one, samples of each; samples in growing blocks behind them, then blocks and samples
    of each.
    """

    rows: int
    apart: int
    lead: int = 0
    blocks: int = 0
    length: int = 1

    @classmethod
    def of(cls, blocks: Blocks | None, steps: int, decimation: int) -> "_Rows":
        """Those of a run of `steps` samples."""
        if blocks is None:
            return cls(steps // decimation, decimation)
        first, lead = blocks.first(steps)
        apart = max(n for n in range(1, min(decimation, first) + 1) if first % n == 0)
        return cls(first // apart, apart, lead, (steps - first - lead) // blocks.length, blocks.length)

    @property
    def sizes(self) -> np.ndarray:
        """Samples of each block."""
        return lengths(self.rows * self.apart, self.lead, self.length, 1, self.blocks)

    @property
    def ends(self) -> np.ndarray:
        """The number of samples at the end of each row, behind a zero."""
        first = np.arange(self.rows + 1) * self.apart
        return np.concatenate([first, first[-1] + np.cumsum(self.sizes)])


@eqx.filter_jit
def _compiled(loop: ClosedLoop, scenario: Scenario, words: tuple, period: float, rows: _Rows) -> engine.Run:
    def row() -> _Row:
        clock = engine.Clock(jnp.zeros(()), jnp.zeros((), int), period)
        return _row(loop.step(loop.init(), scenario.at(0.0), (0.0, 0.0), clock)[1])

    empty = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), jax.eval_shape(row))
    recorder = TraceRecorder(empty)
    if loop.blocks is None:
        return engine.run(loop, scenario, words, period, rows.rows, rows.apart, recorder)
    return run_in_blocks(loop, scenario, words, period, (rows.rows, rows.apart), rows.sizes, recorder)


def _row(sample: Sample) -> _Row:
    drift, inertial = sample.conditions.offset_drift, sample.conditions.inertial
    made = sample.clock.time, inertial.rate, sample.motion, drift, sample.volts, sample.force
    return _Row(*jax.tree.map(lambda x: jnp.asarray(x, float), (*made, sample.estimate, sample.rate)))


def _as_trace(done: engine.Run, loop: ClosedLoop, theta: tuple, settings: Settings, rows: _Rows) -> Trace:
    nominal = loop.readout.offset
    xp = np if is_concrete(done, theta, nominal) else jnp
    row: _Row = jax.tree.map(xp.asarray, done.outputs)
    parts = (row.motion, row.estimate.motion, theta, row.estimate.theta, nominal, row.offset, row.estimate.offset)
    columns = _columns if xp is np else _traced_columns
    motion, motion_estimate, theta, theta_estimate, nominal, offset, offset_estimate, volts, force = columns(
        (*parts, row.volts, row.force), xp
    )
    estimate, missing = row.estimate, xp.full(row.time.shape, np.nan)
    with np.errstate(invalid="ignore"):  # the variance of a lost die may be negative
        std = missing if estimate.rate_variance is None else xp.sqrt(estimate.rate_variance)
    return Trace(
        time=row.time,
        rate_true=row.rate,
        rate_estimate=row.output,
        rate_unfiltered=estimate.rate,
        rate_std=std,
        motion=motion,
        motion_estimate=motion_estimate,
        theta=theta,
        theta_estimate=theta_estimate,
        offset=nominal + offset,
        offset_estimate=offset_estimate,
        volts=volts,
        force=force,
        nis=missing if estimate.nis is None else estimate.nis,
        intact_until=xp.where(done.alive, np.inf, xp.asarray(rows.ends)[done.blocks_alive] / settings.sample_rate),
        loop=loop,
        coefficients=loop.device.model.names,
        settings=settings,
        readings=estimate.readings,
    )


def _columns(parts: tuple, xp: Any) -> list[Any]:
    """Of each part its entries side by side, along the last axis."""
    return [xp.stack(xp.broadcast_arrays(*map(xp.asarray, entries)), axis=-1) for entries in parts]


_traced_columns = at_once(_columns)
