"""A Kalman filter that also finds how fast the rate changes."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from memsgyro_jax.base.arguments import arrays, quantity
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import AbstractGyro, Coefficient, Pair, Scalar, check_not_negative
from memsgyro_jax.device.propagate import AbstractDiscretisation

from ..readout import AbstractReadout
from .base import AbstractBlockObserver, Believed, Clock, Innovation
from .covariance import Covariance
from .ekf import ExtendedKalmanFilter, KalmanState
from .wider import AbstractWiderFilter, wider_filter


RATE_SLOPE = Coefficient("rate_slope", ())
"""dΩ/dt in rad/s²: what moves the rate, and the mass by nothing else."""


class RateSlopeFilter(AbstractWiderFilter, AbstractBlockObserver[KalmanState]):
    """The filter whose rate moves by a slope, which it estimates too: it follows a ramp without being late, where one
    whose rate walks at random lags behind, and in blocks the rate moves within each. Make one with `for_device`.

    `shares` say by how much each coefficient of the model moves with the rate: 1 for that of one mass; the frame of a
    dual-mass gyro has its design's. `further` tells the slope. The truth has no slope to lay beside it, so that
    `states`, their covariance and the NEES leave it out.

    Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), 6.2.2: the "white noise
    acceleration model", of the rate.
    """

    filter: ExtendedKalmanFilter
    shares: tuple[Scalar, ...] = arrays()

    def __check_init__(self):
        if "rate" not in self.states:
            raise InputError("A filter that finds the slope of the rate must estimate the rate, but `known` holds it.")

    @classmethod
    def for_device(
        cls,
        gyro: AbstractGyro,
        readout: AbstractReadout | None = None,
        *,
        slope_std: Scalar | str,
        slope_walk: Scalar = 0.0,
        **settings: Any,
    ) -> "RateSlopeFilter":
        """A filter that expects `gyro` behind `readout`, the slope of its rate zero to `slope_std` [rad/s²] at the
        start and a random walk of intensity `slope_walk` [(rad/s²)²/s] from there on; zero for both means a constant
        rate.

        A rate that swings with an amplitude A at ω has slopes of A·ω, and a walk of about A²·ω³ follows it. `settings`
        are those of `ExtendedKalmanFilter.for_device`. Raises `InputError` for a rate that is taken as known.
        """
        if "rate" in settings.get("known", ()):
            raise InputError("A filter that finds the slope of the rate must estimate the rate, but `known` holds it.")
        slope_std = quantity("slope_std", slope_std, "rad/s^2")
        check_not_negative("slope_std", slope_std)
        check_not_negative("slope_walk", slope_walk)
        made = wider_filter(gyro, readout, RATE_SLOPE, slope_std, settings)
        noise = replace(made.process_noise, theta=(*made.process_noise.theta[:-1], slope_walk))
        unit = zip(gyro.coefficients(1.0), gyro.model.coefficients, strict=True)
        return cls(replace(made, process_noise=noise), tuple(s if c.is_rate else 0.0 for s, c in unit))

    @property
    def estimated(self) -> tuple[int, ...]:
        """Of the device's coefficients."""
        return self.filter.estimated[:-1]

    @property
    def with_offsets(self) -> bool:
        return self.filter.with_offsets

    @property
    def discretisation(self) -> AbstractDiscretisation:
        """The filter's idea of a sample."""
        return self.filter.discretisation

    @property
    def hindrance(self) -> str | None:
        """The filter's."""
        return self.filter.hindrance

    def update(self, state: KalmanState, measured: Pair, force: Pair, clock: Clock) -> KalmanState:
        """As the filter, once the rate has moved."""
        motion, cross, spread = state.covariance
        by = self._by * clock.period
        by = by.reshape(*by.shape, *(1,) * (state.constants.ndim - by.ndim))  # dies trail
        further = lambda vector: vector + by * vector[-1]  # noqa: E731
        spread = spread + by[:, None] * spread[-1]
        spread = spread + spread[:, -1][:, None] * by[None]
        begun = state._replace(
            constants=further(state.constants), covariance=Covariance(motion, tuple(map(further, cross)), spread)
        )
        return self.filter.update(begun, measured, force, clock)

    def believed(self, state: KalmanState) -> Believed:
        return self.filter.believed(state)

    def believing(self, state: KalmanState, believed: Believed, innovation: Innovation) -> KalmanState:
        return self.filter.believing(state, believed, innovation)

    def variance(self, clock: Clock) -> Pair:
        return self.filter.variance(clock)

    def walk(self) -> tuple[Scalar, ...]:
        return self.filter.walk()

    def moves(self) -> Float[Array, "constants constants *lanes"]:
        by = self._by
        return jnp.zeros((len(by), *by.shape)).at[:, -1].set(by)

    @property
    def _by(self) -> Float[Array, "constants *lanes"]:
        """What each constant moves by in a second under a unit slope, the slope last."""
        offsets = (0.0, 0.0) if self.with_offsets else ()
        entries = (*offsets, *(self.shares[i] for i in self.estimated), 0.0)
        return jnp.stack(jnp.broadcast_arrays(*map(jnp.asarray, entries))) + 0.0
