"""What a Kalman filter is told before it starts: prior, process noise, annealing."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp

from memsgyro_jax.base.arguments import arrays, check_kind, quantity, several
from memsgyro_jax.base.converter import FieldConverter
from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.brownian import thermal_acceleration
from memsgyro_jax.device.gyro import (
    AbstractGyro,
    Dynamics,
    Inertial,
    MotionModel,
    Pair,
    Scalar,
    check_not_negative,
    check_positive,
    number,
)
from memsgyro_jax.device.propagate import AbstractDiscretisation, State4
from memsgyro_jax.device.sizes import with_sizes
from memsgyro_jax.device.small import Vector

from ..readout import AbstractReadout
from .covariance import UPPER, diagonal


class Prior(Displayed):
    """Mean and standard deviation of everything the filter estimates, at the start.

    `motion` (x, y, vx, vy) in m and m/s, `offset` in V, `theta` mass-normalised coefficients in the model's order;
    a zero standard deviation means known exactly.
    """

    motion: State4 = arrays()
    motion_std: State4 = arrays()
    offset: Pair = arrays()
    offset_std: Pair = arrays()
    theta: tuple[Scalar, ...] = arrays()
    theta_std: tuple[Scalar, ...] = arrays()

    def __check_init__(self):
        check_lengths(self, motion=4, motion_std=4, offset=2, offset_std=2, theta_std=len(self.theta))
        for name in ("motion_std", "offset_std", "theta_std"):
            for value in getattr(self, name):
                check_not_negative(name, value)


class ProcessNoise(Displayed):
    """Random-walk intensity per estimated entry, in unit²/s; zero means constant.

    `acceleration` is the two-sided density (xx, yy, xy) in m²/s³ of a white one that shakes the mass between samples,
    as the Brownian force does; None is none.
    """

    motion: State4 = arrays()
    offset: Pair = arrays()
    theta: tuple[Scalar, ...] = arrays()
    acceleration: tuple[Scalar, Scalar, Scalar] | None = eqx.field(
        converter=FieldConverter(lambda field, given: None if given is None else several(field, given)), default=None
    )

    def __check_init__(self):
        check_lengths(self, motion=4, offset=2)
        for name in ("motion", "offset", "theta"):
            for value in getattr(self, name):
                check_not_negative(name, value)
        if self.acceleration is not None:
            check_lengths(self, acceleration=3)
            for value in self.acceleration[:2]:
                check_not_negative("acceleration", value)

    @classmethod
    def none(cls, model: MotionModel) -> "ProcessNoise":
        """Nothing walks."""
        return cls((0.0,) * 4, (0.0,) * 2, (0.0,) * len(model.names))

    @classmethod
    def of(cls, model: MotionModel, **intensity: float) -> "ProcessNoise":
        """Intensities by coefficient name, for example `rate=1e-3` [(rad/s)²/s]; unnamed entries do not walk."""
        theta = [0.0] * len(model.names)
        for name, value in intensity.items():
            theta[model.index(name)] = value
        return cls((0.0,) * 4, (0.0,) * 2, tuple(theta))

    def shaken_as(self, gyro: AbstractGyro) -> "ProcessNoise":
        """The same with the Brownian force of `gyro` by its design values, if it knows its temperature and none else
        was given.
        """
        if gyro.temperature is None or self.acceleration is not None:
            return self
        rest = gyro.dynamics(Inertial())
        density = thermal_acceleration(rest.damping, rest.gain, gyro.temperature)
        return replace(self, acceleration=(density[0][0], density[1][1], density[0][1]))

    def gathered(self, dynamics: Dynamics, discretisation: AbstractDiscretisation, period: Scalar) -> Vector:
        """The upper triangle of what a sample adds to the covariance of the motion."""
        walked = diagonal(Vector(self.motion) * period)
        if self.acceleration is None:
            return walked
        xx, yy, xy = self.acceleration
        white = discretisation.white(dynamics.stiffness, dynamics.damping, ((xx, xy), (xy, yy)), period)
        return walked + Vector(white[i][j] for i, j in UPPER)


class Annealing(Displayed):
    """A factor `1 + excess * exp(-time/decay)` by which a start differs: on the measurement variance of a Kalman
    filter, cautious where the prior is far from linear; on the gains by which a Lyapunov observer adapts, hasty.

    `excess` zero means none; `decay` in s.
    """

    excess: Scalar = number(default=1000.0)
    decay: Scalar = number(default=0.5e-3)

    def __check_init__(self):
        check_not_negative("excess", self.excess)
        check_positive("decay", self.decay)

    def factor(self, time: Scalar) -> Scalar:
        """The factor at `time` [s]."""
        return 1.0 + self.excess * jnp.exp(-time / self.decay)


def rounding_of(readout: AbstractReadout) -> tuple[Scalar, ...]:
    """Standard deviation [V] of what its converter's rounding adds to a sample of each channel; none without one."""
    return () if readout.adc is None else (readout.adc.step / jnp.sqrt(12.0),) * 2


def check_lengths(settings: eqx.Module, **lengths: int) -> None:
    """Raise `InputError` unless the fields named have so many entries."""
    for name, length in lengths.items():
        if len(getattr(settings, name)) != length:
            raise InputError(
                f"Argument `{name}` must have {length} entries, but {len(getattr(settings, name))} were given."
            )


def check_told(prior: Prior, process_noise: ProcessNoise, model: MotionModel) -> None:
    """Raise `InputError` unless these tell a filter of every coefficient of `model`."""
    check_kind("prior", prior, Prior, "a `Prior`, `design_prior(gyro)` say")
    check_kind("process_noise", process_noise, ProcessNoise, "a `ProcessNoise`, `ProcessNoise.of(model, rate=1.0)` say")
    count = len(model.names)
    sizes = {"prior": (len(prior.theta), len(prior.theta_std)), "process_noise": (len(process_noise.theta),)}
    for name, found in sizes.items():
        if set(found) != {count}:
            raise InputError(
                f"Argument `{name}` of the filter must hold one number for each of the {count} coefficients "
                f"{', '.join(model.names)}, but {' and '.join(map(str, found))} were given."
            )


def design_prior(
    gyro: AbstractGyro,
    *,
    spread: float = 0.15,
    rate_std: float | str = 3.0,
    offset_std: float | str = 20e-3,
    amplitude: float | str = 1e-6,
    motion_error: float = 0.05,
) -> Prior:
    """A prior around the design values of `gyro`, at rest but for a displacement `amplitude` [m] along x.

    Every physical parameter of the device is taken to vary by `spread` of itself (a coupling by that of at least 1 % of
    the main coefficients), independently; a coefficient, a
    stiffness over a mass say, gets the standard deviation that follows to first order. The rate has `rate_std` [rad/s]
    about zero, the read-out offsets `offset_std` [V] about zero, the motion `motion_error` of the amplitude (velocities
    times the mode frequency). Zero standard deviations mean known exactly.
    """
    rate_std, offset_std = quantity("rate_std", rate_std, "rad/s"), quantity("offset_std", offset_std, "V")
    amplitude, spread = quantity("amplitude", amplitude, "m"), quantity("spread", spread, "1")
    motion_error = quantity("motion_error", motion_error, "1")
    theta, theta_std, frequency = _theta(gyro, spread, rate_std)
    position = motion_error * amplitude
    return Prior(
        motion=(amplitude, 0.0, 0.0, 0.0),
        motion_std=(position, position, position * frequency[0], position * frequency[1]),
        offset=(0.0, 0.0),
        offset_std=(offset_std, offset_std),
        theta=theta,
        theta_std=theta_std,
    )


@eqx.filter_jit  # one small program in place of two dozen
def _theta(gyro: AbstractGyro, spread: Scalar, rate_std: Scalar) -> tuple[tuple[Scalar, ...], tuple[Scalar, ...], Pair]:
    """Coefficients at rest, their standard deviations to first order in the spread of the parameters, and the axes'
    natural frequencies.
    """
    leaves, structure = jax.tree.flatten(gyro)
    sizes = jax.tree.leaves(with_sizes(gyro))
    slopes = jax.jacfwd(lambda values: jax.tree.unflatten(structure, values).coefficients(0.0))(leaves)
    variances = (sum((spread * p * slope) ** 2 for p, slope in zip(sizes, row, strict=True)) for row in slopes)
    # A unit rate gives each rate coefficient its share, which is below 1 for the frame of a dual-mass gyro.
    share = gyro.coefficients(1.0)
    std = tuple(
        rate_std * s if coefficient.is_rate else jnp.sqrt(variance)
        for variance, s, coefficient in zip(variances, share, gyro.model.coefficients, strict=True)
    )
    theta = gyro.coefficients(0.0)
    return theta, std, tuple(jnp.sqrt(theta[gyro.model.index(name)]) for name in ("kxx", "kyy"))
