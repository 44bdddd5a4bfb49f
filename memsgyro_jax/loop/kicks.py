"""How far effects that act as kicks, once in a sample, bring a run from what they would do at every moment."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.device.propagate import Exact

from .loop import ClosedLoop, LoopState
from .observers.base import Clock
from .with_effects import own_start


ORDER = 2  # of the kick in the period: half of it leaves a quarter of the error


def kick_error(
    loop: ClosedLoop, forces: Float[np.ndarray, "samples 2"], rate: Float[np.ndarray, " samples"], period: float
) -> Float[np.ndarray, "samples 2"]:
    """Error of the displacement [m] at the end of each sample, under forces [N] that were held in a run at rates
    [rad/s]: from kicks at half the period, whose error is a quarter. Zero for a device without effects, and for a loop
    that does not compute them by kicks.
    """
    if not loop.present.device.effects or not isinstance(loop.discretisation, Exact):
        return np.zeros_like(forces)
    loop = loop.present.sampled_at(1.0 / period, duration=len(forces) * period)
    whole, halves = (np.asarray(_replayed(loop, forces, rate, period, parts)) for parts in (1, 2))
    return (whole - halves) / (1.0 - 0.5**ORDER)


def _replayed(loop: ClosedLoop, forces: np.ndarray, rate: np.ndarray, period: float, parts: int) -> Array:
    """Displacements at the ends of samples, each computed in so many parts."""
    step = period / parts

    def one(state: LoopState, given: tuple[Array, Array, Array]) -> tuple[LoopState, Array]:
        number, force, rate = given
        around = Conditions(rate, temperature=None, bias_voltage=None)
        for part in range(parts):
            clock = Clock(number * period + part * step, parts * number + part, step)
            motion, own, _ = loop._moved(state, around, force, clock, None)
            state = LoopState(motion, None, None, None, own)
        return state, jnp.stack(state.motion[:2])

    start = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tuple(loop.start))
    begin = LoopState(start, None, None, None, own_start(loop.device, start))
    samples = jnp.arange(len(forces)), tuple(jnp.asarray(forces).T), jnp.asarray(rate)
    return jax.jit(lambda: jax.lax.scan(one, begin, samples)[1])()
