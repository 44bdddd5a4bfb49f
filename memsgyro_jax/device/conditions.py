"""The state of the world at one moment, for the loop and the bench alike."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.display import Displayed

from .gyro import UNCHANGED, Change, Inertial, Pair


def _number(default: float) -> Any:
    return eqx.field(converter=lambda value: None if value is None else jnp.asarray(value), default=default)


class Conditions(Displayed):
    """What acts on a device from outside, or is known of it: numbers, or one per row or die; zero is undisturbed.

    | field | unit | holds |
    |---|---|---|
    | `rate`, `angular_acceleration` | rad/s, rad/s² | of the frame about z |
    | `rate_trusted` | 1 | 1 where the rate is known apart from the table's own reading, else 0 |
    | `temperature` | K | of the device |
    | `bias_voltage` | V | of the electrodes |
    | `time` | s | within the record |
    | `progress` | 1 | part of the record that has passed, 0 to 1 |
    | `record` | 1 | number of the record in its case, from 0 |
    | `sweep` | 1 | number of the single sweep in its record, from 0 |
    | `cross_rate`, `acceleration` | rad/s, m/s² | of the frame along x and y |
    | `damping_change` | 1 | relative change of (dxx, dyy, dxy) |
    | `offset_drift` | V | change of the read-out's offsets |

    None for a temperature or bias voltage is that at which the device's numbers hold; None for another means zero. A
    bench model takes the last three from its effects and read-out instead.
    """

    rate: Array = _number(0.0)
    angular_acceleration: Array = _number(0.0)
    rate_trusted: Array | None = _number(0.0)
    temperature: Array | None = _number(298.15)
    bias_voltage: Array | None = _number(0.0)
    time: Array | None = _number(0.0)
    progress: Array | None = _number(0.0)
    record: Array | None = _number(0.0)
    sweep: Array | None = _number(0.0)
    cross_rate: Pair = (0.0, 0.0)
    acceleration: Pair = (0.0, 0.0)
    damping_change: Change = UNCHANGED
    offset_drift: Pair = (0.0, 0.0)

    @property
    def inertial(self) -> Inertial:
        """What the equations of motion see of it."""
        return Inertial(self.rate, self.angular_acceleration, self.cross_rate, self.acceleration, self.damping_change)

    def rows(self, count: int) -> "Conditions":
        """The same with every field of shape (count,)."""
        xp = np if is_concrete(self) else jnp  # in NumPy where that can be: a program for every shape takes longer
        return jax.tree.map(lambda leaf: jnp.asarray(xp.broadcast_to(xp.asarray(leaf, float), (count,))), self)
