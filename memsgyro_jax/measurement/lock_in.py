"""What a lock-in makes of the phasors that a bench would show: the effects of the instrument, row by row."""

import dataclasses
from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.linalg import exponential, inverse
from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.effects.base import LockInEffect, LockInRow

from .model import Model


def through_lock_in(
    bench: Model,
    phasors: Complex[Array, "n axes"],
    frequency: Float[Array, " n"],
    force: Complex[Array, "n axes"],
    before: Complex[Array, "n axes"],
    conditions: Conditions,
    dwell: Float[Array, " n"] | None = None,
    unsettled: Float[Array, " n"] | None = None,
) -> Complex[Array, "n axes"]:
    """Phasors [V] as the lock-in gives them; `frequency`, `force` and `conditions` may hold for all rows.

    Args:
        dwell: time since the row before [s], infinite where none is known; `None` where it is known of no row.
        unsettled: one for rows that were read before they had settled, zero for the others; `None` where all had.
    """
    effects = [effect for effect in bench.effects if isinstance(effect, LockInEffect)]
    clocked = dwell is not None and (unsettled is not None or any(effect.rings for effect in effects))
    if not effects and not clocked:
        return phasors

    def one(values: Array, conditions: Conditions, apart: Array, row: LockInRow) -> Array:
        if clocked:
            known = jnp.isfinite(row.dwell)
            decay, dwell = ring_down_matrix(bench, row.frequency, conditions) * known, jnp.where(known, row.dwell, 0.0)
            left = (jnp.exp if bench.axes == 1 else exponential)(-decay * dwell) * known
            row = dataclasses.replace(row, dwell=dwell, decay=decay, left=left)
        for effect in effects:
            values = values if effect.last else effect.phasors(values, row)
        values = values + apart * (row.left @ (row.before - values)) if clocked else values
        for effect in effects:
            values = effect.phasors(values, row) if effect.last else values
        return values

    rows = _rows(frequency, force, before, conditions, dwell)
    apart = jnp.zeros(len(phasors)) if unsettled is None else unsettled
    return jax.vmap(one)(phasors, conditions.rows(len(phasors)), apart, rows)


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
