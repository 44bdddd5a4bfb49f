"""A hardening resonance swept up and down shows two branches: both, and where each ends, against integration."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.effects import CubicStiffness
from memsgyro_jax.effects.lock_in_terms import LockInBackground, ReferencePhase
from memsgyro_jax.measurement.experiments import CartesianNoise, HarmonicSweep, Phasors
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.phasor_fit import device_of_phasors


W, D, K3, F = 1.0, 0.04, 0.05, 0.12
UP = np.linspace(1.0, 1.2, 21)
CYCLES, STEPS = 240, 40


@jax.jit
def integrated(frequencies):
    """Last cycle's phasor at each frequency in turn, by the classical Runge-Kutta method."""

    def at(state, omega):
        h = 2 * jnp.pi / STEPS

        def rate(y, phase):
            return jnp.stack([y[1], F * jnp.cos(phase) - W**2 * y[0] - D * y[1] - K3 * y[0] ** 3]) / omega

        def advance(y, k):
            phase = h * (k % STEPS)
            a = rate(y, phase)
            b = rate(y + h / 2 * a, phase + h / 2)
            c = rate(y + h / 2 * b, phase + h / 2)
            d = rate(y + h * c, phase + h)
            return y + h / 6 * (a + 2 * b + 2 * c + d), y[0] * jnp.exp(-1j * phase) * 2 / STEPS

        state, parts = jax.lax.scan(advance, state, jnp.arange(CYCLES * STEPS))
        return state, jnp.sum(parts[-STEPS:])

    return jax.lax.scan(at, jnp.zeros(2), frequencies)[1]


@pytest.fixture(scope="module")
def rows():
    return np.concatenate([UP, UP[::-1]])


@pytest.fixture(scope="module")
def truth():
    return np.concatenate([np.asarray(integrated(jnp.asarray(f))) for f in (UP, UP[::-1])])


def swept(rows, near):
    count = len(rows)
    sweep = np.repeat([0.0, 1.0], count // 2)
    return HarmonicSweep(
        "sweep", jnp.asarray(rows), jnp.full((count, 1), F + 0j), jnp.zeros((count, 1), complex), CartesianNoise(1.0),
        Conditions(sweep=sweep).rows(count), near, jnp.asarray(1 - 2 * sweep),
    )  # fmt: skip


MODEL = Model(NormalisedDevice([W**2], [D], 1.0), effects=(CubicStiffness("x", K3),))


def test_each_direction_has_its_own_branch(truth):
    up, down = np.abs(truth[:21]), np.abs(truth[21:])[::-1]
    assert np.argmax(np.abs(np.diff(up))) > np.argmax(np.abs(np.diff(down))) + 2, "the fold is there"


@pytest.mark.slow
def test_the_branch_nearest_to_the_readings(rows, truth):
    found = np.asarray(swept(rows, jnp.asarray(truth)[:, None]).predict(MODEL))[:, 0]
    np.testing.assert_allclose(found, truth, atol=3e-3 * np.abs(truth).max())


def test_the_branch_of_readings_that_the_lock_in_turned(rows, truth):
    """And shifted by a background, as the model knows: as they were read they led to the other branch in three rows."""
    turn, background = ReferencePhase([1.2], np.ones((1, 1, 1))), LockInBackground([0.1, -0.2])
    read = truth * np.exp(1.2j) + (0.1 - 0.2j)
    found = np.asarray(swept(rows, jnp.asarray(read)[:, None]).predict(MODEL.with_effect(turn, background)))[:, 0]
    np.testing.assert_allclose(found, read, atol=3e-3 * np.abs(truth).max())


def test_amplitudes_of_a_folded_resonance_tell_its_start(truth, rows):
    amplitude = np.abs(truth)[:, None] + 0j
    offered = Phasors(rows, amplitude, np.full((42, 1), F + 0j), np.full(42, 1e4), modulus=True)
    device = device_of_phasors([offered])
    assert abs(float(device.stiffness[0]) - W**2) < 0.1 * W * D, "a tenth of the width"
    assert float(device.damping[0]) == pytest.approx(D, rel=0.2), "without the third harmonic"
    assert float(device.mobility) == pytest.approx(1.0, rel=0.05)
