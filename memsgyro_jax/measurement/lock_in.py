"""What a lock-in makes of the phasors that a bench would show: the effects of the instrument, row by row."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

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
) -> Complex[Array, "n axes"]:
    """Phasors [V] as the lock-in gives them; `frequency`, `force` and `conditions` may hold for all rows."""
    effects = sorted((e for e in bench.effects if isinstance(e, LockInEffect)), key=lambda effect: effect.last)
    if not effects:
        return phasors
    count, axes = phasors.shape

    def one(values: Array, row: LockInRow) -> Array:
        for effect in effects:
            values = effect.phasors(values, row)
        return values

    rows = LockInRow(
        frequency=jnp.broadcast_to(frequency, (count,)),
        force=jnp.broadcast_to(force, (count, axes)),
        before=before,
        record=jnp.broadcast_to(conditions.record, (count,)),
        sweep=jnp.broadcast_to(conditions.sweep, (count,)),
        time=jnp.broadcast_to(conditions.time, (count,)),
    )
    return jax.vmap(one)(phasors, rows)
