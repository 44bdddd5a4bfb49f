"""The same bench in the coordinates in which a sweep sees it: the couplings as they appear in the sense channel.

Data fix ρ·C(ωx) and |ρ|·λ (ρ the complex gain of the sense channel over the drive channel) far better than ρ, C and λ
alone, which makes a long curved valley of the likelihood. Here the products are the coordinates, and the valley is
straight.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from memsgyro_jax.effects import FiniteSweepRate, ReadoutDelay
from memsgyro_jax.effects.readout_delay import behind

from .bench import Bench, LeakPhasors, LockIn, offset_in
from .modes import CoupledModes


class SeenBench(eqx.Module):
    """A `Bench`, one to one. `coupling` is (real, imaginary) of ρ·(α + iωx·η), `force_yx` |ρ|·λyx and `force_xy`
    λxy/|ρ|, ρ = gain ratio · e^{i asymmetry}. With a `delay` the phase of the read-out is that at ωx, delay included:
    over a narrow band the phase of a late read-out at zero frequency is nobody's to tell.
    """

    omega: Array = eqx.field(converter=jnp.asarray)
    quality: Array = eqx.field(converter=jnp.asarray)
    coupling: Array = eqx.field(converter=jnp.asarray)
    force_yx: Array = eqx.field(converter=jnp.asarray)
    force_xy: Array = eqx.field(converter=jnp.asarray)
    readout: LockIn
    feedthrough: LeakPhasors | None = None
    sweep_rate: FiniteSweepRate | None = None
    delay: ReadoutDelay | None = None
    offsets: Array | None = None

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
            _turned(readout, bench.delay, -device.omega[0]),
            bench.feedthrough,
            bench.sweep_rate,
            bench.delay,
            bench.offsets,
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

    @property
    def couplings(self) -> Array:
        """λyx, λxy, and cxy [1/s] and kxy [1/s²] per unit mass."""
        device = self.device
        return jnp.stack([device.force_yx, device.force_xy, device.damping_coupling, device.stiffness_coupling])

    def bench(self) -> Bench:
        """Back to device and read-out."""
        readout = _turned(self.readout, self.delay, self.omega[0])
        return Bench(self.device, readout, self.feedthrough, self.sweep_rate, self.delay, self.offsets)

    def during(self, number: int) -> CoupledModes:
        """As `Bench.during`."""
        return offset_in(self.device, self.offsets, number)

    def behind(self, frequency: Array) -> Array:
        """As `Bench.behind`, beside what the phase of the read-out holds already."""
        return jnp.ones(()) if self.delay is None else behind(self.delay.strength, frequency - self.omega[0])


def _turned(readout: LockIn, delay: ReadoutDelay | None, omega: Array) -> LockIn:
    """The read-out with the phase ω·delay added."""
    if delay is None:
        return readout
    return eqx.tree_at(lambda r: r.phase, readout, readout.phase + omega * delay.strength)
