"""A Kalman filter that finds how far the two channels of the read-out differ in scale."""

from typing import Any

from memsgyro_jax.device.gyro import AbstractGyro, Coefficient, Pair

from ..readout import AbstractReadout
from .base import Clock
from .ekf import ExtendedKalmanFilter, KalmanState
from .wider import AbstractWiderFilter, wider_filter


SCALE_RATIO = Coefficient("scale_ratio", (), scales=1)
READOUT_SCALES = (Coefficient("scale_x", (), scales=0), Coefficient("scale_y", (), scales=1))
"""Relative errors of both channels' scales, for `also` of `information_bound` and `observability`: what is common goes
with the mass."""


class ScaleRatioFilter(AbstractWiderFilter):
    """The filter of one mass whose read-out has y·(1 + ratio) for y: a ratio that is not estimated turns the
    stiffness' coupling into one that is not symmetric, which a filter can only take for rate. Make one with
    `for_device`.

    A motion and a force along both axes tell the ratio (auxiliary tones on both do). The scale common to both channels
    is not told by anything: with it the mass goes (forces and displacements by one factor), the rate stays. So x is
    taken as right. A filter for the thesis' "what is left open" (8.2).
    """

    filter: ExtendedKalmanFilter

    @classmethod
    def for_device(
        cls, gyro: AbstractGyro, readout: AbstractReadout | None = None, *, ratio_std: float = 0.1, **settings: Any
    ) -> "ScaleRatioFilter":
        """A filter that expects `gyro` behind `readout`, its ratio known to `ratio_std`; zero means no difference.

        `settings` are those of `ExtendedKalmanFilter.for_device`. Raises `InputError` for a gyro of two masses: each of
        its equations has coefficients of its own, which hide the ratio.
        """
        return cls(wider_filter(gyro, readout, SCALE_RATIO, ratio_std, settings))

    def update(self, state: KalmanState, measured: Pair, force: Pair, clock: Clock) -> KalmanState:
        """As the filter."""
        return self.filter.update(state, measured, force, clock)
