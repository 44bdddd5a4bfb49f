"""No observer: for controllers that measure by themselves."""

from typing import ClassVar

import equinox as eqx

from memsgyro_jax.device.gyro import AbstractGyro, MotionModel, Pair, Scalar

from ..readout import AbstractReadout
from .base import AbstractObserver, Clock, Estimate
from .settings import arrays


class NoObserver(AbstractObserver[tuple[()]]):
    """Believes the design for ever, and the mass at rest; the loop's rate is that which its controller gives out.

    `theta` are the design's coefficients, the rate at zero; `offset` [V] that of the read-out's design.
    """

    theta: tuple[Scalar, ...] = arrays()
    offset: Pair = arrays()
    model: MotionModel = eqx.field(static=True)
    learns: ClassVar[bool] = False

    @classmethod
    def for_device(cls, gyro: AbstractGyro, readout: AbstractReadout) -> "NoObserver":
        """That of a loop around `gyro` and `readout`."""
        return cls(gyro.coefficients(0.0), readout.offset, gyro.model)

    def init(self) -> tuple[()]:
        """Nothing to remember."""
        return ()

    def update(self, state: tuple[()], measured: Pair, force: Pair, clock: Clock) -> tuple[()]:
        """Nothing is learned."""
        return ()

    def estimate(self, state: tuple[()]) -> Estimate:
        """The design."""
        return Estimate((0.0, 0.0, 0.0, 0.0), self.theta, self.offset, self.model)
