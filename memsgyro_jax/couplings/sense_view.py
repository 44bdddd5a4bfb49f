"""The same bench in the coordinates in which a sweep sees it: the couplings as they appear in the sense channel.

Data fix ρ·C(ωx) and |ρ|·λ (ρ the complex gain of the sense channel over the drive channel) far better than ρ, C and λ
alone, which makes a long curved valley of the likelihood. Here the products are the coordinates, and the valley is
straight.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from memsgyro_jax.effects import FiniteSweepRate

from .bench import Bench, LeakPhasors, LockIn
from .modes import CoupledModes


class SeenBench(eqx.Module):
    """A `Bench`, one to one. `coupling` is (real, imaginary) of ρ·(α + iωx·η), `force_yx` |ρ|·λyx and `force_xy`
    λxy/|ρ|, ρ = gain ratio · e^{i asymmetry}.
    """

    omega: Array = eqx.field(converter=jnp.asarray)
    quality: Array = eqx.field(converter=jnp.asarray)
    coupling: Array = eqx.field(converter=jnp.asarray)
    force_yx: Array = eqx.field(converter=jnp.asarray)
    force_xy: Array = eqx.field(converter=jnp.asarray)
    readout: LockIn
    feedthrough: LeakPhasors | None = None
    sweep_rate: FiniteSweepRate | None = None

    @classmethod
    def of(cls, bench: Bench) -> "SeenBench":
        """The coordinates of a bench."""
        device, readout = bench.device, bench.readout
        seen = readout.gain_ratio * jnp.exp(1j * readout.phase_asymmetry)
        seen = seen * (device.stiffness_coupling + 1j * device.omega[0] * device.damping_coupling)
        return cls(
            device.omega,
            device.quality,
            jnp.stack([seen.real, seen.imag]),
            device.force_yx * readout.gain_ratio,
            device.force_xy / readout.gain_ratio,
            readout,
            bench.feedthrough,
            bench.sweep_rate,
        )

    @property
    def device(self) -> CoupledModes:
        """The device behind the read-out."""
        ratio, phase = self.readout.gain_ratio, self.readout.phase_asymmetry
        coupling = (self.coupling[0] + 1j * self.coupling[1]) * jnp.exp(-1j * phase) / ratio
        return CoupledModes(
            self.omega,
            self.quality,
            coupling.imag / self.omega[0],
            coupling.real,
            self.force_yx / ratio,
            self.force_xy * ratio,
        )

    def bench(self) -> Bench:
        """Back to device and read-out."""
        return Bench(self.device, self.readout, self.feedthrough, self.sweep_rate)
