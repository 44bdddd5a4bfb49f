"""A device under held forces as the closed forms need it: transition, its derivatives by what is unknown, its modes."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import AbstractGyro, Inertial, MotionModel
from memsgyro_jax.device.propagate import Exact
from memsgyro_jax.loop.bound import CROSS_DAMPING_ASYMMETRY
from memsgyro_jax.loop.observers.base import MOTION, OFFSETS
from memsgyro_jax.loop.readout import AbstractReadout


EXTRAS = (CROSS_DAMPING_ASYMMETRY.name, "gain_x", "gain_y", "delay_x", "delay_y")


class Plant(NamedTuple):
    """One die, sampled: motion' = full @ motion + push @ force.

    The slopes are by the coefficients of its model, the unequal cross damping and the two force gains. `poles` are the
    eigenvalues of `full` (those above the real axis first), `shapes` its eigenvectors in columns, `left` their inverse.
    """

    push: Float[Array, "4 2"]
    full_slopes: Float[Array, "changes 4 4"]
    push_slopes: Float[Array, "changes 4 2"]
    poles: Complex[Array, "4"]
    shapes: Complex[Array, "4 4"]
    left: Complex[Array, "4 4"]
    scale: Float[Array, "2"]
    noise: Float[Array, "2"]


def plant(gyro: AbstractGyro, readout: AbstractReadout, rate: float, sample_rate: float, step: Exact) -> Plant:
    """The plant of one die at a constant rate [rad/s]; raises `InputError` for a device that does not swing."""
    full, push, full_slopes, push_slopes = map(np.asarray, _slopes(gyro, rate, 1.0 / sample_rate, step))
    poles, shapes = np.linalg.eig(full)
    order = np.argsort(-np.angle(poles))
    poles, shapes = poles[order].astype(complex), shapes[:, order].astype(complex)
    if not (np.all(np.angle(poles[:2]) > 0.0) and np.all(np.abs(poles) < 1.0)):
        raise InputError(
            "Argument `gyro` must have two damped resonances, but one of its modes does not swing or does not decay."
        )
    scale, noise = (np.array([float(v) for v in pair]) for pair in (readout.scale, readout.noise_std(1 / sample_rate)))
    return Plant(push, full_slopes, push_slopes, poles, shapes, np.linalg.inv(shapes), scale, noise)


def unknowns(model: MotionModel) -> tuple[str, ...]:
    """Names of the columns of `information.sensitivities`: what an observer finds, then what errors the model has."""
    return (*MOTION, *OFFSETS, *model.names, *EXTRAS)


@eqx.filter_jit
def _slopes(gyro: AbstractGyro, rate: float, period: float, step: Exact) -> tuple[Array, Array, Array, Array]:
    model = MotionModel((*gyro.model.coefficients, CROSS_DAMPING_ASYMMETRY))
    true, count = gyro.dynamics(Inertial(rate=rate)), len(model.names)

    def matrices(change: Array) -> tuple[Array, Array]:
        moved = model.assemble(tuple(change[i] for i in range(count)))
        stiffness, velocity = true.stiffness + moved.stiffness, true.velocity + moved.velocity
        gain = [(g + d) * (1.0 + change[count + i]) for i, (g, d) in enumerate(zip(true.gain, moved.gain, strict=True))]
        made = step.transition(stiffness, velocity, period)
        full, push = (jnp.stack([jnp.stack([1.0 * v for v in row]) for row in m]) for m in (made.full, made.push))
        return full, push * jnp.stack(gain)

    zero = jnp.zeros(count + 2)
    by_full, by_push = jax.jacfwd(matrices)(zero)
    return *matrices(zero), jnp.moveaxis(by_full, -1, 0), jnp.moveaxis(by_push, -1, 0)
