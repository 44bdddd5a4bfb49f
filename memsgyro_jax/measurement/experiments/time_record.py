"""Raw capture: forces and waveforms sample by sample."""

import equinox as eqx
import jax
from jaxtyping import Array, Float

from ..envelope import simulate
from ..model import Conditions, Model
from .base import Experiment, Noise


class TimeRecord(Experiment):
    """Waveforms under known forces, from rest.

    Args:
        name: of the record.
        time: of each kept sample [s], (n,).
        measured: waveforms (n, axes) [V].
        noise: how far they may lie from the prediction.
        forces: at the beginning of each integration step [N], ((skipped + n)·substeps, axes).
        increments: change of the force within each step: zero for held forces, same shape.
        step: length of an integration step [s].
        surroundings: conditions per integration step.
        substeps: integration steps per sample.
        skipped: samples at the beginning that are simulated but not compared, while an unknown start dies out.
    """

    name: str = eqx.field(static=True)
    time: Float[Array, " n"]
    measured: Float[Array, "n axes"]
    noise: Noise
    forces: Float[Array, "t axes"]
    increments: Float[Array, "t axes"]
    step: Array
    surroundings: Conditions
    substeps: int = eqx.field(static=True, default=1)
    skipped: int = eqx.field(static=True, default=0)

    def predict(self, bench: Model) -> Float[Array, "n axes"]:
        """Voltage of every channel at every kept sample."""
        base = jax.tree.map(lambda leaf: leaf[0], self.surroundings)
        states = simulate(bench, self.forces, self.increments, self.step, self.surroundings, base)
        kept = slice(self.skipped * self.substeps, None, self.substeps)
        now = jax.tree.map(lambda leaf: leaf[kept], self.surroundings)
        return jax.vmap(bench.observe)(states[kept], self.forces[kept], self.increments[kept] / self.step, now)

    def conditions(self) -> dict[str, Float[Array, " n"]]:
        """Time of each sample."""
        return {"time [s]": self.time}
