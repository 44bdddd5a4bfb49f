"""The angle that the frame has turned, read off the vibration itself (thesis 2.3 and chapter 6): no rate is integrated.

The free motion of an ideal gyro is an ellipse that stands still in inertial space (6.5), with θ = √k t + θ₀,

    x = a cos θ cos φ - b sin θ sin φ,    vx = √k (-a sin θ cos φ - b cos θ sin φ),
    y = a cos θ sin φ + b sin θ cos φ,    vy = √k (-a sin θ sin φ + b cos θ cos φ),

so that a frame turning at Ω sees φ fall at Ω. With velocities as the frame sees them, as (2.13) and (6.9) have it, φ
ripples at twice the vibration by Ω/(2√k), also on a perfect gyro. With inertial velocities vx - Ω y, vy + Ω x it does
not; the equations of the thesis, which drop the frame's Ω² and dΩ/dt, then vibrate at √(k + Ω²), those that keep them
at √k.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.device.gyro import Scalar
from memsgyro_jax.device.propagate import State4

from .filters import Bandpass, Lowpass


class VibrationEllipse(NamedTuple):
    """The ellipse of (6.5): half axes in m, `minor` negative where it is run through clockwise, the `angle` φ of the
    major axis from x to y, from -π/2 to π/2, and the `phase` θ along the ellipse, both in rad.
    """

    major: Scalar
    minor: Scalar
    angle: Scalar
    phase: Scalar


class AngleRecord(NamedTuple):
    """An `angle` [rad] of the vibration over `time` [s], the moments at which it held: a filter's delay is taken off.

    Angles are continuous along the record; the frame's is minus the change of this one.
    """

    time: Float[Array, " samples"]
    angle: Float[Array, " samples"]


def vibration_ellipse(
    motion: State4, frequency: Scalar, rate: Scalar = 0.0, *, rotating_frame: bool = False
) -> VibrationEllipse:
    """The ellipse of `motion` (x, y, vx, vy) in m and m/s, that vibrates at `frequency` [Hz] in a frame at rest.

    A `rate` [rad/s] of the frame of zero takes the velocities as they are, as the thesis does. With the rate the angle
    is exact: under a constant rate of the thesis' equations, or with `rotating_frame`, as of a device that keeps all
    terms of the frame, under any. A circle has no angle, and no derivative.

    **Raises:** `InputError` for a frequency or rate that is neither a number nor text with its unit.
    """
    x, y, vx, vy = motion
    frequency, rate = quantity("frequency", frequency, "Hz"), quantity("rate", rate, "rad/s")
    stiffness = (2.0 * jnp.pi * frequency) ** 2
    omega = jnp.sqrt(stiffness if rotating_frame else stiffness + rate**2)
    u, v = (vx - rate * y) / omega, (vy + rate * x) / omega
    # Circular motions: z = e^{iφ} (½(a+b) e^{iθ} + ½(a-b) e^{-iθ}) for z = x + iy, counter-clockwise and clockwise.
    ccw, cw = (0.5 * (x + v), 0.5 * (y - u)), (0.5 * (x - v), 0.5 * (y + u))
    first, second = (jnp.hypot(*circle) for circle in (ccw, cw))
    phase = 0.5 * jnp.arctan2(ccw[1] * cw[0] - ccw[0] * cw[1], ccw[0] * cw[0] + ccw[1] * cw[1])
    angle = vibration_angle(motion, frequency, rate, rotating_frame=rotating_frame)
    # θ and φ are each known up to π together: the major axis points where the sum of both is the first circle's angle.
    flipped = jnp.cos(angle + phase) * ccw[0] + jnp.sin(angle + phase) * ccw[1] < 0.0
    return VibrationEllipse(first + second, first - second, angle, jnp.where(flipped, phase + jnp.pi, phase))


def vibration_angle(motion: State4, frequency: Scalar, rate: Scalar = 0.0, *, rotating_frame: bool = False) -> Scalar:
    """The angle φ of `vibration_ellipse` alone [rad], from -π/2 to π/2: (2.13) and (6.9) at rate zero."""
    x, y, vx, vy = motion
    frequency, rate = quantity("frequency", frequency, "Hz"), quantity("rate", rate, "rad/s")
    omega = 2.0 * jnp.pi * frequency
    stiffness = omega**2 if rotating_frame else omega**2 + rate**2
    vx, vy = vx - rate * y, vy + rate * x
    return 0.5 * jnp.arctan2(2.0 * (stiffness * x * y + vx * vy), stiffness * (x**2 - y**2) + vx**2 - vy**2)


def angle_by_lowpass(
    motion: Float[Array, "samples 4"],
    frequency: Scalar,
    sample_rate: float,
    lowpass: Lowpass | None = None,
    *,
    rate: Scalar | Float[Array, " samples"] = 0.0,
    moving: float = 0.0,
) -> AngleRecord:
    """Method 1 (6.8): the angle of each row of `motion`, then a low-pass, of 200 Hz and order 4 as in Fig 7.5 unless
    another is given.

    An auxiliary tone smaller than the vibration turns into ripple, which the filter takes away, and into no offset.
    `rate` is that of `vibration_angle`, zero for the thesis' form. The delay taken off is that at which an angle lags
    that moves at `moving` [Hz], zero slowly.
    """
    lowpass = lowpass if lowpass is not None else Lowpass(200.0, 4)
    found = _continuous(vibration_angle(tuple(jnp.asarray(motion).T), frequency, rate))
    return _record(lowpass.apply(found, sample_rate, found[0]), sample_rate, lowpass.delay(1.0 / sample_rate, moving))


def angle_by_bandpass(
    motion: Float[Array, "samples 4"], frequency: Scalar, sample_rate: float, bandpass: Bandpass | None = None
) -> AngleRecord:
    """Method 2 (6.10): the angle of the motion behind a band-pass, of `frequency` ± 200 Hz and order 4 as in Fig 7.4
    unless another is given. The band-pass starts empty: the first hundredth of a second tells little.
    """
    frequency = quantity("frequency", frequency, "Hz")
    band = bandpass if bandpass is not None else Bandpass(frequency - 200.0, frequency + 200.0, 4)
    filtered = band.apply(jnp.asarray(motion), sample_rate)
    found = _continuous(vibration_angle(tuple(filtered.T), frequency))
    return _record(found, sample_rate, band.delay(1.0 / sample_rate))


def _continuous(angle: Array) -> Array:
    return jnp.unwrap(angle, period=jnp.pi)


def _record(angle: Array, sample_rate: float, delay: Scalar) -> AngleRecord:
    return AngleRecord(jnp.arange(len(angle)) / sample_rate - delay, angle)
