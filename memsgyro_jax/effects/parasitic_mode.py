"""A further mode that the proof mass carries: a finger, a frame, the package."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .axes import on_axis
from .base import ForceEffect, Moment, Scalar, strength
from .numbers import parameter
from .scan import Coverage, Scanned


class ParasiticMode(Scanned, ForceEffect):
    """An appendage of mass s·m with a displacement z of its own: z'' = −ω_z²·(z − q) − (ω_z/Q_z)·z' and
    F = s·m·ω_z²·(z − q), s a pure number. Zero: it follows without force.

    Shows as a notch beside a small peak at its own frequency `omega` [rad/s], of quality factor `quality`. The
    frequency is scanned, for a fit finds it only from within its own width; from there on it is fitted.

    Den Hartog, Mechanical Vibrations, chapter 3 (the dynamic vibration absorber).
    """

    name, unit, law = "parasitic_mode", "1", "z'' = −ω_z²·(z − q) − (ω_z/Q_z)·z', F = s·m·ω_z²·(z − q)"
    reference = "Den Hartog, Mechanical Vibrations, chapter 3"
    own_size, own_is_linear = 2, True
    scanned = ("omega",)
    axis: int | str = on_axis()
    strength: Scalar = strength(sign=+1)
    omega: Array = parameter(start=2 * np.pi * 20e3, low=0.0, unit="rad/s")
    quality: Array = parameter(start=100.0, low=0.5)

    def force(self, now: Moment) -> Array:
        pull = self.omega**2 * (now.own[0] - now.displacement[self.axis])
        return self.along(now, self.strength * now.device.mass(self.axis) * pull)

    def own_start(self, now: Moment) -> Array:
        """Where the mass carries it at rest."""
        return jnp.stack([now.displacement[self.axis], jnp.zeros(())])

    def own_rate(self, now: Moment) -> Array:
        """The state is (z, z'/ω_z): both of the size of a displacement."""
        z, swing = now.own
        back = z - now.displacement[self.axis] + swing / self.quality
        return self.omega * jnp.stack([swing, -back])

    def carried(self, motion: np.ndarray, frequency: np.ndarray) -> np.ndarray:
        """It follows the mass linearly, harmonic by harmonic."""
        ratio = np.arange(motion.shape[1]) * frequency[:, None] / float(self.omega)
        apart = 1.0 / (1.0 - ratio**2 + 1j * ratio / float(self.quality)) - 1.0
        return float(self.omega) ** 2 * apart[..., None] * motion * np.eye(motion.shape[2])[int(self.axis)]

    def grid(self, coverage: Coverage) -> "tuple[ParasiticMode, ...]":
        """Frequencies through the band and a twentieth beyond, no farther apart than half the mode's width."""
        low, high = coverage.band[0] / 1.05, coverage.band[1] * 1.05
        count = 1 + int(np.ceil(2 * float(self.quality) * np.log(high / low)))
        return tuple(
            ParasiticMode(self.axis, self.strength, omega=float(omega), quality=self.quality)
            for omega in np.geomspace(low, high, count)
        )
