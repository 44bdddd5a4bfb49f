"""What a lock-in makes of the phasors that a bench would show: the effects of the instrument, row by row."""

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float, Int

from memsgyro_jax.base.few_at_a_time import over_rows
from memsgyro_jax.base.linalg import exponential, inverse
from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.effects.base import LockInEffect, LockInRow, UntilNow

from .model import Model


class RowsBefore(NamedTuple):
    """Which rows of a sweep lie before each.

    Args:
        rows: (n, k) their places, the last of them first.
        ages: (n, k) times since each was read [s], infinite where there was none, or no clock.
    """

    rows: Int[Array, "n k"]
    ages: Float[Array, "n k"]


def through_lock_in(
    bench: Model,
    phasors: Complex[Array, "n axes"],
    frequency: Float[Array, " n"],
    force: Complex[Array, "n axes"],
    before: Complex[Array, "n axes"],
    conditions: Conditions,
    dwell: Float[Array, " n"] | None = None,
    unsettled: Float[Array, " n"] | None = None,
    rows_before: RowsBefore | None = None,
) -> Complex[Array, "n axes"]:
    """Phasors [V] as the lock-in gives them; `frequency`, `force` and `conditions` may hold for all rows.

    Args:
        dwell: time since the row before [s], infinite where none is known; `None` where it is known of no row.
        unsettled: one for rows that were read before they had settled, zero for the others; `None` where all had.
        rows_before: each row; `None` where they stand alone, and effects that remember have nothing to remember.
    """
    effects = [effect for effect in bench.effects if isinstance(effect, LockInEffect)]
    remembers = rows_before is not None and any(effect.remembers for effect in effects)
    clocked = dwell is not None and (unsettled is not None or any(effect.rings for effect in effects))
    if not effects and not clocked:
        return phasors

    first, last = ([effect for effect in effects if effect.last is last] for last in (False, True))

    def shown(values: Array, conditions: Conditions, apart: Array, row: LockInRow) -> tuple[Array, LockInRow]:
        if clocked:
            own = _ring_down(bench, row.frequency, conditions, row.dwell)
            row = dataclasses.replace(row, **dict(zip(("dwell", "decay", "left"), own, strict=True)))
        values = _acted(first, values, row)
        rings = clocked and not remembers
        return values + apart * (row.left @ (row.before - values)) if rings else values, row

    rows = _rows(frequency, force, before, conditions, dwell)
    apart = jnp.zeros(len(phasors)) if unsettled is None else unsettled
    values, rows = jax.vmap(shown)(phasors, conditions.rows(len(phasors)), apart, rows)
    if not remembers:
        return jax.vmap(partial(_acted, last))(values, rows)
    moved = until_now(bench, values, frequency, conditions, dwell, unsettled, rows_before)
    return over_rows(partial(_acted, last), values, dataclasses.replace(rows, until_now=moved))


def until_now(
    bench: Model,
    values: Complex[Array, "n axes"],
    frequency: Float[Array, " n"],
    conditions: Conditions,
    dwell: Float[Array, " n"] | None,
    unsettled: Float[Array, " n"] | None,
    before: RowsBefore,
) -> UntilNow:
    """How a device moved until each of some rows was read (n, k, ...), which settle to `values` [V]; the others as in
    `through_lock_in`. One that is not `unsettled` settled at once.
    """
    count, axes = values.shape
    decay = left = jnp.zeros((count, axes, axes), complex)
    ringing = jnp.zeros((count, axes), complex)
    if dwell is not None and unsettled is not None:
        rows = frequency, conditions.rows(count), dwell
        dwell, decay, left = jax.vmap(partial(_ring_down, bench))(*rows)
        _, ringing = jax.lax.scan(_began, values[0] + 0j, (values, left, unsettled * (dwell > 0)))
    places = jnp.concatenate([jnp.arange(count)[:, None], before.rows], axis=1)
    return UntilNow(
        *(part[places] for part in (values, ringing, decay, left)),
        began=jnp.pad(before.ages, ((0, 0), (0, 1)), constant_values=jnp.inf),
        ended=jnp.pad(before.ages, ((0, 0), (1, 0))),
    )


def _began(at: Array, row: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """Where a row ends that begins at some motion, and how far from where it settles it began."""
    settled, left, rings = row
    begun = rings * (at - settled)
    return settled + left @ begun, begun


def _ring_down(bench: Model, omega: Array, conditions: Conditions, dwell: Array) -> tuple[Array, Array, Array]:
    """Dwell of a row, B, and what is left after it, e^{−B·dwell}: zero where the dwell is unknown."""
    known = jnp.isfinite(dwell)
    decay, dwell = ring_down_matrix(bench, omega, conditions) * known, jnp.where(known, dwell, 0.0)
    return dwell, decay, (jnp.exp if bench.axes == 1 else exponential)(-decay * dwell) * known


def with_interference(bench: Model, shown: Array, now: Conditions) -> Array:
    """Phasors (n, axes) of a motion that nothing drives [V], or voltages of any, with what an instrument adds to them
    whatever moves.
    """
    effects = [e for e in bench.effects if isinstance(e, LockInEffect) and e.beside_any_motion]
    if not effects:
        return shown

    still = jnp.zeros_like(shown)
    return jax.vmap(partial(_acted, effects))(shown, _rows(jnp.zeros(()), still, still, now, None))


def before_lock_in(
    bench: Model,
    phasors: Complex[Array, "n axes"],
    frequency: Float[Array, " n"],
    force: Complex[Array, "n axes"],
    conditions: Conditions,
) -> Complex[Array, "n axes"]:
    """What a bench shows where the lock-in gives these phasors [V]: turned, scaled and shifted back row by row, as
    those terms of an instrument have it that ask no other row.
    """
    effects = [e for e in bench.effects if isinstance(e, LockInEffect) and not (e.last or e.rings)]
    if not effects:
        return phasors

    given = partial(_acted, effects)

    def one(values: Array, row: LockInRow) -> Array:
        shift = given(jnp.zeros_like(values), row)
        return (values - shift) / (given(jnp.ones_like(values), row) - shift)

    return jax.vmap(one)(phasors, _rows(frequency, force, phasors, conditions, None))


def _acted(effects: Sequence[LockInEffect], values: Array, row: LockInRow) -> Array:
    """What effects make of the phasors of a row, one after the other."""
    for effect in effects:
        values = effect.phasors(values, row)
    return values


def _rows(
    frequency: Array, force: Array, before: Complex[Array, "n axes"], conditions: Conditions, dwell: Array | None
) -> LockInRow:
    """What the lock-in knows of every row."""
    (count, axes), surroundings = before.shape, conditions.rows(len(before))
    return LockInRow(
        frequency=jnp.broadcast_to(frequency, (count,)),
        force=jnp.broadcast_to(force, (count, axes)),
        before=before,
        record=surroundings.record,
        sweep=surroundings.sweep,
        time=surroundings.time,
        dwell=jnp.zeros(count) if dwell is None else dwell,
        decay=jnp.zeros((count, axes, axes), complex),
        left=jnp.zeros((count, axes, axes), complex),
        until_now=jax.vmap(UntilNow.settled_at)(before),
    )


def ring_down_matrix(bench: Model, omega: Array, conditions: Conditions) -> Complex[Array, "axes axes"]:
    """B [1/s] such that a motion Re[(q + Δ)·e^{iωt}] away from the settled one, q, goes on as Δ' = −B·Δ.

    Of a linear motion with stiffness K and damping D per mass, B = (2iω + D)⁻¹·(K − ω² + iωD): exact but for Δ'', a
    part 1/(4Q) of it. The phase of a drive whose frequency is stepped goes on, and so does Δ + q.
    """
    axes, one = bench.axes, jnp.eye(bench.axes)
    matrix, _ = bench.linear(conditions)
    stiffness, damping = -matrix[axes : 2 * axes, :axes], -matrix[axes : 2 * axes, axes : 2 * axes]
    return inverse(2j * omega * one + damping) @ (stiffness - omega**2 * one + 1j * omega * damping)
