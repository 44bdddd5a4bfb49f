"""Tunes an observer on recorded voltages and commands: no simulation, no truth, the likelihood of its innovations."""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base import runtime
from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.plainly import plainly
from memsgyro_jax.device.brownian import HasTemperature
from memsgyro_jax.loop.observers import AbstractObserver
from memsgyro_jax.loop.record_filter import readings_after_settling, told_by_record

from .caveats import of_record
from .descent import descend
from .fates import null_directions, tuned_numbers
from .losses import Consistency
from .objective import Values, evaluated
from .result import TunedNumber
from .tunable import Group, Tunables, placed, resolved


_FEW = 2000  # readings, below which a program is not worth optimising
_SEGMENTS, _HELD_OUT = 16, 4  # pieces of a record, and those at its end that judge what the others taught
_NEVER = 1e300  # what a lost copy would count; the start is checked, and a step that loses the record is not taken


class Replay(eqx.Module):
    """In the place of a closed loop: the observer alone."""

    observer: AbstractObserver
    device: HasTemperature = HasTemperature()  # unknown: without effects


@dataclass(frozen=True)
class RecordTuning(Shown):
    """An observer tuned on a record: `observer`, the fate of each free number, and the figures of the part of the
    record that was held out, before and after: mean negative log-likelihood in nats per reading (a sample, or of a
    filter in blocks a projection), and (Σ ln² NIS)½ over the two channels, zero when both are consistent. `warnings`
    are sentences that a user must read before believing it.
    """

    observer: AbstractObserver
    numbers: tuple[TunedNumber, ...]
    nulls: tuple[str, ...]
    likelihood: tuple[float, float]
    inconsistency: tuple[float, float]
    status: str
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        lines = [f"{n.label:<32} {n.start:10.4g} -> {n.value:10.4g}  {n.fate}" for n in self.numbers]
        lines += [f"no effect along {null}" for null in self.nulls]
        lines.append("held out: -ln likelihood {:.6g} -> {:.6g} nats per reading".format(*self.likelihood))
        lines.append("held out: inconsistency {:.3g} -> {:.3g} (0 is consistent)".format(*self.inconsistency))
        return "\n".join([*lines, self.status, *(f"WARNING: {warning}" for warning in self.warnings)])


@dataclass(frozen=True)
class _Record:
    """Pieces of a record of equal length, in the place of a lot of dies: losses and squares of each, and by how much
    the free numbers change them, all from one run forwards.
    """

    replay: Replay
    tunables: Tunables
    volts: Array
    force: Array
    period: float
    every: int
    readings: float

    def told(self, numbers: np.ndarray) -> "_Told":
        """What the record says at these numbers."""
        run = _plainly if self.every * _SEGMENTS < _FEW else _slopes
        given = self.replay, self.tunables.paths, self.volts, self.force, self.period, self.every
        return _Told(*map(np.asarray, run(*given, jnp.asarray(numbers))))

    def total(self, values: Values, penalty: float) -> tuple[float, Float[np.ndarray, " n"] | None]:
        """The mean of the pieces, one that is lost counting `penalty`, and its gradient."""
        slopes = None if values.slopes is None else np.mean(values.slopes, axis=1)
        return float(np.mean(np.where(values.alive, values.loss, penalty))), slopes


class _Told(NamedTuple):
    """Of each piece its nats per reading and the mean squares of both channels, and their derivatives."""

    values: Float[np.ndarray, "pieces 3"]
    slopes: Float[np.ndarray, "n pieces 3"]

    @property
    def taught(self) -> Values:
        """The losses of the pieces that are not held out; no piece is lost alone."""
        finite = bool(np.isfinite(self.values).all() and np.isfinite(self.slopes).all())
        slopes = self.slopes[:, :-_HELD_OUT, 0]
        alive = np.full(slopes.shape[1], finite)
        return Values(self.values[:-_HELD_OUT, 0], alive, np.where(alive, slopes, 0.0))

    @property
    def held_out(self) -> tuple[float, float]:
        """Likelihood and inconsistency of the pieces at the end."""
        nats = float(np.mean(self.values[-_HELD_OUT:, 0]))
        return nats, float(np.sqrt(Consistency().value((*self.nis, 1.0))))

    @property
    def nis(self) -> tuple[float, float]:
        """Mean of e²/S of both channels in the pieces at the end."""
        first, second = np.mean(self.values[-_HELD_OUT:, 1:], axis=0).tolist()
        return first, second


def _along(
    replay: Replay, paths: tuple[str, ...], volts: Array, force: Array, period: float, every: int, numbers: Array
) -> tuple[Array, Array]:
    """Forwards, since many pieces are told and few numbers are free. The record is an argument, never a constant."""

    def told(numbers: Array) -> Array:
        return told_by_record(placed(replay, paths, list(numbers)).observer, volts, force, period, _SEGMENTS, every)

    def one(unit: Array) -> tuple[Array, Array]:
        return jax.jvp(told, (numbers,), (unit,))

    return jax.vmap(one, out_axes=(None, 0))(jnp.eye(len(paths)))


_slopes, _plainly = eqx.filter_jit(_along), plainly(_along)


def tune_on_record(
    observer: AbstractObserver,
    volts: Float[np.ndarray, "samples 2"],
    force: Float[np.ndarray, "samples 2"],
    *,
    free: Group,
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
    record = _record(observer, volts, force, free, sample_rate, settle)
    tunables = record.tunables
    told = functools.cache(lambda *numbers: record.told(np.array(numbers)))
    at = lambda coordinates: told(*tunables.numbers(coordinates).tolist())  # noqa: E731
    before = at(tunables.coordinates)
    if not np.isfinite(before.values).all():
        raise InputError("The observer must follow the record at the start, but its numbers are not finite.")
    descent = descend(
        lambda here: evaluated(record, at(here).taught, here, _NEVER, record.readings),
        # The held-out quarter of one record is too short to say when to stop, and few numbers do not overfit the rest.
        lambda here: float(np.mean(at(here).taught.loss)),
        tunables.coordinates,
        evaluations=evaluations,
        told=lambda step: progress(f"after {step.evaluations}: {step.training:.8g}") if progress else None,
    )
    found, after = tunables.numbers(descent.coordinates), at(descent.coordinates)
    likelihood, inconsistency = zip(before.held_out, after.held_out, strict=True)
    numbers = tuned_numbers(tunables, found, after.taught, "InnovationLikelihood")
    return RecordTuning(
        observer=tunables.applied(record.replay, found).observer,
        numbers=numbers,
        nulls=null_directions(tunables, found, after.taught),
        likelihood=likelihood,
        inconsistency=inconsistency,
        status=descent.status,
        warnings=of_record(after.nis, record.every * _HELD_OUT, numbers),
    )


def _record(
    observer: AbstractObserver, volts: np.ndarray, force: np.ndarray, free: Group, sample_rate: float,
    settle: float,
) -> _Record:  # fmt: skip
    """The record in pieces behind `settle` [s], of as many whole readings each."""
    replay = Replay(observer)
    tunables = resolved(replay, free, sample_rate, len(volts) / sample_rate)
    readings, numbers = readings_after_settling(observer, len(volts), math.ceil(settle * sample_rate))
    every = readings // _SEGMENTS
    if not every:
        raise InputError(
            f"A record must have {_SEGMENTS} readings of the observer behind `settle`, samples or blocks, but has "
            f"{readings}; record longer, or take shorter blocks."
        )
    return _Record(
        replay, tunables, jnp.asarray(volts), jnp.asarray(force), 1.0 / sample_rate, every,
        every * (_SEGMENTS - _HELD_OUT) * numbers,
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
