"""Mode matching: the bias of the electrodes at which drive axis and sense axis have one frequency."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import AbstractGyro, Inertial, Pair, Scalar
from memsgyro_jax.effects import ElectrostaticSoftening


def matching_bias(gyro: AbstractGyro, split: Scalar = 0.0) -> Scalar:
    """The bias [V] at which y's own frequency is (1 + `split`) times x's, by the electrostatic softening that `gyro`
    has: V² = V_ref² + (k_y - r k_x) / (s_y - r s_x), stiffness k and softening s per mass, r = (1 + split)².

    Zero `split` matches the axes. A lot has a voltage for each die: its trim. Run it with
    `Scenario(bias_voltage=Constant(V))`, and design the control for `at_bias(gyro, V)`. Raises `InputError` for a
    device without softening, and where no bias does it.
    """
    (kx, _), (_, ky) = gyro.dynamics(Inertial()).stiffness
    ratio, (sx, sy) = (1.0 + jnp.asarray(split)) ** 2, _softening(gyro)
    squared = gyro.reference_bias**2 + (ky - ratio * kx) / (sy - ratio * sx)
    if is_concrete(squared) and not np.all(np.asarray(squared) >= 0.0):
        raise InputError(
            "Argument `gyro` must have a sense axis that a bias can soften to the frequency asked for, but it would "
            f"take {float(np.min(squared)):.4g} V²; stiffen the axis that is softened, or soften the other one."
        )
    return jnp.sqrt(squared)


def at_bias(gyro: AbstractGyro, bias: Scalar) -> AbstractGyro:
    """The device of `gyro` held at `bias` [V], its softening within its stiffness: what a control is designed for.

    Raises `InputError` for a device without softening.
    """
    more = bias**2 - gyro.reference_bias**2
    mobility, given = gyro.dynamics(Inertial()).gain, (gyro.kxx, gyro.kyy)  # type: ignore[attr-defined]
    softer = tuple(k - s * more / g for k, s, g in zip(given, _softening(gyro), mobility, strict=True))
    others = [effect for effect in gyro.effects if not isinstance(effect, ElectrostaticSoftening)]
    return eqx.tree_at(lambda made: (made.kxx, made.kyy), gyro.with_only(others), softer)


def _softening(gyro: AbstractGyro) -> Pair:
    """Per mass, of both axes."""
    found = [effect for effect in gyro.effects if isinstance(effect, ElectrostaticSoftening)]
    if not found or not all(hasattr(gyro, name) for name in ("kxx", "kyy")):
        raise InputError(
            "Argument `gyro` must be softened by a bias, but has no such effect; add "
            '`effects.ElectrostaticSoftening("y", strength)`.'
        )
    x, y = (sum((e.strength for e in found if e.axis == axis), jnp.zeros(())) for axis in (0, 1))
    mobility = gyro.dynamics(Inertial()).gain
    return x * mobility[0], y * mobility[1]
