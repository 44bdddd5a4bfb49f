"""Settled vibrations by harmonic balance against shooting with SciPy, for every member that is not linear.

The figure beside each is the largest error allowed, relative to the signal: what 3 harmonics and 32 samples of a period
give, rounded up. Smooth members reach what shooting does; those with a corner are limited by the samples.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from effects.shooting import Plant, first_harmonic, settled

from memsgyro_jax import effects as fx
from memsgyro_jax.device.gyro import SingleMassGyro
from memsgyro_jax.measurement.model import Conditions, Model
from memsgyro_jax.measurement.steady import fundamental, steady_state


# A gyro of low quality factor: few periods of memory, strong drive, amplitude A of some 10 µm.
MASS = 1.8e-7
STIFFNESS, DAMPING = np.array([[64.0, 0.5], [0.5, 72.0]]), np.array([[1e-4, 5e-6], [5e-6, 1.2e-4]])
DEVICE = SingleMassGyro(mass=MASS, kxx=64.0, kyy=72.0, kxy=0.5, dxx=1e-4, dyy=1.2e-4, dxy=5e-6)
NATURAL, SCALE, DRIVE = np.sqrt(64.0 / MASS), 5e5, 2e-5
A = DRIVE / (1e-4 * NATURAL)
OMEGA = 1.002 * NATURAL
THETA = 2 * np.pi * np.arange(2048) / 2048

on_x = np.array([1.0, 0.0])


def rounded_sign(q, v):
    swing = v**2 + 0.01 * 64.0 / MASS * q**2
    return v * swing / (swing + 1e-14) ** 1.5


def case(effect, extra=None, read=None, both=False, tolerance=1e-6):
    """Effect, its force on top of the linear plant, its read-out of (displacement, drive), whether y is driven too."""
    return pytest.param(effect, extra, read, both, tolerance, id=effect.label)


S3, S2, D2, D3 = 0.2 * 64 / A**2, 0.2 * 64 / A, 0.2 * 1e-4 / (NATURAL * A), 0.2 * 1e-4 / A**2
CASES = [
    case(fx.CubicStiffness("x", S3), lambda q, v, u: -S3 * q[0] ** 3 * on_x),
    case(fx.CubicStiffness("x", -0.1 * S3), lambda q, v, u: 0.1 * S3 * q[0] ** 3 * on_x),
    case(fx.QuadraticStiffness("x", S2), lambda q, v, u: -S2 * q[0] ** 2 * on_x),
    case(fx.CrossStiffness(S3), lambda q, v, u: -S3 * q * q[::-1] ** 2, both=True),
    case(fx.QuadraticDamping("x", D2), lambda q, v, u: -D2 * abs(v[0]) * v[0] * on_x, tolerance=1e-4),
    case(fx.SqueezeFilmDamping("x", D3), lambda q, v, u: -D3 * q[0] ** 2 * v[0] * on_x),
    case(fx.DryFriction("x", 2e-6), lambda q, v, u: -2e-6 * rounded_sign(q[0], v[0]) * on_x, tolerance=2e-3),
    case(fx.DriveNonlinearity("x", 1e4), lambda q, v, u: 1e4 * u[0] ** 2 * on_x),
    case(fx.PickoffNonlinearity("x", 0.2 / A), read=lambda q: q + 0.2 / A * q[0] ** 2 * on_x[:, None]),
    case(fx.PickoffCubicNonlinearity("x", 0.2 / A**2), read=lambda q: q + 0.2 / A**2 * q[0] ** 3 * on_x[:, None]),
    case(
        fx.AdcSaturation(1 / (0.8 * SCALE * A)),
        read=lambda q: np.clip(q, -0.8 * A, 0.8 * A),
        tolerance=2e-3,  # the corners of the clipped wave fall between the samples; 256 of them would give 2e-5
    ),
    case(
        fx.ReadoutDelay(2.6 / OMEGA),
        read=lambda q: np.real(first_harmonic(q)[:, None] * np.exp(1j * (THETA - 2.6))),
        tolerance=5e-7,
    ),
]


@pytest.mark.parametrize(("effect", "extra", "read", "both", "tolerance"), CASES)
def test_harmonic_balance_agrees_with_shooting(effect, extra, read, both, tolerance):
    drive = DRIVE * np.array([1.0, float(both)])
    model, force, conditions = Model(DEVICE, scale=SCALE, effects=(effect,)), jnp.asarray(drive + 0j), Conditions()
    plain = np.linalg.solve(STIFFNESS - MASS * OMEGA**2 * np.eye(2) + 1j * OMEGA * DAMPING, drive)

    @jax.jit
    def balanced(model):
        state = steady_state(model, jnp.asarray(OMEGA), force, conditions, jnp.asarray(plain))
        return state[1, :2], fundamental(model, OMEGA, state, force, conditions)

    guess, volts = balanced(model)
    plant = Plant(MASS, STIFFNESS, DAMPING, extra or (lambda q, v, u: np.zeros(2)))
    displacement, _ = settled(plant, OMEGA, drive, np.asarray(guess))
    expected = SCALE * first_harmonic(read(displacement) if read else displacement)
    np.testing.assert_allclose(volts, expected, atol=tolerance * np.abs(expected).max(), rtol=0)
    seen = np.abs(expected - SCALE * plain).max() / np.abs(expected).max()
    even = isinstance(effect, fx.DriveNonlinearity | fx.PickoffNonlinearity)
    assert seen < 1e-8 if even else seen > 30 * tolerance, "the effect is seen, but for those of even order"
