"""The two measurements of a sample as a Kalman filter sees them, one scalar after the other."""

from typing import NamedTuple

from jaxtyping import Array

from memsgyro_jax.device.gyro import Scalar
from memsgyro_jax.device.small import Vector

from .covariance import Gain, Prediction, beside, entries, square


class EstimatedDelay(NamedTuple):
    """What an estimated delay does to a channel, to first order volts = scale * (x - delay * vx): its volts, their
    derivatives by velocity and by delay, and the delay's place among the constants.
    """

    volts: Scalar
    by_velocity: Scalar
    by_delay: Scalar
    place: int

    @classmethod
    def of(cls, scale: Scalar, velocity: Scalar, constants: Array, place: int) -> "EstimatedDelay":
        """The delay at `place`, of a channel with `scale`."""
        by_velocity = -scale * constants[place]
        return cls(by_velocity * velocity, by_velocity, -scale * velocity, place)


class Channel(NamedTuple):
    """`scale * signal + offset`, less what a `delay` takes away; h of the update, which P meets on both sides.

    `signal` is the measured entry of the motion, `offset` the place of the offset among the constants (None where it
    is no state). `volts` are expected there, without offset and delay; of a curved pick-off `scale` is the slope.
    """

    signal: int
    scale: Scalar
    offset: int | None
    volts: Scalar
    delay: EstimatedDelay | None = None

    def of(self, motion: Vector, constants: Array) -> Scalar:
        """h · column."""
        value = self.scale * motion[self.signal]
        if self.delay is not None:
            delay = self.delay
            value = value + delay.by_velocity * motion[self.signal + 2] + delay.by_delay * constants[delay.place]
        return value if self.offset is None else value + entries(constants)[self.offset]

    def covariance(self, prior: Prediction) -> tuple[Vector, Array]:
        """P h, over the motion and over the constants."""
        block, cross, signal = square(prior.motion), prior.cross, self.signal
        motion, constants = self.scale * block[signal], self.scale * cross[signal]
        if self.offset is not None:
            motion = motion + Vector(entries(row)[self.offset] for row in cross)
            constants = constants + prior.row(self.offset)
        if self.delay is not None:
            velocity, delay, place = signal + 2, self.delay, self.delay.place
            motion = motion + delay.by_velocity * block[velocity] + delay.by_delay * Vector(row[place] for row in cross)
            constants = constants + delay.by_velocity * cross[velocity] + delay.by_delay * prior.row(place)
        return motion, constants

    def spread(self, motion: Vector, cross: Vector, constants: Array) -> Scalar:
        """hᵀ P h without a delay."""
        value = self.scale**2 * square(motion)[self.signal][self.signal]
        if self.offset is None:
            return value
        place = self.offset
        return value + 2.0 * self.scale * cross[self.signal][place] + constants[place, place]

    def gain(self, prior: Prediction, variance: Scalar, earlier: Gain | None = None) -> Gain:
        """The gain of this measurement, of noise `variance`, given that `earlier` has been taken."""
        motion, constants = self.covariance(prior)
        if earlier is not None:
            shared = self.of(earlier.motion, earlier.constants)
            motion = motion - earlier.motion_gain * shared
            constants = constants - earlier.constant_gain * beside(shared, constants)
        spread = self.of(motion, constants) + variance
        inverse = 1.0 / spread
        return Gain(motion, constants, motion * inverse, constants * beside(inverse, constants), spread)
