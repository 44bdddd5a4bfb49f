"""Synchronous detection of a carrier behind a charge amplifier, as it acts on slow changes of a capacitance."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex

from memsgyro_jax.base.arguments import whole
from memsgyro_jax.base.concrete import check_positive
from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.fields import Scalar

from ..gyro import number
from .charge_stage import ChargeStage


class CarrierDetection(Displayed):
    """A carrier `amplitude`·cos(2π `frequency` t) [V, Hz] of opposite sign on both halves of a sensor, its `stage`, a
    multiplication by 2 cos(2π `frequency` t + `phase`) and a Butterworth low-pass of `order` and `bandwidth` [Hz].

    A difference ΔC of the halves, as Re(a e^{jωt}), gives Re(G a e^{jωt}) in volts behind the low-pass F, with H what
    the stage makes of a charge:

        G(ω) = ½ V F(ω) [H(ω_c + ω) e^{−jφ} + H*(ω_c − ω) e^{jφ}]

    An ideal stage has G = −V/Cf. Offset and 1/f noise of the op-amp stay at the carrier, where the low-pass takes them:
    what thesis (3.12) calls rejection is |F(ω_c)|.
    """

    stage: ChargeStage
    amplitude: Scalar = number()
    frequency: Scalar = number()
    bandwidth: Scalar = number()
    phase: Scalar = number(default=0.0)
    order: int = eqx.field(static=True, default=2)

    def __check_init__(self):
        whole("order", self.order, least=1)
        for name in ("amplitude", "frequency", "bandwidth"):
            check_positive(name, getattr(self, name))

    @property
    def poles(self) -> Complex[Array, " order"]:
        """Of the low-pass [rad/s]."""
        angles = np.pi * (2 * np.arange(self.order) + self.order + 1) / (2 * self.order)
        return 2.0 * jnp.pi * self.bandwidth * np.exp(1j * angles)

    def lowpass(self, omega: Scalar) -> Scalar:
        """F(jω)."""
        found = 1.0 + 0.0j
        for pole in np.exp(1j * np.pi * (2 * np.arange(self.order) + self.order + 1) / (2 * self.order)):
            found = found * -pole / (1j * omega / (2.0 * jnp.pi * self.bandwidth) - pole)
        return found

    def response(self, omega: Scalar) -> Scalar:
        """G(ω): volts per ΔC [V/F], a complex number; ω in rad/s, below the carrier's."""
        carrier, turn = 2.0 * jnp.pi * self.frequency, jnp.exp(1j * self.phase)
        above, below = (self.stage.responses(carrier + sign * omega).charge for sign in (1.0, -1.0))
        both = above / turn + jnp.conj(below) * turn
        return 0.5 * self.amplitude * self.lowpass(omega) * both

    def powers(self, omega: Scalar) -> dict[str, Scalar]:
        """One-sided noise power density [V²/Hz] behind the low-pass by source, the mean over a carrier's period."""
        carrier, passed = 2.0 * jnp.pi * self.frequency, jnp.abs(self.lowpass(omega)) ** 2
        above, below = self.stage.powers(carrier + omega), self.stage.powers(jnp.abs(carrier - omega))
        return {source: passed * (above[source] + below[source]) for source in above}

    def before(self, capacitance: Scalar) -> Scalar:
        """Phasor in volts of the carrier that a constant ΔC leaves in front of the multiplication."""
        return self.amplitude * capacitance * self.stage.responses(2.0 * jnp.pi * self.frequency).charge
