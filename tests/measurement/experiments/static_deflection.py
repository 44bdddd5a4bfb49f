"""Static deflection: where a held force, under a bias voltage, brings the mass to rest. A kind from outside."""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.measurement.columns import force_columns, signal_columns
from memsgyro_jax.measurement.experiments import AbstractRecord, Experiment, Known, Noise, RealNoise, surroundings


class StaticDeflection(Experiment):
    """Voltages (n, axes) at rest under held forces (n, axes) [N]."""

    name: str = eqx.field(static=True)
    measured: jax.Array
    noise: Noise
    force: jax.Array
    around: Conditions

    def predict(self, bench):
        def row(force, around, n=bench.axes):
            state = jnp.zeros(bench.size)
            for _ in range(4):  # Newton's steps towards rest
                slope = jax.jacfwd(bench.derivative)(state, force, around)[n : 2 * n, :n]
                state = state.at[:n].add(-jnp.linalg.solve(slope, bench.derivative(state, force, around)[n : 2 * n]))
            return bench.observe(state, force, jnp.zeros(n), around)

        return jax.vmap(row)(self.force, self.around)


@dataclass(frozen=True, eq=False, kw_only=True)
class StaticDeflectionRecord(AbstractRecord):
    """Held forces (n, axes) [N] and bias voltages (n,) [V] beside the voltages (n, axes) [V] that they cause."""

    kind, extent = "static_deflection", "held forces"
    forces: np.ndarray
    bias: np.ndarray
    signals: np.ndarray
    readings = property(lambda self: self.signals)

    @classmethod
    def read(cls, sheet):
        c = sheet.columns
        return cls(**sheet.common(), forces=c.forces(), bias=c.si("V_bias", "V"), signals=c.signals())

    def columns(self, declared):
        forces = force_columns(self.forces, declared)
        return {**forces, "V_bias [V]": self.bias, **signal_columns(self.signals, declared)}

    def experiment(self, declared, number):
        around = eqx.tree_at(lambda c: c.bias_voltage, surroundings(declared, number, self.rows), self.bias)
        return StaticDeflection("held", self.signals, RealNoise(self.noise_level), self.forces, around)

    def known(self, declared):
        return Known("force", self.forces[:, 0], declared.words.force), Known("bias voltage", self.bias, "V")
