"""Ring-down: driven from rest for a while, then left alone."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..envelope import Driven
from ..model import Conditions, Model
from .base import Experiment, Noise


class RingDown(Experiment):
    """Waveforms after the drive F cos ωt, begun at rest, was taken away at t = 0 after a whole number of cycles.

    Args:
        name: of the record.
        time: of each sample since the drive was removed [s], evenly spaced, (n,).
        measured: waveforms (n, axes) [V].
        noise: how far they may lie from the prediction.
        frequency: of the drive [rad/s].
        force: amplitude per axis [N], (axes,).
        surroundings: conditions, scalars.
        cycles: of the drive before it was removed.
        late: whether the first sample comes after the removal, rather than with it.
        step_cycles: at most so many drive cycles per step of the integration before the removal.
    """

    name: str = eqx.field(static=True)
    time: Float[Array, " n"]
    measured: Float[Array, "n axes"]
    noise: Noise
    frequency: Array
    force: Float[Array, " axes"]
    surroundings: Conditions
    cycles: int = eqx.field(static=True)
    late: bool = eqx.field(static=True, default=False)
    step_cycles: int = eqx.field(static=True, default=6)

    def predict(self, bench: Model) -> Float[Array, "n axes"]:
        """Voltage of every channel at every sample."""
        driven = Driven.of(bench, self.frequency, self.force, self.surroundings)
        period = 2 * jnp.pi / self.frequency
        cycles = next(part for part in range(self.step_cycles, 0, -1) if self.cycles % part == 0)
        steps = self.surroundings.rows(self.cycles // cycles)
        state, _ = driven.run(driven.at_rest(), cycles * period, steps)
        free = Driven.of(bench, self.frequency, jnp.zeros_like(self.force), self.surroundings)
        step = (self.time[-1] - self.time[0]) / (self.time.size - 1)
        if self.late:
            state, _ = free.run(state, self.time[0], self.surroundings.rows(1))
        _, course = free.run(state, step, self.surroundings.rows(self.time.size - 1))
        states = jnp.concatenate([state[None], course.end])
        quiet = jnp.zeros(bench.axes)

        def sample(state: Array, time: Array) -> Array:
            return bench.observe(free.instant(state, time), quiet, quiet, self.surroundings)

        return jax.vmap(sample)(states, self.time)

    def conditions(self) -> dict[str, Float[Array, " n"]]:
        """Time of each sample."""
        return {"time [s]": self.time}
