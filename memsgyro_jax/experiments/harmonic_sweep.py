"""Frequency sweep of a `Model` with any effects, every row at its own condition: drive level, temperature, bias, rate."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from ..model import Conditions, Model
from ..steady import fundamental, steady_state
from .base import Experiment, Noise


class HarmonicSweep(Experiment):
    """Settled phasors per row, V(t) = Re[(I + iQ) e^{iωt}] for a drive F cos ωt.

    Closed form where the model is linear, harmonic balance where it is not. The branch of a folded resonance is the one
    nearest to what was measured.

    Args:
        name: of the record.
        frequency: [rad/s], (n,).
        force: complex amplitude per axis [N], (n, axes).
        measured: phasors (n, axes) [V].
        noise: how far they may lie from the prediction.
        surroundings: conditions per row.
        near: displacement phasors (n, axes) [m] that say which branch of a folded resonance is meant.
    """

    name: str = eqx.field(static=True)
    frequency: Float[Array, " n"]
    force: Complex[Array, "n axes"]
    measured: Complex[Array, "n axes"]
    noise: Noise
    surroundings: Conditions
    near: Complex[Array, "n axes"]

    def predict(self, bench: Model) -> Complex[Array, "n axes"]:
        """Phasors of all channels."""

        def row(omega: Array, force: Array, conditions: Conditions, near: Array) -> Array:
            state = steady_state(bench, omega, force, conditions, near)
            return fundamental(bench, omega, state, force, conditions)

        return jax.vmap(row)(self.frequency, self.force, self.surroundings, self.near)

    def conditions(self) -> dict[str, Float[Array, " n"]]:
        """Frequency, drive level, temperature, bias and rate of each row."""
        return {
            "frequency [rad/s]": self.frequency,
            "drive [N]": jnp.sqrt(jnp.sum(jnp.abs(self.force) ** 2, axis=1)),
            "temperature [K]": self.surroundings.temperature,
            "bias [V]": self.surroundings.bias_voltage,
            "rate [rad/s]": self.surroundings.rate,
        }
