"""Energy control beside another law (thesis 4.2.2)."""

from typing import Any, ClassVar

from memsgyro_jax.device.gyro import Pair, Scalar, check_not_negative, number
from memsgyro_jax.device.small import Vector

from ..observers.base import Clock, Estimate
from ..observers.energy import check_swing, swing_energy
from ..observers.settings import arrays
from .base import AbstractController


class EnergyControl(AbstractController[Any]):
    """Pushes along the velocity by what energy is missing, (4.21) and (4.25): `force += gain (1 - E/E0) v / (1/mass)`.

    E is the energy ½ Σ (v² + ω² q²) of the estimated motion, with ω = 2π·`frequency` (x, y) [Hz] at which the axes
    swing under `inner`, a reference model's own say; E0 is that of `amplitude` (x, y) [m]. From near rest the amplitude
    grows as exp(gain t/2), and a small difference of energy decays as exp(-gain t); `gain` in 1/s, zero leaves `inner`
    alone. The thesis' law, where 1 µm is the unit of length and 1/ω that of time, has gain = ω/2 for 1 µm.
    """

    inner: AbstractController[Any]
    frequency: Pair = arrays("Hz")
    amplitude: Pair = arrays("m", metadata={"unit": "m"})
    gain: Scalar = number("1/s")
    usually_tuned: ClassVar[tuple[str, ...]] = ("gain",)

    def __check_init__(self):
        check_swing(self.frequency, self.amplitude)
        check_not_negative("gain", self.gain)

    def init(self) -> Any:
        """That of the inner law."""
        return self.inner.init()

    def command(self, state: Any, estimate: Estimate, clock: Clock) -> tuple[Pair, Any]:
        """The inner law's force, and that along the velocity."""
        force, state = self.inner.command(state, estimate, clock)
        velocity = Vector(estimate.motion[2:])
        energy = swing_energy(self.frequency, estimate.motion[:2], velocity)
        missing = 1.0 - energy / swing_energy(self.frequency, self.amplitude, (0.0, 0.0))
        return tuple(Vector(force) + (self.gain * missing) * velocity / estimate.dynamics.gain), state

    def measured(self, state: Any, volts: Pair, clock: Clock) -> Any:
        """What the inner law makes of them."""
        return self.inner.measured(state, volts, clock)

    def output(self, state: Any, estimate: Estimate) -> Estimate:
        """What the inner law gives out."""
        return self.inner.output(state, estimate)
