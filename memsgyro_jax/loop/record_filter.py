"""An observer over recorded voltages and forces: no simulation and no truth."""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Scalar

from .blocks.block_filter import BlockFilter
from .observers.base import AbstractObserver, Clock, Estimate


class FilteredRecord(NamedTuple):
    """What an observer says at `time` [s]; the leaves of `estimate` have the times as leading axis."""

    time: Float[Array, " times"]
    estimate: Estimate


def filter_record(
    observer: AbstractObserver, volts: Float[Array, "samples 2"], force: Float[Array, "samples 2"], *,
    sample_rate: float | str, every: int = 512,
) -> FilteredRecord:  # fmt: skip
    """What `observer` says after `every` so many samples of a record; a `BlockFilter` after its start and every block.

    Row k holds the voltages [V] at the end of sample k and the force [N] during it. Samples at the end that make up no
    whole number of them are left out. Differentiable by the observer's numbers, and can be vmapped over them.

    Raises `InputError` for a record of another shape, with gaps, or shorter than the first row of the result.
    """
    volts, force = (jnp.asarray(rows, float) for rows in (volts, force))
    for name, rows in (("volts", volts), ("force", force)):
        if rows.ndim != 2 or rows.shape[1] != 2 or rows.shape != volts.shape:
            raise InputError(
                f"Argument `{name}` must have one row per sample and two columns, but has shape {rows.shape}."
            )
        if is_concrete(rows) and not np.all(np.isfinite(rows)):
            row = int(np.argmin(np.all(np.isfinite(rows), axis=1)))
            raise InputError(f"Argument `{name}` must hold finite numbers only, but row {row} does not.")
    least = observer.start if isinstance(observer, BlockFilter) else every
    if not 1 <= least <= len(volts):
        raise InputError(
            f"A record must hold the {least} samples of its first row, at least one, but has {len(volts)}."
        )
    run = _in_blocks if isinstance(observer, BlockFilter) else partial(_one_by_one, every=every)
    return run(observer, volts, force, 1.0 / quantity("sample_rate", sample_rate, "Hz"))


def readings_after_settling(observer: AbstractObserver, samples: int, settled: int = 0) -> tuple[int, int]:
    """How many a record of so many samples has behind those that are `settled`, and of how many independent numbers of
    a channel each is made: samples, or behind a start whole blocks of projections.
    """
    if isinstance(observer, BlockFilter):
        before, whole = max(settled - observer.start, 0), max(samples - observer.start, 0) // observer.length
        return max(whole + -before // observer.length, 0), observer.statistics
    return samples - settled, 1


def told_by_record(
    observer: AbstractObserver, volts: Float[Array, "samples 2"], force: Float[Array, "samples 2"], period: Scalar,
    pieces: int, every: int,
) -> Float[Array, "pieces 3"]:  # fmt: skip
    """What was not expected in the last `pieces` of a record, of `every` readings each: means of their nats and of the
    squares, over the variance claimed, of both channels.

    Raises `InputError` for an observer that claims nothing for its innovations.
    """
    first = readings_after_settling(observer, len(volts))[0] - pieces * every
    if isinstance(observer, BlockFilter):
        found = _in_blocks(observer, volts, force, period).estimate
        told = _told(jax.tree.map(lambda leaf: leaf[1 + first :], found))
        return jnp.mean(told.reshape(pieces, every, -1), axis=1)

    def sample(carry: tuple[Any, Array], entering: tuple[Array, ...]) -> tuple[tuple[Any, Array], None]:
        state, total = carry
        state = _taken(observer, state, entering, period)
        return (state, total + _told(observer.estimate(state))), None

    def row(state: Any, entering: tuple[Array, ...]) -> tuple[Any, Array]:
        (state, total), _ = jax.lax.scan(sample, (state, jnp.zeros(3)), entering)
        return state, total / every

    start = _through(observer, _begun(observer), volts[:first], force[:first], 0, period)
    numbers = first + 1 + jnp.arange(pieces * every)
    entering = jax.tree.map(
        lambda part: part.reshape(pieces, every, *part.shape[1:]), (numbers, volts[first:], force[first:])
    )
    return jax.lax.scan(row, start, entering)[1]


def _told(estimate: Estimate) -> Float[Array, "*rows 3"]:
    innovation = estimate.innovation
    if innovation is None:
        raise InputError(
            "The observer must claim a variance for its innovations, as an `ExtendedKalmanFilter` does, but this one "
            "claims none."
        )
    return jnp.stack([innovation.nats, *innovation.squared], axis=-1)


def _begun(observer: AbstractObserver) -> Any:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), observer.init())


@eqx.filter_jit
def _one_by_one(observer: AbstractObserver, volts: Array, force: Array, period: float, every: int) -> FilteredRecord:
    ends, first = _rows((volts, force), 0, every)

    def row(state, entering):
        end, measured, held = entering
        state = _through(observer, state, measured, held, end - every, period)
        return state, observer.estimate(state)

    return FilteredRecord(period * ends, jax.lax.scan(row, _begun(observer), (ends, *first))[1])


@eqx.filter_jit
def _in_blocks(observer: BlockFilter, volts: Array, force: Array, period: float) -> FilteredRecord:
    start, alone = observer.start, observer.filter
    state = observer.begun(_through(alone, _begun(alone), volts[:start], force[:start], 0, period), period)

    def block(state, entering):
        end, measured, held = entering
        state = observer.taken(state, measured, held, Clock(end * period, end, period))
        return state, observer.estimate(state)

    ends, blocks = _rows((volts, force), start, observer.length)
    rows = jax.lax.scan(block, state, (ends, *blocks))[1]
    joined = jax.tree.map(lambda a, b: jnp.concatenate([jnp.asarray(a)[None], b]), observer.estimate(state), rows)
    return FilteredRecord(period * jnp.concatenate([jnp.array([start]), ends]), joined)


def _rows(parts: tuple[Array, ...], start: int, length: int) -> tuple[Array, tuple[Array, ...]]:
    """The samples behind `start` in rows of `length`, and at which sample each ends."""
    count = (len(parts[0]) - start) // length
    rows = tuple(part[start : start + count * length].reshape(count, length, -1) for part in parts)
    return start + length * jnp.arange(1, count + 1), rows


def _through(
    observer: AbstractObserver, state: Any, volts: Array, force: Array, before: int | Array, period: float
) -> Any:
    """The state after some samples, `before` which so many have passed."""

    step = lambda state, at: (_taken(observer, state, at, period), None)  # noqa: E731
    return jax.lax.scan(step, state, (before + jnp.arange(1, len(volts) + 1), volts, force))[0]


def _taken(observer: AbstractObserver, state: Any, entering: tuple[Array, ...], period: Scalar) -> Any:
    """The state after a sample: its number, volts and forces."""
    number, measured, held = entering
    return observer.update(state, tuple(measured), tuple(held), Clock(number * period, number, period))
