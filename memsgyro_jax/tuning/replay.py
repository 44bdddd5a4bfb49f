"""Tunes an observer on recorded voltages and commands: no simulation, no truth, the likelihood of its innovations."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base import runtime
from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.brownian import HasTemperature
from memsgyro_jax.device.gyro import Pair, Scalar, number
from memsgyro_jax.loop.loop import LoopState, Sample
from memsgyro_jax.loop.observers import AbstractObserver
from memsgyro_jax.loop.observers.base import Clock, Estimate
from memsgyro_jax.loop.scenario import Conditions, Scenario
from memsgyro_jax.montecarlo import batch as lot

from .descent import descend
from .fates import null_directions, tuned_numbers
from .losses import AbstractLoss, Consistency, InnovationLikelihood
from .objective import Objective, Timing, Values, evaluated
from .result import TunedNumber
from .tunable import Tunable, Tunables, resolved


_SEGMENTS, _HELD_OUT = 16, 4  # pieces of a record, and those at its end that judge what the others taught
_BLOCKS = 20
_NEVER = 1e300  # what a lost copy would count; the start is checked, and a step that loses the record is not taken


class Replay(eqx.Module):
    """In the place of a closed loop: the observer alone, fed with `volts` and `force`, one row per sample.

    `force` [N] is what was held during the sample at whose end `volts` [V] were read.
    """

    observer: AbstractObserver
    volts: Float[Array, "samples 2"]
    force: Float[Array, "samples 2"]
    travel: float = float("inf")
    filter: None = None
    blocks: None = None
    device: HasTemperature = HasTemperature()  # unknown: without effects, without a temperature

    def init(self) -> LoopState:
        """The observer's own start."""
        return LoopState((jnp.zeros(()),) * 4, self.observer.init(), ())

    def estimate(self, state: LoopState) -> Estimate:
        """The observer's own."""
        return self.observer.estimate(state.observer)

    def rate(self, state: LoopState) -> Scalar:
        """The estimate in rad/s."""
        return self.estimate(state).rate

    def step(
        self, state: LoopState, conditions: Conditions, noise: Pair, clock: Clock, shaking: None = None
    ) -> tuple[LoopState, Sample]:
        """One row of the record; what is not in it (truth, conditions) is not a number, and nothing shakes it."""
        volts, force = (tuple(rows[clock.sample]) for rows in (self.volts, self.force))
        end = Clock(clock.time + clock.period, clock.sample + 1, clock.period)
        observer = self.observer.update(state.observer, volts, force, end)
        seen = self.observer.estimate(observer)
        unknown = jax.tree.map(lambda value: jnp.full_like(jnp.asarray(value, float), jnp.nan), conditions)
        truth = (jnp.nan,) * 4
        return LoopState(state.motion, observer, ()), Sample(end, unknown, truth, volts, force, seen, seen.rate)


@dataclass(frozen=True)
class RecordTuning(Shown):
    """An observer tuned on a record: `observer`, the fate of each free number, and the figures of the part of the
    record that was held out, before and after: mean negative log-likelihood in nats per sample, and (Σ ln² NIS)½ over
    the two channels, zero when both are consistent.
    """

    observer: AbstractObserver
    numbers: tuple[TunedNumber, ...]
    nulls: tuple[str, ...]
    likelihood: tuple[float, float]
    inconsistency: tuple[float, float]
    status: str

    def __repr__(self) -> str:
        lines = [f"{n.label:<32} {n.start:10.4g} -> {n.value:10.4g}  {n.fate}" for n in self.numbers]
        lines += [f"no effect along {null}" for null in self.nulls]
        lines.append("held out: -ln likelihood {:.6g} -> {:.6g} nats per sample".format(*self.likelihood))
        lines.append("held out: inconsistency {:.3g} -> {:.3g} (0 is consistent)".format(*self.inconsistency))
        return "\n".join([*lines, self.status])


class _Segment(InnovationLikelihood):
    """The likelihood from `settle` up to `until` [s], one pair of times for each copy of the record."""

    until: Scalar = number(default=0.0)

    def counts(self, sample):
        return (sample.clock.time > self.settle) & (sample.clock.time <= self.until)


def tune_on_record(
    observer: AbstractObserver,
    volts: Float[np.ndarray, "samples 2"],
    force: Float[np.ndarray, "samples 2"],
    *,
    free: Sequence[Tunable],
    sample_rate: float | str,
    settle: float | str = 0.0,
    evaluations: int = 40,
    progress: Callable[[str], None] | None = None,
) -> RecordTuning:
    """Move what is `free` (paths that begin with `observer.`) until the record is most likely.

    Row k holds the voltages [V] at the end of sample k and the force [N] during it. The likelihood counts from `settle`
    [s] on; the last quarter of the rest is held out and says how much was gained.

    Raises `InputError` for a record of another shape or with gaps, for what cannot be freed, and outside float64.
    """
    runtime.require_float64("tune_on_record")
    sample_rate, settle = quantity("sample_rate", sample_rate, "Hz"), quantity("settle", settle, "s")
    volts, force = _checked(volts, force, settle, sample_rate)
    loop = Replay(observer, jnp.asarray(volts), jnp.asarray(force))
    tunables = resolved(loop, free, sample_rate, len(volts) / sample_rate)
    edges = np.linspace(settle, len(volts) / sample_rate, _SEGMENTS + 1)
    every = _objective(loop, tunables, _Segment(edges[:-1], until=edges[1:]), _SEGMENTS, sample_rate)
    if not every.values(tunables.values).alive.all():
        raise InputError("The observer must follow the record at the start, but its numbers are not finite.")
    readings = (len(volts) - settle * sample_rate) * (1.0 - _HELD_OUT / _SEGMENTS)
    descent = descend(
        lambda at: evaluated(every, _taught(every, tunables.numbers(at)), at, _NEVER, readings),
        # The held-out quarter of one record is too short to say when to stop, and few numbers do not overfit the rest.
        lambda at: float(np.mean(every.values(tunables.numbers(at)).loss[:-_HELD_OUT])),
        tunables.coordinates,
        evaluations=evaluations,
        told=lambda step: progress(f"after {step.evaluations}: {step.training:.8g}") if progress else None,
    )
    found = tunables.numbers(descent.coordinates)
    values = _taught(every, found)
    agreement = _objective(loop, tunables, Consistency(float(edges[-1 - _HELD_OUT])), 1, sample_rate)
    both = tunables.values, found
    return RecordTuning(
        observer=tunables.applied(loop, found).observer,
        numbers=tuned_numbers(tunables, found, values, "InnovationLikelihood"),
        nulls=null_directions(tunables, found, values),
        likelihood=tuple(float(np.mean(every.values(at).loss[-_HELD_OUT:])) for at in both),
        inconsistency=tuple(float(np.sqrt(agreement.values(at).loss[0])) for at in both),
        status=descent.status,
    )  # fmt: skip


def _taught(every: Objective, numbers: np.ndarray) -> Values:
    """The segments that are not held out, of an objective that computes all of them at once."""
    found = every.slopes(numbers)
    assert found.slopes is not None
    return Values(found.loss[:-_HELD_OUT], found.alive[:-_HELD_OUT], found.slopes[:, :-_HELD_OUT])


def _objective(loop: Replay, tunables: Tunables, loss: AbstractLoss, copies: int, sample_rate: float) -> Objective:
    """The whole record for each copy of the loss, on one device."""
    samples = loop.volts.shape[0]
    blocks = max(n for n in range(1, _BLOCKS + 1) if samples % n == 0)
    words = (np.zeros(copies, np.uint32),) * 2
    mesh, timing = lot.mesh_of(jax.local_devices()[:1]), Timing(1.0 / sample_rate, blocks, samples // blocks)
    count, nothing = len(tunables.paths), Scenario()
    return Objective(
        tunables, loss, loop, nothing, (loop, nothing), words, timing, mesh, copies,
        around=(None,) * count, places=np.zeros((count, copies)),
    )  # fmt: skip


def _checked(volts: Any, force: Any, settle: float, sample_rate: float) -> tuple[np.ndarray, np.ndarray]:
    volts, force = np.asarray(volts, float), np.asarray(force, float)
    for name, rows in (("volts", volts), ("force", force)):
        if rows.ndim != 2 or rows.shape[1] != 2 or rows.shape != volts.shape:
            raise InputError(
                f"Argument `{name}` must have one row per sample and two columns, but has shape {rows.shape}."
            )
        if not np.all(np.isfinite(rows)):
            raise InputError(f"Argument `{name}` must hold finite numbers only, but row "
                             f"{int(np.argmin(np.all(np.isfinite(rows), axis=1)))} does not.")  # fmt: skip
    if not 0.0 <= settle < len(volts) / sample_rate:
        raise InputError(
            f"Argument `settle` must lie within the record of {len(volts) / sample_rate:g} s, but is {settle:g} s."
        )
    return volts, force
