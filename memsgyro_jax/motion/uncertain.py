"""A gyro whose model has the errors that a design counts with, as coefficients that an observer can find."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp

from memsgyro_jax.device.gyro import (
    UNCHANGED,
    UX,
    UY,
    AbstractGyro,
    Change,
    Coefficient,
    Dynamics,
    Inertial,
    MotionModel,
    Pair,
    Scalar,
    Term,
)
from memsgyro_jax.loop.observers.settings import Prior, arrays

from .errors import ModelErrors


_SPLIT = Coefficient("gain_split", (Term(0, UX, 1.0), Term(1, UY, -1.0)))
_DELAYS = tuple(Coefficient(f"delay_{axis}", (), delays=i) for i, axis in enumerate("xy"))


class UncertainGyro(AbstractGyro):
    """`gyro` with relative errors `gain` of the force on x and y, and `delay` [s] of its read-out's channels.

    The coefficients of `gyro` are joined by half the difference of the gains [1/kg] (where one gain serves both axes:
    the mean is in the coefficient of the mass) and by both delays, so that a filter made for it finds them. The delays
    do not act here: `Delayed` is the read-out that has them. Zero errors are the gyro itself.
    """

    gyro: AbstractGyro
    gain: Pair = arrays(default=(0.0, 0.0))
    delay: Pair = arrays(default=(0.0, 0.0))
    model: MotionModel = eqx.field(static=True, init=False)

    def __post_init__(self):
        own = self.gyro.model
        split = (_SPLIT,) if _has_one_gain(own) else ()
        self.model = MotionModel((*own.coefficients, *split, *_DELAYS))

    def dynamics(self, inertial: Inertial) -> Dynamics:
        """Those of the gyro, with the gains as they are."""
        own = self.gyro.dynamics(inertial)
        return replace(own, gain=own.gain * tuple(1.0 + error for error in self.gain))

    def coefficients(self, rate: Scalar, damping_change: Change = UNCHANGED) -> tuple[Scalar, ...]:
        """Those of the gyro (a gain with its error, one gain for both axes with the mean error), split and delays."""
        own, (x, y) = self.gyro.coefficients(rate, damping_change), self.gain
        if not _has_one_gain(self.gyro.model):
            errors = {"sigma_x": x, "sigma_y": y}
            named = zip(own, self.gyro.model.names, strict=True)
            return (*(value * (1.0 + errors.get(name, 0.0)) for value, name in named), *self.delay)
        place = self.gyro.model.index("sigma")
        sigma = own[place]
        mean = (*own[:place], sigma * (1.0 + 0.5 * (x + y)), *own[place + 1 :])
        return (*mean, 0.5 * sigma * (x - y), *self.delay)

    def prior(self, usual: Prior, errors: ModelErrors, known: tuple[str, ...]) -> tuple[Prior, tuple[str, ...]]:
        """`usual`, a prior of the gyro alone, completed by what `errors` say, and which coefficients are still `known`:
        not that of a known mass, which the mean error of the gains hides.
        """
        gain, delay = errors.force_gain, errors.delay
        theta, std = usual.theta, usual.theta_std
        if _has_one_gain(self.gyro.model):
            place = self.gyro.model.index("sigma")
            half = jnp.sqrt(0.5) * gain * theta[place]
            theta, std = (*theta, 0.0), (*std, half)
            if "sigma" in known:
                std, known = (*std[:place], half, *std[place + 1 :]), tuple(name for name in known if name != "sigma")
        ends = (*theta, 0.0, 0.0), (*std, delay, delay)
        return Prior(usual.motion, usual.motion_std, usual.offset, usual.offset_std, *ends), known


def _has_one_gain(model: MotionModel) -> bool:
    return "sigma" in model.names
