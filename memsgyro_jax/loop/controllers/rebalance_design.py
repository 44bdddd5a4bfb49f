"""Gains of the loops that hold a sense axis still by force, from how far its frequency is from the drive's.

With p = d + jΔω the pole of the sense axis in phasors that turn with the drive, d its decay and Δω how far it is away,
a force moves it like 1/(s + p). Where Δω is small beside the demodulator's pole b, loops in the phase of its velocity
close around both:

    L(s) = K (s + a) / (s (s + p)) · b/(s + b),   K = b/4,  a = K/5 or d,

whichever of a is more. They bear any p of such a size, of the other sign too, so that dies whose modes cross stay
stable. Where Δω is large, L is an integral in the phase of the displacement that crosses far below Δω, where the axis'
resonance stands out by Δω/d: the demodulator filters that, and the integral is what it bears, d (1 + Δω/b)/4.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Dynamics, Scalar


_AROUND = 0.2  # Δω over b up to which loops close around both: -1 is 0.8 away, 0.55 for a die twice as far apart
_FLAT = 0.15  # the same where their answer to a rate is flat within a fifth
_OF_POLE = 0.25  # of the demodulator's pole: what a loop crosses at
_LEAST = 0.8  # of Δω: what loops that close around it cross at
_BELOW = 0.99  # of the pole that would close around: the widest that does not
_ZERO = 0.2  # of the crossing: where its integral ends
DRIVE_SHARE, _WIDEST_SHARE = 20.0, 8.0  # of the drive's frequency to the usual pole, and to the widest


class RebalanceDesign(NamedTuple):
    """Bandwidth of the demodulator [Hz], angle [rad] by which what is left is turned, and both gains."""

    width: Scalar
    turn: Scalar
    gain: Scalar
    integral: Scalar


def rebalance_design(
    dynamics: Dynamics, omega: Scalar, bandwidth: Any = None, width: Any = None, least: Scalar = 0.0
) -> RebalanceDesign:
    """For a drive at `omega` [rad/s]. A `bandwidth` [Hz] is where the loops shall cross, `width` [Hz] that of the
    demodulator; what is None follows the device, the demodulator's pole no narrower than `least` [1/s].

    **Raises:** `InputError` for a bandwidth at which the sense axis is not stable.
    """
    pole = dynamic_stiffness(dynamics, omega) / (dynamics.damping[1][1] + 2j * omega)
    decay, away = 0.5 * dynamics.damping[1][1], jnp.abs(jnp.imag(pole))
    wanted = None if bandwidth is None else 2.0 * jnp.pi * jnp.asarray(bandwidth)
    roll_off = _pole(decay, away, omega, wanted, least) if width is None else 2.0 * jnp.pi * jnp.asarray(width)
    around = away <= _AROUND * roll_off
    if wanted is not None:
        _check_around(around, wanted, away)
    else:
        borne = 0.25 * decay * (1.0 + away / roll_off)
        wanted = jnp.where(around, _OF_POLE * roll_off, borne)
    size = jnp.abs(pole)
    turn = jnp.where(around, -jnp.arctan2(jnp.imag(pole), jnp.real(pole)), 0.0)
    gain = wanted * jnp.where(around, 1.0 / size, jnp.real(1.0 / pole))
    integral = wanted * jnp.where(around, jnp.maximum(_ZERO * wanted, decay) / size, 1.0)
    found = RebalanceDesign(roll_off / (2.0 * jnp.pi), turn, gain, integral)
    if bandwidth is not None:
        _check_stable(found, dynamics, omega, bandwidth)
    return found


def _pole(decay: Scalar, away: Scalar, omega: Scalar, wanted: Any, least: Scalar) -> Scalar:
    """The demodulator's pole [1/s]: a twentieth of the drive's frequency, or more up to an eighth where loops close
    around the split then; else the quarter of it is the integral that the resonance bears. It is four times a bandwidth
    that is `wanted` where that is more.
    """
    usual, asked = omega / DRIVE_SHARE, 0.0 if wanted is None else wanted / _OF_POLE
    wide = jnp.clip(jnp.maximum(away / _FLAT, asked), usual, omega / _WIDEST_SHARE)
    bears = 0.5 * decay + jnp.sqrt(0.25 * decay**2 + decay * away)
    narrow = jnp.minimum(jnp.maximum(jnp.maximum(bears, asked), least), jnp.minimum(usual, _BELOW * away / _AROUND))
    slow = False if wanted is None else wanted < _LEAST * away
    return jnp.where((away <= _AROUND * wide) & jnp.logical_not(slow), wide, narrow)


def _check_around(around: Any, wanted: Any, away: Scalar) -> None:
    """Raises `InputError` for loops that close around a split and would cross far below it."""
    if is_concrete(around, wanted, away) and np.any(np.asarray(around) & np.asarray(wanted < _LEAST * away)):
        apart = float(np.max(away)) / (2.0 * np.pi)
        raise InputError(
            f"Argument `bandwidth` must be {_LEAST * apart:.3g} Hz or more where the demodulator closes around the "
            f"axes, which are {apart:.4g} Hz apart, or `demodulator_bandwidth` below {apart / _AROUND:.4g} Hz."
        )


def dynamic_stiffness(dynamics: Dynamics, omega: Scalar) -> Scalar:
    """Δ(jω) of the sense axis, per mass."""
    return dynamics.stiffness[1][1] - omega**2 + 1j * omega * dynamics.damping[1][1]


def _check_stable(made: RebalanceDesign, dynamics: Dynamics, omega: Scalar, bandwidth: Any) -> None:
    """Raises `InputError` where the phasor of a rebalanced y grows: one of the roots of

        s (s + b) (s² + (2jω + d) s + Δ) + b Δ e^(j turn) (k s + i).

    Looked at where all numbers are known: not while a program is traced.
    """
    delta, damping = dynamic_stiffness(dynamics, omega), dynamics.damping[1][1]
    parts = (made.gain, made.integral, 2.0 * jnp.pi * made.width, omega, damping, delta, made.turn)
    if not is_concrete(parts):
        return
    for k, i, b, w, d, held, turn in zip(*(np.ravel(part) for part in np.broadcast_arrays(*parts)), strict=True):
        turning = d + 2j * w
        pushed = b * held * np.exp(1j * turn)
        roots = np.roots([1.0, b + turning, b * turning + held, b * held + pushed * k, pushed * i])
        growth = roots.real.max()
        if growth > 0.0:
            apart = abs(np.sqrt(held.real + w**2) - w) / (2.0 * np.pi)
            raise InputError(
                f"Argument `bandwidth` must leave the rebalanced sense axis stable, but at {np.max(bandwidth):.4g} Hz "
                f"it grows by {growth:.3g} 1/s: the axes are {apart:.4g} Hz apart. Lower `demodulator_bandwidth`, or "
                f"raise it to {apart / _AROUND:.4g} Hz and more, match the axes, damp the sense axis more, or leave "
                "`bandwidth` out."
            )
