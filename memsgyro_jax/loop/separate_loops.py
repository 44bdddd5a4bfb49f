"""Margins of the loops of classic control one by one, without linear algebra: what a loss may ask for inside a run.

A call of a linear-algebra library on every device at once can wait for itself, so that `loop_margins`, which counts
all couplings, stays outside compiled lots.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.plainly import at_once
from memsgyro_jax.device.gyro import Inertial, Scalar

from .controllers import ClassicControl, ForceRebalance
from .lateness import delays
from .loop import ClosedLoop
from .stability import LoopMargins


def separate_margins(loop: ClosedLoop) -> LoopMargins:
    """Margins of each loop of `loop` with the others taken as ideal, averaged over a period of the drive; the coupling
    of the axes is left out:

        phase      (k + i/s) / (s + d/2),   amplitude  (k + i/s) / (2 m ω (s + d/2)),
        sense      (k + i/s) C 2 ω A / (j Δ(s + jω)),

    each with the demodulator's b/(s + b); d is the damping per mass, Δ the dynamic stiffness per mass, of the device,
    while gains, ω, A and conversion C (turned) are the controller's. A late read-out delays each loop, turns that of
    the sense axis by ω times its delay and weakens that of the amplitude by the cosine of it. Differentiable, a lot
    gives a margin for each die. Raises `InputError` for another controller.
    """
    control: Any = loop.controller
    if not isinstance(control, ClassicControl):
        raise InputError(
            f"Argument `loop` must be driven by `ClassicControl`, but its controller is a {type(control).__name__}."
        )
    return _separate(loop)


@at_once
def _separate(loop: ClosedLoop) -> LoopMargins:
    control: Any = loop.controller
    drive, dynamics = control.drive, loop.device.dynamics(Inertial())
    omega, pole = 2.0 * jnp.pi * drive.frequency, 2.0 * jnp.pi * drive.demodulator.bandwidth
    decay, *late = jnp.broadcast_arrays(0.5 * dynamics.damping[0][0], *delays(loop))
    shown = [true / design for true, design in zip(loop.readout.scale, control.scale, strict=True)]

    def swing(s: Array) -> Array:
        return pole / (s + pole) / (s + decay) * jnp.exp(-s * late[0])

    grow = shown[0] * jnp.cos(omega * late[0]) * dynamics.gain[0] / (2.0 * omega)
    along = _around(jnp.zeros_like(decay), decay, pole)
    phase = _distance(swing, drive.phase_gain, drive.phase_integral, along, pole)
    amplitude = _distance(lambda s: grow * swing(s), drive.force_gain, drive.force_integral, along, pole)
    if not isinstance(control.sense, ForceRebalance):
        one = jnp.ones_like(phase)
        return LoopMargins(phase, amplitude, one, one)
    sense, width = control.sense, 2.0 * jnp.pi * control.sense.demodulator.bandwidth
    per_rate = -1j * (sense.balanced[0] + 1j * sense.balanced[1])
    per_rate = per_rate * sense.force_per_rate * dynamics.gain[1] * shown[1]
    stiffness, damping, _ = jnp.broadcast_arrays(dynamics.stiffness[1][1], dynamics.damping[1][1], late[1])

    def still(s: Array) -> Array:
        turning = s + 1j * omega
        then = jnp.exp(-turning * late[1])
        return per_rate * then * width / (s + width) / (stiffness + turning * (turning + damping))

    split = jnp.sqrt(stiffness) - omega
    across = _around(split, 0.5 * damping, width)
    rate, quadrature = (
        _distance(still, gain, integral, across, width)
        for gain, integral in ((sense.gain, sense.integral), (sense.quadrature_gain, sense.quadrature_integral))
    )
    return LoopMargins(phase, amplitude, rate, quadrature)


_POINTS = np.sinh(np.linspace(-14.0, 14.0, 281))


def _around(resonance: Scalar, decay: Scalar, pole: Scalar) -> Array:
    """Angular frequencies (leading axis) that resolve a resonance and the middle, far beyond both."""
    fine = jnp.reshape(jnp.asarray(_POINTS), (-1,) + (1,) * jnp.ndim(resonance + decay + pole))
    return jnp.sort(jnp.concatenate(jnp.broadcast_arrays(resonance + decay * fine, 0.01 * pole * fine)), axis=0)


def _distance(plant: Callable[[Array], Array], gain: Scalar, integral: Scalar, along: Array, pole: Scalar) -> Scalar:
    """Signed distance of (gain + integral/s) · plant(s) from -1.

    s/(s + pole) · (1 + L) has its poles to the left and ends at 1: its turns about zero count the unstable poles.
    """
    missing = 1 + jnp.ndim(gain + integral) - jnp.ndim(along)  # axes of dies that differ in their gains alone
    s = 1j * jnp.reshape(along, along.shape + (1,) * max(missing, 0))
    beside = s + (gain * s + integral) * plant(s)  # s (1 + L)
    turned = beside / (s + pole)
    angle = jnp.sum(jnp.angle(turned[1:] / turned[:-1]), axis=0)
    unstable = jnp.abs(angle) > jnp.pi
    size = jnp.min(jnp.abs(beside) / jnp.maximum(jnp.abs(s), 1e-9 * pole), axis=0)
    return jnp.where(unstable, -size, size)
