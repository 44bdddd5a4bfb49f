"""The filter of a lock-in, which still shows what rows further back were."""

from typing import ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.linalg import inverse

from .base import LockInEffect, LockInRow, UntilNow, strength
from .instrument import InstrumentTerm, SeenRows, row_field
from .numbers import setting


MOST_POLES = 8  # 48 dB an octave


class LockInFilter(InstrumentTerm, LockInEffect):
    """The filter of the lock-in: equal poles of the time constant s, one behind the other, four where it falls by 24 dB
    an octave. A row still shows what the rows before it were, and how the device rang from one to the next. Zero: it
    follows at once.

    Stanford Research Systems, "About Lock-In Amplifiers", application note 3: equal stages, one behind the other.

    Args:
        poles: how many, one to eight; no fit moves them, which a search chooses.
    """

    name, unit, law = "lock_in_filter", "s", "V → (1 + s·d/dt)⁻ⁿ·V"
    reference = "Stanford Research Systems, application note 3"
    last: ClassVar[bool] = True
    remembers: ClassVar[bool] = True
    strength: Array = strength((0.0,), low=0.0)
    entry: Array = row_field((((0.0,),),))
    poles: Array = setting(4.0, "1")

    def phasors(self, values: Complex[Array, " axes"], row: LockInRow) -> Complex[Array, " axes"]:
        tau = self.chosen(row)
        seen = shares_of(jnp.where(tau > 0, tau, 1.0), self.poles, row.until_now).of(row.until_now)
        return jnp.where(tau > 0, seen, values)

    def moved(self, seen: SeenRows) -> np.ndarray:
        """Nothing: from none on, as of a step long past."""
        return np.zeros_like(seen.values)


class Shares(NamedTuple):
    """How much a filter shows now of what each of some rows settled to, and of how far from that it began."""

    settled: Complex[Array, "k axes axes"]
    ringing: Complex[Array, "k axes axes"]

    def of(self, rows: UntilNow) -> Complex[Array, " axes"]:
        """What it shows of them all."""
        parts = self.settled @ rows.settled[..., None] + self.ringing @ rows.ringing[..., None]
        return jnp.sum(parts[..., 0], axis=0)


def shares_of(tau: Array, poles: Array | float, rows: UntilNow) -> Shares:
    """What so many equal poles of a time constant [s] show of a motion V + e^{−B(t − t_k)}·Δ within each row."""
    still, one = jnp.zeros_like(rows.decay), jnp.broadcast_to(jnp.eye(rows.settled.shape[-1]) + 0j, rows.decay.shape)
    return Shares(
        _shown(tau, poles, rows.ended, rows.began, still, one),
        _shown(tau, poles, rows.ended, rows.began, rows.decay, rows.left),
    )


def _shown(
    tau: Array, poles: Array | float, ended: Float[Array, " k"], began: Float[Array, " k"],
    decay: Complex[Array, "k axes axes"], left: Complex[Array, "k axes axes"],
) -> Complex[Array, "k axes axes"]:  # fmt: skip
    """What is seen of a motion e^{−Bt} that began a time a ago and ended a time b ago, when `left` was of it:
    (1 − τB)⁻ⁿ·(left·R(b) − R(a)), with R(t) = e^{−t/τ}·Σ_{j<n} ((1/τ − B)·t)^j/j!, and none of an infinite time.
    """
    one = jnp.eye(decay.shape[-1])
    once = jnp.vectorize(inverse, signature="(n,n)->(n,n)")(one - tau * decay)

    def times(age: Array) -> tuple[Array, Array]:
        known = jnp.isfinite(age)
        time = jnp.where(known, age, 0.0)[:, None, None]
        return jnp.where(known[:, None, None], jnp.exp(-time / tau), 0.0), (one / tau - decay) * time

    (after, late), (before, early) = times(ended), times(began)
    seen, slower, since, until = jnp.zeros_like(decay), one, after * one, before * one
    parts = since, until
    for stage in range(1, MOST_POLES + 1):
        slower = slower @ once
        seen = jnp.where(poles == stage, slower @ (left @ since - until), seen)
        parts = parts[0] @ late / stage, parts[1] @ early / stage
        since, until = since + parts[0], until + parts[1]
    return seen
