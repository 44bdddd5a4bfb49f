"""Kalman filters that estimate one number more than the coefficients of the device that they watch."""

from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from memsgyro_jax.base.arguments import check_kind
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.fields import AbstractVar
from memsgyro_jax.device.gyro import (
    SINGLE_MASS,
    AbstractGyro,
    Coefficient,
    MotionModel,
    Pair,
    Scalar,
    check_not_negative,
)

from ..readout import AbstractReadout
from .base import AbstractCovarianceObserver, Estimate
from .ekf import ExtendedKalmanFilter, KalmanState
from .settings import Prior, ProcessNoise, design_prior


class Further(NamedTuple):
    """What such a filter says of its further number: mean and standard deviation."""

    value: Scalar
    std: Scalar


class AbstractWiderFilter(AbstractCovarianceObserver[KalmanState]):
    """`filter` estimates the coefficients of the device and a last one, which the device's model does not have.

    To the loop it is a filter of the device: the last coefficient is left out of what it says of coefficients, states
    and covariance, and counted in all of it. `further` tells it.
    """

    filter: AbstractVar[ExtendedKalmanFilter]
    usually_tuned: ClassVar[tuple[str, ...]] = ("filter.noise_density",)

    def __check_init__(self):
        check_kind("filter", self.filter, ExtendedKalmanFilter, "an ExtendedKalmanFilter")
        if self.filter.iterations > 1 or self.filter.fading is not None:
            raise InputError(f"The filter of a {type(self).__name__} must have one iteration and no fading memory.")

    @property
    def model(self) -> MotionModel:
        return MotionModel(self.filter.model.coefficients[:-1])

    @property
    def prior(self) -> Prior:
        inner = self.filter.prior
        return replace(inner, theta=inner.theta[:-1], theta_std=inner.theta_std[:-1])

    @property
    def process_noise(self) -> ProcessNoise:
        """That of the device's coefficients."""
        inner = self.filter.process_noise
        return replace(inner, theta=inner.theta[:-1])

    @property
    def scale(self) -> Pair:
        """That of the read-out as expected, in V per unit."""
        return self.filter.scale

    @property
    def signals(self) -> tuple[int, int]:
        """The entries of the motion that the read-out shows."""
        return self.filter.signals

    @property
    def noise_density(self) -> Pair:
        """That of the read-out as expected, in V/√Hz."""
        return self.filter.noise_density

    @property
    def states(self) -> tuple[str, ...]:
        return self.filter.states[:-1]

    def init(self) -> KalmanState:
        return self.filter.init()

    def estimate(self, state: KalmanState) -> Estimate:
        found = self.filter.estimate(state)
        theta, model = found.theta[:-1], self.model
        return Estimate(found.motion, theta, found.offset, model, found.rate_variance, found.innovation)

    def covariance(self, state: KalmanState) -> Float[Array, "states states *lanes"]:
        return self.filter.covariance(state)[:-1, :-1]

    def bounds(self, path: str, duration: float) -> tuple[float, float] | None:
        return self.filter.bounds(path.removeprefix("filter."), duration)

    def further(self, state: KalmanState) -> Further:
        """Mean and standard deviation of the further number."""
        return Further(state.constants[-1], jnp.sqrt(state.covariance.constants[-1, -1]))


def wider_filter(
    gyro: AbstractGyro, readout: AbstractReadout | None, further: Coefficient, std: Scalar, settings: dict[str, Any]
) -> ExtendedKalmanFilter:
    """The filter for `gyro` with the coefficient `further`, about zero and known to `std` at the start.

    `settings` are those of `ExtendedKalmanFilter.for_device`. Raises `InputError` for a gyro of two masses, whose own
    coefficients hide any such number that acts on the motion or a channel.
    """
    acts = further.terms or further.delays is not None or further.scales is not None
    if acts and gyro.model != SINGLE_MASS:
        raise InputError(
            f"A filter that estimates {further.name} must watch a `SingleMassGyro`: the coefficients of a "
            f"{type(gyro).__name__} hide it."
        )
    check_not_negative("std", std)
    usual = settings.pop("prior", None) or design_prior(gyro)
    noise = settings.pop("process_noise", None) or ProcessNoise.none(gyro.model)
    made = ExtendedKalmanFilter.for_device(gyro, readout, prior=usual, process_noise=noise, **settings)
    place = len(gyro.model.names)
    return replace(
        made,
        model=MotionModel((*gyro.model.coefficients, further)),
        prior=replace(usual, theta=(*usual.theta, 0.0), theta_std=(*usual.theta_std, std)),
        process_noise=replace(made.process_noise, theta=(*made.process_noise.theta, 0.0)),
        estimated=(*made.estimated, place),
    )
