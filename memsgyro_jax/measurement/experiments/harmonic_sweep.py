"""Frequency sweep of a `Model` with any effects, each row at its own condition: drive, temperature, bias, rate."""

import dataclasses
from collections.abc import Iterator
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.linalg import inverse
from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.effects.base import SweepEffect

from ..lock_in import through_lock_in
from ..model import Model
from ..steady import FINENESS, Fineness, drive_waveform, fundamental, spectrum, steady_state, waveform
from .base import Experiment, Noise
from .missing_force import receptance


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
        before: phasors (n, axes) that were read in the row before [V]; `None` where each row stands alone.
        fineness: of the harmonic balance; `finer` is the next.
    """

    shows_modes: ClassVar[bool] = True

    name: str = eqx.field(static=True)
    frequency: Float[Array, " n"]
    force: Complex[Array, "n axes"]
    measured: Complex[Array, "n axes"]
    noise: Noise
    surroundings: Conditions
    near: Complex[Array, "n axes"]
    direction: Float[Array, " n"]
    before: Complex[Array, "n axes"] | None = None
    fineness: Fineness = eqx.field(static=True, default=FINENESS[0])

    def predict(self, bench: Model) -> Complex[Array, "n axes"]:
        """Phasors of all channels."""

        speeds = [effect.speed() for effect in bench.effects if isinstance(effect, SweepEffect)]

        def row(omega: Array, force: Array, conditions: Conditions, near: Array, direction: Array) -> Array:
            state = steady_state(bench, omega, force, conditions, near, self.fineness)
            for speed in speeds:
                state = state.at[1].add(sweep_lag(bench, omega, force, conditions, direction * speed))
            return fundamental(bench, omega, state, force, conditions, self.fineness)

        settled = jax.vmap(row)(self.frequency, self.force, self.surroundings, self.near, self.direction)
        before = self.measured if self.before is None else self.before
        return through_lock_in(bench, settled, self.frequency, self.force, before, self.surroundings)

    @eqx.filter_jit
    def followed(self, bench: Model) -> "HarmonicSweep":
        """The same rows, each on the branch of a folded resonance that continues from the row before, as a sweep in
        this direction goes through them: for what was not measured. Each sweep begins at rest.
        """

        def step(before: Array, row: tuple) -> tuple[Array, Array]:
            new, omega, force, conditions = row
            state = steady_state(bench, omega, force, conditions, jnp.where(new, 0.0, before), self.fineness)
            near = state[1, : bench.axes]
            return near, near

        at = self.surroundings
        label = jnp.stack([jnp.broadcast_to(part, self.frequency.shape) for part in (at.record, at.sweep)], axis=1)
        new = jnp.concatenate([jnp.ones(1, bool), jnp.any(label[1:] != label[:-1], axis=1)])
        rest = jnp.zeros(bench.axes, complex)
        near = jax.lax.scan(step, rest, (new, self.frequency, self.force, at))[1]
        return eqx.tree_at(lambda sweep: sweep.near, self, near)

    @property
    def finer(self) -> "HarmonicSweep | None":
        """The same with more harmonics and samples; `None` at the last."""
        place = FINENESS.index(self.fineness) + 1
        return dataclasses.replace(self, fineness=FINENESS[place]) if place < len(FINENESS) else None

    def proposals(self, name: str) -> Iterator[tuple[str, Experiment]]:
        """All sweeps at once, driven harder, on the other axis, warmer and colder, at other bias voltages."""
        again = "repeat the frequency sweeps"
        driven = eqx.tree_at(lambda s: (s.force, s.near), self, (3.0 * self.force, 3.0 * self.near))
        yield f"{again} at 3 times the drive", driven
        if self.force.shape[1] == 2:
            turned = eqx.tree_at(lambda s: (s.force, s.near), self, (self.force[:, ::-1], self.near[:, ::-1]))
            yield f"{again} with the other axis driven", turned
        place = np.arange(self.frequency.shape[0]) % 4
        kelvin = self.surroundings.temperature + jnp.asarray(40.0 * np.sign(place - 1.5))
        heated = eqx.tree_at(lambda s: s.surroundings.temperature, self, kelvin)
        yield f"{again} 40 K below and above the temperature", heated
        volts = jnp.where(self.surroundings.bias_voltage == 0, 5.0, self.surroundings.bias_voltage)
        volts = volts * np.where(place < 2, 0.5, 1.5)
        biased = eqx.tree_at(lambda s: s.surroundings.bias_voltage, self, volts)
        yield f"{again} at half and 1.5 times the bias voltage", biased

    @eqx.filter_jit
    def missing(self, model: Model) -> tuple[Complex[Array, "n a"], Complex[Array, "n a"], Float[Array, "n a a"]]:
        """Per row: the motion seen, the force [N] it takes beyond the model, and |force per displacement|."""
        axes, errors = model.axes, model.motion(self.measured - self.predict(model), self.frequency)

        def row(omega: Array, force: Array, conditions: Conditions, near: Array, error: Array):
            state = steady_state(model, omega, force, conditions, near, self.fineness)
            matrix, _ = model.linear(conditions)
            moved = state.at[1].add(_carried(matrix, omega, error))
            samples = self.fineness.samples
            command, states = drive_waveform(force, samples)[0], waveform(moved, samples)
            rates = jax.vmap(lambda s, u: model.derivative(s, u, conditions))(states, command)
            given = spectrum(rates, 1)[1, axes : 2 * axes]
            missing = (1j * omega * moved[1, axes : 2 * axes] - given) / model.device.mobility
            return moved[1, :axes], missing, jnp.abs(jnp.linalg.inv(receptance(model, matrix, omega)))

        return jax.vmap(row)(self.frequency, self.force, self.surroundings, self.near, errors)


def _carried(matrix: Array, omega: Array, error: Complex[Array, " a"]) -> Complex[Array, " n"]:
    """The state that goes with a displacement: velocity, and how the effects' own linear states follow."""
    axes = error.shape[0]
    motion = jnp.concatenate([error, 1j * omega * error])
    if matrix.shape[0] == 2 * axes:
        return motion
    own = matrix[2 * axes :]
    operator = 1j * omega * jnp.eye(own.shape[0]) - own[:, 2 * axes :]
    return jnp.concatenate([motion, jnp.linalg.solve(operator, own[:, : 2 * axes] @ motion)])


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
