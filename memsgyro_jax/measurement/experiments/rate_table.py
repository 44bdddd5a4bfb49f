"""Rate table: driven at one frequency, demodulated block by block by a lock-in while the table turns."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from ..envelope import HARMONICS, Driven
from ..model import Conditions, Model
from ..steady import fundamental, steady_state
from .base import Experiment, Noise


class RateTable(Experiment):
    """Phasors of consecutive lock-in blocks, each the mean over a whole number of drive cycles.

    The device has settled at the conditions of the first block when the record begins. Conditions are constant within a
    block.

    Args:
        name: of the record.
        time: middle of each block [s], (n,).
        measured: phasors (n, axes) [V].
        noise: how far they may lie from the prediction.
        frequency: of the drive [rad/s].
        force: amplitude per axis [N], (axes,).
        surroundings: conditions per block, the rate among them.
        block_cycles: drive cycles per block.
    """

    name: str = eqx.field(static=True)
    time: Float[Array, " n"]
    measured: Complex[Array, "n axes"]
    noise: Noise
    frequency: Array
    force: Float[Array, " axes"]
    surroundings: Conditions
    block_cycles: int = eqx.field(static=True)

    def predict(self, bench: Model) -> Complex[Array, "n axes"]:
        """Phasors of all channels and blocks."""
        first = jax.tree.map(lambda leaf: leaf[0], self.surroundings)
        driven = Driven.of(bench, self.frequency, self.force, first)
        start = steady_state(bench, self.frequency, driven.force, first, self.measured[0] / bench.scale)
        step = 2 * jnp.pi * self.block_cycles / self.frequency
        _, course = driven.run(start[: HARMONICS + 1], step, self.surroundings)
        seen = driven.demodulated(course, step)
        return jax.vmap(lambda s, c: fundamental(bench, self.frequency, s, driven.force, c))(seen, self.surroundings)

    def conditions(self) -> dict[str, Float[Array, " n"]]:
        """Time and rate of each block."""
        return {
            "time [s]": self.time,
            "rate [rad/s]": self.surroundings.rate,
            "angular acceleration [rad/s²]": self.surroundings.angular_acceleration,
            "temperature [K]": self.surroundings.temperature,
        }
