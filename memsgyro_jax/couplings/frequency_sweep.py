"""Swept-frequency test: both channels' phasors at each frequency while one electrode is driven."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import wofz
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.plainly import at_once
from memsgyro_jax.measurement.experiments.base import Experiment, Noise

from .bench import Bench
from .modal import partial_fractions


class FrequencySweep(Experiment):
    """Record of a frequency sweep; phasors follow V(t) = Re[(I + iQ) e^{iωt}] for a drive F cos ωt.

    Args:
        frequency: angular frequency of each row [rad/s], in the order in which they were taken.
        measured: phasors of channels x and y per row, in any unit shared by both.
        noise: how far they may lie from the prediction.
        drive: force or command amplitude per row [N, or any unit]; 1 if unknown, the gain then absorbs it.
        start: frequency at which the sweep that a row belongs to began, settled [rad/s]; by default that of the first
            row.
        axis: the driven electrode, 0 = x or 1 = y.
        rate: known angular rate while sweeping [rad/s]; zero at rest.
        number: of the sweep among those of one bench, from 0.
    """

    name: str = eqx.field(static=True)
    frequency: Array = eqx.field(converter=jnp.asarray)
    measured: Array = eqx.field(converter=jnp.asarray)
    noise: Noise
    drive: Array = eqx.field(converter=jnp.asarray)
    start: Array = eqx.field(converter=jnp.asarray)
    rate: Array = eqx.field(converter=jnp.asarray)
    axis: Literal[0, 1] = eqx.field(static=True)
    number: int = eqx.field(static=True)

    def __init__(self, name, frequency, measured, noise, *, drive=1.0, start=None, axis=0, rate=0.0, number=0):
        self.name, self.axis, self.noise, self.number = name, axis, noise, number
        self.frequency, self.measured, self.rate = jnp.asarray(frequency), jnp.asarray(measured), jnp.asarray(rate)
        self.drive = jnp.broadcast_to(jnp.asarray(drive, dtype=self.frequency.dtype), self.frequency.shape)
        self.start = jnp.broadcast_to(self.frequency[0] if start is None else jnp.asarray(start), self.frequency.shape)

    def predict(self, bench: Bench) -> Complex[Array, "n 2"]:
        """Phasors of both channels; closed form, with a finite sweep rate too."""
        device = bench.during(self.number)
        motion = device.response(self.frequency, self.axis, self.rate)
        if bench.sweep_rate is not None:
            lag = chirp_excess(device, self.frequency, self.start, bench.sweep_rate.strength, self.axis, self.rate)
            motion = motion + lag
        signal = motion * bench.readout.channels(self.axis) * bench.behind(self.frequency[:, None])
        if bench.feedthrough is not None:
            signal = signal + bench.feedthrough.phasor(self.axis)
        return signal * self.drive[:, None]

    def conditions(self) -> dict[str, Float[Array, " n"]]:
        """Frequency, drive level and rate of each row."""
        return {
            "frequency [rad/s]": self.frequency,
            "drive [N]": self.drive,
            "rate [rad/s]": jnp.broadcast_to(self.rate, self.frequency.shape),
        }

    def with_measured(self, measured: Complex[Array, "n 2"]) -> "FrequencySweep":
        """The same sweep with other readings, for noise studies."""
        return eqx.tree_at(lambda s: s.measured, self, measured)

    def simulate(self, bench: Bench) -> "FrequencySweep":
        """The same sweep, reading exactly what `bench` predicts."""
        return self.with_measured(self.predict(bench))


@at_once
def chirp_excess(device, frequency: Array, start: Array, speed: Array, axis: int, rate: Array) -> Complex[Array, "n 2"]:
    """How a sweep at `speed` [rad/s²] differs from the settled response [m per m/s²]; exactly zero at zero speed.

    Each pole p answers to a chirp e^{i∫ω dt} with ∫₀^∞ exp(−a s + iβs²/2) ds, a = iω − p, which is
    √π/(2b)·erfcx(a/(2b)) with b = √(−iβ/2); a sweep that starts settled at ω₀ adds the free decay of what the settled
    state there lacks. The direction is that of the rows: β is negative where the frequency falls below its start.
    """
    fractions = partial_fractions(device, axis, rate)
    travelled = jnp.abs(frequency - start)
    direction = jnp.where(jnp.sum(frequency - start) < 0, -1.0, 1.0)
    beta = direction * speed
    moving = speed > 0
    elapsed = travelled / jnp.where(moving, speed, 1.0)

    def of_pole(pole: Array) -> Array:
        here, there = 1j * frequency - pole, 1j * start - pole
        decay = jnp.exp(jnp.where(moving, -here * elapsed + 0.5j * beta * elapsed**2, -jnp.inf))
        return _chirp_excess(here, beta) / here - decay * _chirp_excess(there, beta) / there

    return jnp.einsum("kn,kc->nc", jax.vmap(of_pole)(fractions.poles), fractions.residues)


_SERIES = np.array([1.0, 3.0, 15.0, 105.0, 945.0, 10395.0, 135135.0])  # (2n − 1)!!


def _chirp_excess(a: Array, beta: Array) -> Array:
    """√π z erfcx(z) − 1 with z = a/(2b): by its asymptotic series in w = iβ/a² where that is exact to rounding, else by
    Faddeeva's function.
    """
    w = 1j * beta / a**2
    slow = jnp.abs(w) < 1e-3
    series = w * jnp.polyval(jnp.asarray(_SERIES[::-1], dtype=w.dtype), jnp.where(slow, w, 0.0))
    still = beta == 0
    z = a / (2 * jnp.sqrt(-0.5j * jnp.where(still, 1.0, beta)))
    past = z.real < 0  # the sweep has crossed the resonance: erfcx(z) = 2 exp(z²) − erfcx(−z)
    outer = jnp.where(past, -z, z)
    exact = jnp.sqrt(jnp.pi) * outer * wofz(1j * jnp.where(slow, 1.0, outer)) - 1
    ringing = jnp.where(past & ~still, 2 * jnp.sqrt(jnp.pi) * z * jnp.exp(jnp.where(past, z**2, -1.0)), 0.0)
    return jnp.where(slow, series, exact) + ringing
