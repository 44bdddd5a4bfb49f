"""What a lock-in makes of the phasors that a bench would show: the effects of the instrument, row by row."""

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float, Int

from memsgyro_jax.base.few_at_a_time import over_rows
from memsgyro_jax.base.linalg import exponential, inverse, product
from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.effects.base import LockInEffect, LockInRow, UntilNow

from .bent_transient import Bent, BentRow
from .model import Model
from .steady import Fineness


PARTS = 12  # of a row of a bent resonance as a filter sees it


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
    bent: Bent | None = None,
) -> Complex[Array, "n axes"]:
    """Phasors [V] as the lock-in gives them; `frequency`, `force` and `conditions` may hold for all rows.

    Args:
        dwell: time since the row before [s], infinite where none is known; `None` where it is known of no row.
        unsettled: one for rows that were read before they had settled, zero for the others; `None` where all had.
        rows_before: each row; `None` where they stand alone, and effects that remember have nothing to remember.
        bent: the settled states, of a device that is not linear; `None` where rows ring down as the linear device does.
    """
    effects = [effect for effect in bench.effects if isinstance(effect, LockInEffect)]
    remembers = rows_before is not None and any(effect.remembers for effect in effects)
    clocked = dwell is not None and (unsettled is not None or any(effect.rings for effect in effects))
    if not effects and not clocked:
        return phasors

    first, last = ([effect for effect in effects if effect.last is last] for last in (False, True))
    rows, around = lock_in_rows(frequency, force, before, conditions, dwell), conditions.rows(len(phasors))
    apart = jnp.zeros(len(phasors)) if unsettled is None else unsettled
    if bent is not None:
        return _through_bent(bench, phasors, rows, around, apart, rows_before if remembers else None, bent)

    def shown(values: Array, conditions: Conditions, apart: Array, row: LockInRow) -> tuple[Array, LockInRow]:
        row = _clocked(bench, row, conditions) if clocked else row
        values = _acted(first, values, row)
        rings = clocked and not remembers
        return values + apart * (row.left @ (row.before - values)) if rings else values, row

    values, rows = jax.vmap(shown)(phasors, around, apart, rows)
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
    places, began, ended = rows_and_ages(before)
    return UntilNow(*(part[places] for part in (values, ringing, decay, left)), began=began, ended=ended)


def _through_bent(
    bench: Model, phasors: Array, rows: LockInRow, conditions: Conditions, apart: Array, before: RowsBefore | None,
    bent: Bent,
) -> Complex[Array, "n axes"]:  # fmt: skip
    """`through_lock_in` of a device that is not linear."""
    last = [effect for effect in bench.effects if isinstance(effect, LockInEffect) and effect.last]
    if before is None:

        def read(values: Array, conditions: Conditions, row: LockInRow, apart: Array, state: Array) -> Array:
            values, row, bend = _bend(bench, bent.fineness, values, conditions, row, state)
            return _acted(last, values + bend.course(row.before - values, apart * row.dwell)[-1], row)

        return over_rows(read, phasors, conditions, rows, apart, bent.states)

    values, rows, course = bent_course(bench, phasors, rows, conditions, apart, bent)

    def seen(values: Array, row: LockInRow, *before: Array) -> Array:
        return _acted(last, values, dataclasses.replace(row, until_now=course.until_now(*before)))

    return over_rows(seen, values, rows, *rows_and_ages(before))


def _bend(
    bench: Model, fineness: Fineness, values: Array, conditions: Conditions, row: LockInRow, state: Array
) -> tuple[Array, LockInRow, BentRow]:
    """What a row of settled phasors shows before `last` effects, what its clock tells, and how it goes on."""
    first = [effect for effect in bench.effects if isinstance(effect, LockInEffect) and not effect.last]
    row, still = _clocked(bench, row, conditions), jnp.zeros_like(values)
    turned = _acted(first, still + 1.0, row) - _acted(first, still, row)
    return _acted(first, values, row), row, BentRow.of(bench, row, conditions, state, fineness, turned)


def bent_course(
    bench: Model, phasors: Array, rows: LockInRow, conditions: Conditions, apart: Array, bent: Bent, parts: int = PARTS
) -> "tuple[Array, LockInRow, BentCourse]":
    """What rows (n,) of settled phasors show before `last` effects, what their clock tells, and how the device came
    there from row to row, in so many parts of each; `apart` is zero of a row that settled at once.
    """
    values, rows, bends = over_rows(partial(_bend, bench, bent.fineness), phasors, conditions, rows, bent.states)
    return values, rows, BentCourse.of(values, rows, bends, apart * rows.dwell, parts)


class BentCourse(NamedTuple):
    """How a device that is not linear moved in rows (n, ...), in parts of each row that last as long: in each it goes
    from its begin to its end as a linear device does that settles elsewhere. Fields as in `UntilNow`.
    """

    settled: Complex[Array, "n parts axes"]
    ringing: Complex[Array, "n parts axes"]
    decay: Complex[Array, "n parts axes axes"]
    left: Complex[Array, "n parts axes axes"]

    @classmethod
    def of(cls, values: Array, rows: LockInRow, bends: BentRow, dwell: Float[Array, " n"], parts: int) -> "BentCourse":
        """Of rows that settle to `values` [V] and begin where the row before ended; the `dwell` of one that settles at
        once is zero.
        """

        def row(at: Array, given: tuple[Array, BentRow, Array]) -> tuple[Array, Array]:
            settled, bend, dwell = given
            away = jnp.concatenate([(at - settled)[None], bend.course(at - settled, dwell, parts)])
            return settled + away[-1], away

        _, away = jax.lax.scan(row, values[0] + 0j, (values, bends, dwell))
        rings, one = (dwell > 0)[:, None, None], jnp.eye(values.shape[1])
        step = rows.decay * rows.dwell[:, None, None] / parts
        left = jnp.where(rings, jax.vmap(jnp.exp if len(one) == 1 else exponential)(-step), 0.0)
        gone = product(jax.vmap(inverse)(one - left)[:, None], away[:, :-1] - away[:, 1:])
        settled = values[:, None] + jnp.where(rings, away[:, :-1] - gone, 0.0)
        decay, left = (jnp.repeat(part[:, None], parts, axis=1) for part in (rows.decay, left))
        return cls(settled, jnp.where(rings, gone, 0.0), decay, left)

    def until_now(self, places: Int[Array, " k"], began: Float[Array, " k"], ended: Float[Array, " k"]) -> UntilNow:
        """Of rows at some places, which began and ended so long ago [s]."""
        length = jnp.where(jnp.isfinite(began), began - ended, 0.0)[:, None]
        edges = ended[:, None] + length * jnp.linspace(1.0, 0.0, self.settled.shape[1] + 1)
        begins, ends = edges[:, :-1].at[:, 0].set(began), edges[:, 1:]
        settled, ringing, decay, left = (part[places].reshape(-1, *part.shape[2:]) for part in self)
        return UntilNow(settled, ringing, decay, left, began=begins.ravel(), ended=ends.ravel())


def rows_and_ages(before: RowsBefore) -> tuple[Array, Array, Array]:
    """Places (n, k + 1) of each row and those before it, and how long ago they began and ended [s]."""
    places = jnp.concatenate([jnp.arange(len(before.rows))[:, None], before.rows], axis=1)
    began = jnp.pad(before.ages, ((0, 0), (0, 1)), constant_values=jnp.inf)
    return places, began, jnp.pad(before.ages, ((0, 0), (1, 0)))


def _began(at: Array, row: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """Where a row ends that begins at some motion, and how far from where it settles it began."""
    settled, left, rings = row
    begun = rings * (at - settled)
    return settled + left @ begun, begun


def _clocked(bench: Model, row: LockInRow, conditions: Conditions) -> LockInRow:
    """A row with what its clock tells."""
    own = _ring_down(bench, row.frequency, conditions, row.dwell)
    return dataclasses.replace(row, **dict(zip(("dwell", "decay", "left"), own, strict=True)))


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
    return jax.vmap(partial(_acted, effects))(shown, lock_in_rows(jnp.zeros(()), still, still, now, None))


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

    return jax.vmap(one)(phasors, lock_in_rows(frequency, force, phasors, conditions, None))


def _acted(effects: Sequence[LockInEffect], values: Array, row: LockInRow) -> Array:
    """What effects make of the phasors of a row, one after the other."""
    for effect in effects:
        values = effect.phasors(values, row)
    return values


def lock_in_rows(
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
