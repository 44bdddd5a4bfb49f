"""Frequency sweep of a `Model` with any effects, each row at its own condition: drive, temperature, bias, rate."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.linalg import inverse
from memsgyro_jax.effects.base import SweepEffect

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
        direction: +1 where the frequency rose towards a row, −1 where it fell.
    """

    name: str = eqx.field(static=True)
    frequency: Float[Array, " n"]
    force: Complex[Array, "n axes"]
    measured: Complex[Array, "n axes"]
    noise: Noise
    surroundings: Conditions
    near: Complex[Array, "n axes"]
    direction: Float[Array, " n"]

    def predict(self, bench: Model) -> Complex[Array, "n axes"]:
        """Phasors of all channels."""

        speeds = [effect.speed() for effect in bench.effects if isinstance(effect, SweepEffect)]

        def row(omega: Array, force: Array, conditions: Conditions, near: Array, direction: Array) -> Array:
            state = steady_state(bench, omega, force, conditions, near)
            for speed in speeds:
                state = state.at[1].add(sweep_lag(bench, omega, force, conditions, direction * speed))
            return fundamental(bench, omega, state, force, conditions)

        return jax.vmap(row)(self.frequency, self.force, self.surroundings, self.near, self.direction)

    def conditions(self) -> dict[str, Float[Array, " n"]]:
        """Frequency, drive level, temperature, bias and rate of each row."""
        return {
            "frequency [rad/s]": self.frequency,
            "drive [N]": jnp.sqrt(jnp.sum(jnp.abs(self.force) ** 2, axis=1)),
            "temperature [K]": self.surroundings.temperature,
            "bias [V]": self.surroundings.bias_voltage,
            "rate [rad/s]": self.surroundings.rate,
        }


def sweep_lag(model: Model, omega: Array, force: Array, conditions: Conditions, beta: Array) -> Complex[Array, " n"]:
    """What a sweep whose frequency moves at `beta` [rad/s²] adds to the settled state; exactly zero at zero.

    With L = iω − A the response to a chirp is ∫₀^∞ e^{−Ls + iβs²/2}·b ds, here its asymptotic series
    iβL⁻³b + 3(iβ)²L⁻⁵b + 15(iβ)³L⁻⁷b: for sweeps that move little, √β against the half width of a resonance.
    """
    matrix, gain = model.linear(conditions)
    invert = inverse(1j * omega * jnp.eye(model.size) - matrix)
    term, total, factor = invert @ (gain @ force), 0.0, 1.0 + 0j
    for odd in (1.0, 3.0, 5.0):
        term, factor = invert @ (invert @ term), factor * odd * 1j * beta
        total = total + factor * term
    return total
