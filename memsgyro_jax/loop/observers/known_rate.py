"""A Kalman filter that learns, while the rate is known, what no motion tells from a rate."""

from typing import Any

import jax.numpy as jnp

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import (
    VX,
    VY,
    AbstractGyro,
    Coefficient,
    Pair,
    Scalar,
    Term,
    check_not_negative,
    number,
)

from ..readout import AbstractReadout
from ..scenario import AbstractProfile, Constant
from .base import Clock
from .covariance import Covariance
from .ekf import ExtendedKalmanFilter, KalmanState
from .settings import design_prior
from .wider import AbstractWiderFilter, wider_filter


CROSS_DAMPING_ASYMMETRY = Coefficient("cross_damping_asymmetry", (Term(0, VY, 0.5), Term(1, VX, -0.5)))
"""(dyx - dxy)/m in 1/s, for `also` of `information_bound`: the force is that of a rate four times smaller, so without a
prior neither can be known (thesis 4.1.2)."""


class KnownRateFilter(AbstractWiderFilter):
    """The filter of one mass with unequal cross damping: (dyx − dxy)/m acts as a rate four times smaller, so nothing
    that the device does tells them apart (thesis 4.1.2). Make one with `for_device`.

    Until `until` [s] the rate is known: it is `rate`, at rest or on a rate table, and what else turns the vibration is
    the asymmetry. From then on the rate is open again, by `rate_std` [rad/s], and the asymmetry stays what it was found
    to be, with its uncertainty counted in that of the rate (a Schmidt-Kalman, or consider, filter from there on, since
    nothing tells more of it). `until` zero means never known: the rate is then claimed as badly as it is known.
    """

    filter: ExtendedKalmanFilter
    rate: AbstractProfile
    until: Scalar = number("s")
    rate_std: Scalar = number("rad/s")

    def __check_init__(self):
        check_not_negative("until", self.until)
        check_not_negative("rate_std", self.rate_std)

    @classmethod
    def for_device(
        cls,
        gyro: AbstractGyro,
        readout: AbstractReadout | None = None,
        *,
        until: Scalar,
        rate: AbstractProfile | float = 0.0,
        asymmetry: float = 0.1,
        **settings: Any,
    ) -> "KnownRateFilter":
        """A filter that expects `gyro` behind `readout`, its cross dampings known to differ by the share `asymmetry` of
        the design's (standard deviation; zero means equal).

        `settings` are those of `ExtendedKalmanFilter.for_device`; the prior's rate is that after the known phase.
        Raises `InputError` for a gyro of two masses, which has no cross damping.
        """
        if "rate" in settings.get("known", ()):
            raise InputError("A filter that a known phase releases must estimate the rate, but `known` holds it.")
        settings["prior"] = settings.get("prior") or design_prior(gyro)
        place = gyro.model.index("rate")
        named = dict(zip(gyro.model.names, gyro.coefficients(0.0), strict=True))
        std = asymmetry * jnp.abs(named.get("dxy", 0.0))
        made = wider_filter(gyro, readout, CROSS_DAMPING_ASYMMETRY, std, settings)
        profile = rate if isinstance(rate, AbstractProfile) else Constant(rate)
        return cls(made, profile, until, made.prior.theta_std[place])

    def update(self, state: KalmanState, measured: Pair, force: Pair, clock: Clock) -> KalmanState:
        """As the filter, but that the rate is known before a sample of the first phase, and open after its last."""
        return self.filter.update(self._told(state, clock), measured, force, clock)

    def _told(self, state: KalmanState, clock: Clock) -> KalmanState:
        place = self.filter.states.index("rate") - 4
        before = clock.time - clock.period
        known, first = clock.time <= self.until, (clock.time > self.until) & (before <= self.until)
        constants, covariance = state.constants, state.covariance
        rate = jnp.where(known, self.rate.value(clock.time - 0.5 * clock.period), constants[place])
        kept = jnp.where(known, 0.0, 1.0)
        spread = covariance.constants.at[place].multiply(kept).at[:, place].multiply(kept)
        opened = jnp.where(first, self.rate_std**2, 0.0)
        told = Covariance(
            covariance.motion,
            tuple(row.at[place].multiply(kept) for row in covariance.cross),
            spread.at[place, place].add(opened),
        )
        return state._replace(constants=constants.at[place].set(rate), covariance=told)
