"""The function that the thesis' observer makes fall (4.3), along a run: value, slope, and what the slope must be.

With the errors e₁ of displacement, e₂ of velocity and ρ of the coefficients, all without units (`LyapunovObserver`),

    V = ½ (e₁ᵀ R K e₁ + e₂ᵀ R e₂ + ρᵀ R ρ),    dV/dτ = -e₂ᵀ R (D + C + L) e₂.

For one mass R = 1, and C, antisymmetric, does no work: (4.33). For two masses with kxy ≠ kyx the thesis takes R = 1 as
well, (4.41), and its slope (4.42) leaves out ½ e₁ᵀ (K - Kᵀ) e₂, of either sign. R = diag(1, kxy/kyx) makes R K
symmetric; a coefficient is weighed by the axis whose equation it stands in, and by the gain by which it is adapted.
Where all are adapted faster at first, by a factor f(τ) that falls, the motion's part of V is f times what it is above,
and dV/dτ has f'/f times that part more, which is never positive.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.arguments import check_kind
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import UX, VX, AbstractGyro, Dynamics, Inertial, Scalar

from .observers.lyapunov import LyapunovObserver
from .trace_result import Trace


class LyapunovFunction(NamedTuple):
    """Along a trace, for its kept samples (samples,): `value` V, `slope` dV/dτ of the observer's equations in
    continuous time at that state, differentiated by JAX, and `expected`, the quadratic form that theory gives for it.
    """

    value: Float[np.ndarray, " samples"]
    slope: Float[np.ndarray, " samples"]
    expected: Float[np.ndarray, " samples"]


class _Errors(NamedTuple):
    displacement: Array
    velocity: Array
    coefficients: Array


def lyapunov_function(trace: Trace, *, weighted: bool = True) -> LyapunovFunction:
    """V and its slope along a trace of a loop with a `LyapunovObserver`, under a constant rate.

    Coefficients that are not adapted must be right, or they are a disturbance that V knows nothing of.
    `weighted=False` takes R = 1 for two masses too, as the thesis does: `expected` is then (4.42), which the slope is
    not. The identity is that of continuous time with noise-free volts; a run departs from it by its samples.

    Raises `InputError` for another observer, a moving rate, or what is no trace.
    """
    check_kind("trace", trace, Trace, "a run that `simulate` returned")
    observer, device = trace.loop.observer, trace.loop.device
    if not isinstance(observer, LyapunovObserver):
        raise InputError(f"The loop must have a LyapunovObserver, but its observer is {type(observer).__name__}.")
    if np.ptp(trace.rate_true) > 0.0:
        raise InputError("The rate must be constant along the trace, but it moves.")
    length, omega = float(observer.length), float(observer.frequency)
    true = _without_units(device.dynamics(Inertial(rate=jnp.asarray(trace.rate_true[0]))), omega)
    weight = axis_weights(true) if weighted else jnp.ones(2)
    unit = jnp.asarray(observer.unit)
    scale = jnp.array([length, length, length * omega, length * omega])
    motion, estimate = trace.motion / scale, trace.motion_estimate / scale
    errors = _Errors(
        motion[:, :2] - estimate[:, :2], motion[:, 2:] - estimate[:, 2:], (trace.theta - trace.theta_estimate) / unit
    )
    rows = jax.vmap(lambda m: _regressor(observer, m))(jnp.concatenate([trace.motion_estimate, trace.force], axis=1))
    adaptation = jnp.asarray(observer.adaptation)
    gain, parts = jnp.asarray(observer.gain), _coefficient_weights(observer, weight)

    def part_of_motion(at: _Errors, time: Array) -> Array:
        return observer.haste(time / omega) * _value(at, true.stiffness, weight)

    def one(at: _Errors, row: Array, time: Array) -> tuple[Array, Array, Array]:
        haste, still = observer.haste(time / omega), jax.tree.map(jnp.zeros_like, at)
        moving = _Errors(
            at.velocity,
            row @ at.coefficients - true.stiffness @ at.displacement - (true.velocity + jnp.diag(gain)) @ at.velocity,
            -haste * adaptation * (row.T @ at.velocity),
        )
        whole = lambda e, t: part_of_motion(e, t) + 0.5 * parts @ e.coefficients**2  # noqa: E731
        value, slope = jax.jvp(whole, (at, time), (moving, jnp.ones_like(time)))
        taken = haste * (at.velocity * weight) @ (true.velocity + jnp.diag(gain)) @ at.velocity
        return value, slope, jax.jvp(part_of_motion, (at, time), (still, jnp.ones_like(time)))[1] - taken

    found = jax.jit(jax.vmap(one))(errors, rows, jnp.asarray(trace.time * omega))
    return LyapunovFunction(*map(np.asarray, found))


def least_gain(device: AbstractGyro, rate: Scalar) -> Scalar:
    """Smallest gain of (4.12), in rad/s, from which V cannot rise at `rate` [rad/s], the damping left out: zero for one
    mass, |r Ω - Ωr|/√r with r = kxy/kyx for two (1.096·|Ω| for Table 5.2, where the thesis has |Ω|).
    """
    dynamics = _without_units(device.dynamics(Inertial(rate=jnp.asarray(rate))), 1.0)
    weight = axis_weights(dynamics)
    coriolis = dynamics.velocity - jnp.asarray(device.dynamics(Inertial()).velocity)
    cross = 0.5 * (weight[0] * coriolis[0, 1] + weight[1] * coriolis[1, 0])
    return jnp.abs(cross) / jnp.sqrt(weight[0] * weight[1])


def axis_weights(dynamics: "_Plain") -> Array:
    """Diagonal of R: (1, kxy/kyx), or ones where the stiffness is symmetric."""
    kxy, kyx = dynamics.stiffness[0, 1], dynamics.stiffness[1, 0]
    return jnp.array([1.0, jnp.where(kyx == 0.0, 1.0, kxy / jnp.where(kyx == 0.0, 1.0, kyx))])


class _Plain(NamedTuple):
    """Matrices (2, 2) without units."""

    stiffness: Array
    velocity: Array


def _without_units(dynamics: Dynamics, omega: float) -> _Plain:
    return _Plain(jnp.asarray(dynamics.stiffness) / omega**2, jnp.asarray(dynamics.velocity) / omega)


def _value(at: _Errors, stiffness: Array, weight: Array) -> Array:
    """The motion's part of V."""
    spring = at.displacement @ (weight[:, None] * stiffness) @ at.displacement
    return 0.5 * (spring + weight @ at.velocity**2)


def _regressor(observer: LyapunovObserver, at: Array) -> Array:
    """Acceleration (2, coefficients) per unit of each coefficient, without units: M of (4.35)."""
    length, omega = observer.length, observer.frequency
    rows = [[0.0] * len(observer.unit) for _ in range(2)]
    for k, (unit, coefficient) in enumerate(zip(observer.unit, observer.model.coefficients, strict=True)):
        for axis, signal, factor in coefficient.terms:
            size = length * omega**2 / unit if signal >= UX else length * omega if signal >= VX else length
            rows[axis][k] = rows[axis][k] + factor * at[signal] / size
    return jnp.array(rows)


def _coefficient_weights(observer: LyapunovObserver, weight: Array) -> Array:
    """R of each coefficient, the weight of the (first) axis in whose equation it stands, over its gain; one that is not
    adapted has that of a gain of 1.
    """
    gains = [jnp.where(gain == 0.0, 1.0, gain) for gain in observer.adaptation]
    return jnp.stack([weight[c.terms[0].axis] / g for c, g in zip(observer.model.coefficients, gains, strict=True)])
