"""A gyro whose model has the errors that a design counts with, as coefficients that an observer can find."""

import math
from dataclasses import replace

import equinox as eqx

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
from memsgyro_jax.loop.bound import CROSS_DAMPING_ASYMMETRY
from memsgyro_jax.loop.observers.settings import Prior, arrays

from .errors import ModelErrors


_SPLIT = Coefficient("gain_split", (Term(0, UX, 1.0), Term(1, UY, -1.0)))
_DELAYS = tuple(Coefficient(f"delay_{axis}", (), delays=i) for i, axis in enumerate("xy"))


class UncertainGyro(AbstractGyro):
    """`gyro` with relative errors `gain` of the force on x and y, and `delay` [s] of its read-out's channels.

    The coefficients of `gyro` are joined by the difference of its cross dampings [1/s], half that of the gains [1/kg]
    (where one gain serves both axes: the mean is in the coefficient of the mass) and both delays, so that a filter made
    for it finds them, or counts with what it cannot find. The delays do not act here: `Delayed` is the read-out that
    has them. Zero errors are the gyro itself.
    """

    gyro: AbstractGyro
    gain: Pair = arrays(default=(0.0, 0.0))
    delay: Pair = arrays(default=(0.0, 0.0))
    model: MotionModel = eqx.field(static=True, init=False)

    def __post_init__(self):
        own = self.gyro.model
        split = (_SPLIT,) if _has_one_gain(own) else ()
        self.temperature = self.gyro.temperature
        self.model = MotionModel((*own.coefficients, CROSS_DAMPING_ASYMMETRY, *split, *_DELAYS))

    def dynamics(self, inertial: Inertial) -> Dynamics:
        """Those of the gyro, with the gains as they are."""
        own = self.gyro.dynamics(inertial)
        return replace(own, gain=own.gain * tuple(1.0 + error for error in self.gain))

    def coefficients(self, rate: Scalar, damping_change: Change = UNCHANGED) -> tuple[Scalar, ...]:
        """Those of the gyro (a gain with its error, one gain for both axes with the mean error), difference of the
        cross dampings, split and delays.
        """
        own, (x, y) = self.gyro.coefficients(rate, damping_change), self.gain
        (_, xy), (yx, _) = self.gyro.dynamics(Inertial(damping_change=damping_change)).damping
        if not _has_one_gain(self.gyro.model):
            errors = {"sigma_x": x, "sigma_y": y}
            named = zip(own, self.gyro.model.names, strict=True)
            return (*(value * (1.0 + errors.get(name, 0.0)) for value, name in named), yx - xy, *self.delay)
        place = self.gyro.model.index("sigma")
        sigma = own[place]
        mean = (*own[:place], sigma * (1.0 + 0.5 * (x + y)), *own[place + 1 :])
        return (*mean, yx - xy, 0.5 * sigma * (x - y), *self.delay)

    def prior(self, usual: Prior, errors: ModelErrors, known: tuple[str, ...]) -> tuple[Prior, tuple[str, ...]]:
        """`usual`, a prior of the gyro alone, completed by what `errors` say, and which coefficients are `known`: not a
        mass that errors of the gains hide, but errors of zero.
        """
        one = _has_one_gain(self.gyro.model)
        asymmetry, gain, _, *delays = errors.std(self.gyro)
        shared = gain * (math.sqrt(0.5) if one else 1.0)
        told = dict(zip(self.gyro.model.names, zip(usual.theta, usual.theta_std, strict=True), strict=True))
        hidden = {name for name in known if name.startswith("sigma") and gain > 0.0}
        told |= {name: (told[name][0], shared * told[name][0]) for name in hidden}
        split = shared * told["sigma"][0] if one else 0.0
        for name, std in zip(
            self.model.names[len(told) :], [asymmetry, *([split] if one else []), *delays], strict=True
        ):
            told[name] = (0.0, std)
            known = known if std > 0.0 else (*known, name)
        theta, std = zip(*told.values(), strict=True)
        prior = Prior(usual.motion, usual.motion_std, usual.offset, usual.offset_std, theta, std)
        return prior, tuple(name for name in known if name not in hidden)


def _has_one_gain(model: MotionModel) -> bool:
    return "sigma" in model.names
