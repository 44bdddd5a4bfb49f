"""A design made for one device, carried over to the modes of another."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.device.gyro import AbstractGyro, Inertial

from .information import Tones


class Aim(NamedTuple):
    """How a die differs from the design device: `turn` takes the shapes of its modes to the die's, `modes` are the
    logarithms of the device's mode frequencies, `shift` by how much the die's are higher.
    """

    turn: Float[Array, "2 2"]
    modes: Float[Array, "2"]
    shift: Float[Array, "2"]


def aim(old: AbstractGyro, new: AbstractGyro) -> Aim:
    """From device `old` to `new`."""
    (old_modes, old_shapes), (new_modes, new_shapes) = modes(old), modes(new)
    same = np.sign(np.sum(old_shapes * new_shapes, axis=0))  # a shape has no sign of its own
    return Aim(new_shapes * same @ np.linalg.inv(old_shapes), np.log(old_modes), np.log(new_modes / old_modes))


def stay(gyro: AbstractGyro) -> Aim:
    """The aim that changes nothing: every die moves alike."""
    return Aim(np.eye(2), np.log(modes(gyro)[0]), np.zeros(2))


def aimed(tones: Tones, how: Aim, displacement: Float[Array, ""]) -> Tones:
    """Frequencies moved along with the modes (in proportion between and outside them), amplitudes with their shapes,
    lowered together where an axis would exceed `displacement` [m].
    """
    low, high = how.modes
    place = jnp.clip((jnp.log(tones.omega / (2.0 * jnp.pi)) - low) / (high - low), 0.0, 1.0)
    omega = tones.omega * jnp.exp(how.shift[0] + place * (how.shift[1] - how.shift[0]))
    turned = tones.amplitude @ how.turn.T
    reach = jnp.max(jnp.sum(jnp.sqrt(turned.real**2 + turned.imag**2 + 1e-40), axis=0)) / displacement
    return Tones(omega, turned / jnp.maximum(reach, 1.0))


def modes(gyro: AbstractGyro) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2 2"]]:
    """Undamped mode frequencies [Hz], ascending, and their unit shapes in columns."""
    # Stiffness over mass has real modes; newer NumPy gives them as complex numbers all the same.
    values, shapes = (part.real for part in np.linalg.eig(np.asarray(gyro.dynamics(Inertial()).stiffness, float)))
    order = np.argsort(values)
    return np.sqrt(values[order]) / (2.0 * np.pi), shapes[:, order]
