"""The two measurements of a sample as a Kalman filter sees them, one scalar after the other."""

from typing import NamedTuple

from jaxtyping import Array

from memsgyro_jax.device.gyro import Scalar
from memsgyro_jax.device.small import Vector

from .covariance import Gain, Prediction, entries, per_constant, square


class ChannelPart(NamedTuple):
    """What an estimated coefficient of the read-out does to a channel: its volts, their derivatives by the `entry` of
    the motion that they follow and by the coefficient itself, and the coefficient's place among the constants.
    """

    volts: Scalar
    by_entry: Scalar
    by_itself: Scalar
    entry: int
    place: int


class Channel(NamedTuple):
    """`scale * signal + offset`, and what `parts` of the read-out add; h of the update, which P meets on both sides.

    `signal` is the measured entry of the motion, `offset` the place of the offset among the constants (None where it
    is no state). `volts` are expected there, without offset and parts; of a curved pick-off `scale` is the slope.
    """

    signal: int
    scale: Scalar
    offset: int | None
    volts: Scalar
    parts: tuple[ChannelPart, ...] = ()

    def with_delay(self, velocity: Scalar, constants: Array, place: int) -> "Channel":
        """A displacement late by the constant at `place`: to first order volts = scale * (x - delay * vx)."""
        by_velocity = -self.scale * constants[place]
        part = ChannelPart(by_velocity * velocity, by_velocity, -self.scale * velocity, self.signal + 2, place)
        return self._replace(parts=(*self.parts, part))

    def with_share(self, constants: Array, place: int) -> "Channel":
        """A scale larger by the share at `place`."""
        share = constants[place]
        part = ChannelPart(share * self.volts, share * self.scale, self.volts, self.signal, place)
        return self._replace(parts=(*self.parts, part))

    def without_parts(self, volts: Scalar) -> Scalar:
        """`volts` less those of the parts."""
        for part in self.parts:
            volts = volts - part.volts
        return volts

    def of(self, motion: Vector, constants: Array) -> Scalar:
        """h · column."""
        value = self.scale * motion[self.signal]
        for part in self.parts:
            value = value + part.by_entry * motion[part.entry] + part.by_itself * constants[part.place]
        return value if self.offset is None else value + entries(constants)[self.offset]

    def covariance(self, prior: Prediction) -> tuple[Vector, Array]:
        """P h, over the motion and over the constants."""
        block, cross, signal = square(prior.motion), prior.cross, self.signal
        motion, constants = self.scale * block[signal], self.scale * cross[signal]
        if self.offset is not None:
            motion = motion + Vector(entries(row)[self.offset] for row in cross)
            constants = constants + prior.row(self.offset)
        for _, by_entry, by_itself, entry, place in self.parts:
            motion = motion + by_entry * block[entry] + by_itself * Vector(row[place] for row in cross)
            constants = constants + by_entry * cross[entry] + by_itself * prior.row(place)
        return motion, constants

    def spread(self, motion: Vector, cross: Vector, constants: Array) -> Scalar:
        """hᵀ P h without parts."""
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
            constants = constants - earlier.constant_gain * per_constant(shared, constants)
        spread = self.of(motion, constants) + variance
        inverse = 1.0 / spread
        return Gain(motion, constants, motion * inverse, constants * per_constant(inverse, constants), spread)
