"""Rows of a sweep that were read before they had settled, against a linear resonator solved exactly step by step."""

from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.effects.lock_in_terms import LockInTime
from memsgyro_jax.measurement.experiments import CartesianNoise, HarmonicSweep
from memsgyro_jax.measurement.lock_in import ring_down_matrix
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.moving_noise import beside_motion, noise_of_moving
from memsgyro_jax.measurement.noise import noise_over_frequency


F0, QUALITY, FORCE = 1000.0, 2000.0, 1.0
W0 = 2 * np.pi * F0
GAMMA = W0 / (2 * QUALITY)  # 1.57 1/s: 86 % of a motion is left after 0.1 s
RATE = np.sqrt(W0**2 - GAMMA**2)


def stepped(frequency, dwell):
    """Phasors (n, 1) at the end of each row, and those that each would settle at; the phase of the drive goes on."""
    settled = FORCE / (W0**2 - frequency**2 + 2j * GAMMA * frequency)
    out, free = [settled[0]], 0.0
    for n in range(1, len(frequency)):
        # What the displacement and the velocity were, less what the new drive would have them be, moves freely.
        before = settled[n - 1] + free
        apart = (before - settled[n]).real
        speed = (1j * frequency[n - 1] * settled[n - 1] + (-GAMMA + 1j * RATE) * free).real
        speed -= (1j * frequency[n] * settled[n]).real
        start = apart - 1j * (speed + GAMMA * apart) / RATE
        free = start * np.exp((-GAMMA + 1j * (RATE - frequency[n])) * dwell[n])
        out.append(settled[n] + free)
    return np.array(out)[:, None], settled[:, None]


def sweep(frequency, dwell, seen, unsettled):
    count = len(frequency)
    return HarmonicSweep(
        name="sweep",
        frequency=jnp.asarray(frequency),
        force=jnp.full((count, 1), FORCE + 0j),
        measured=jnp.asarray(seen),
        noise=CartesianNoise(1.0),
        surroundings=Conditions().rows(count),
        near=jnp.asarray(seen),
        direction=jnp.ones(count),
        before=jnp.asarray(seen[np.maximum(np.arange(count) - 1, 0)]),
        dwell=jnp.asarray(np.where(np.arange(count) > 0, dwell, np.inf)),
        unsettled=jnp.asarray(unsettled),
    )


@eqx.filter_jit
def predicted(made, model):
    return made.predict(model)


@pytest.mark.parametrize("way", [1, -1])
def test_rows_begin_where_the_row_before_ended(way):
    frequency = 2 * np.pi * (F0 + np.linspace(-2.0, 2.0, 41)[::way])
    dwell = np.full(41, 0.1)
    dwell[20] = 3.0  # a pause
    seen, settled = stepped(frequency, dwell)
    size = np.max(np.abs(settled))
    assert np.max(np.abs(seen - settled)) > 0.3 * size
    model = Model(NormalisedDevice([W0**2], [2 * GAMMA], 1.0))
    found = np.asarray(predicted(sweep(frequency, dwell, seen, np.ones(41)), model))
    assert np.max(np.abs(found - seen)) < 1e-3 * size  # 1/(4Q) of a row, 1.6 % of which die away per row
    still = np.asarray(predicted(sweep(frequency, dwell, seen, np.zeros(41)), model))
    np.testing.assert_allclose(still, settled, rtol=1e-9)


def test_a_filter_lags_behind_a_motion_that_rings():
    """Its output, y' = (V − y)/τ, integrated in small steps over one dwell."""
    frequency, dwell, lag = 2 * np.pi * (F0 + np.linspace(-1.5, 1.5, 41)), np.full(41, 0.4), 0.3
    seen, settled = stepped(frequency, dwell)
    model = Model(NormalisedDevice([W0**2], [2 * GAMMA], 1.0), effects=(LockInTime([lag], np.ones((1, 1, 1))),))
    found = np.asarray(predicted(sweep(frequency, dwell, seen, np.ones(41)), model))
    for row in (5, 19, 21, 33):
        rate = complex(eqx.filter_jit(ring_down_matrix)(model, jnp.asarray(frequency[row]), Conditions())[0, 0])
        assert abs(rate - (GAMMA + 1j * (frequency[row] - W0))) < 1e-2 * abs(rate)
        time = np.linspace(0.0, 0.4, 40001)
        away = seen[row - 1, 0] - settled[row, 0]
        weight = np.exp(-(0.4 - time) / lag) / lag
        value = np.trapezoid(weight * (settled[row, 0] + away * np.exp(-rate * time)), time)
        value += seen[row - 1, 0] * np.exp(-0.4 / lag)
        assert abs(found[row, 0] - value) < 1e-6 * np.max(np.abs(settled))


@pytest.mark.parametrize(("dwell", "span"), [(0.06, 100.0), (0.03, 150.0), (8.0, 4.0)])
def test_motion_from_row_to_row_is_not_taken_for_noise(dwell, span):
    """Steps much shorter than the ring-down of 0.64 s told 4 to 12 times the noise that there was. A row is predicted
    from the row before, as read, so that the noise of both counts.
    """
    frequency, rng = W0 + 2 * np.pi * np.linspace(-span / 2, span / 2, 101), np.random.default_rng(0)
    seen, _ = stepped(frequency, np.full(101, dwell))
    noise = 1e-3 * np.max(np.abs(seen))
    seen = seen + noise * (rng.standard_normal(seen.shape) + 1j * rng.standard_normal(seen.shape))
    pieces = [slice(0, 101)]
    told, freedom = noise_of_moving(dwell * np.arange(101), frequency, seen, [0], pieces)
    assert told == pytest.approx(noise * np.hypot(1.0, np.exp(-GAMMA * dwell)), rel=0.2)
    assert 50 < freedom < 101
    plain = noise_over_frequency(frequency, seen, pieces), 80.0
    record = SimpleNamespace(
        time=dwell * np.arange(101), frequency=frequency, phasors=seen, channels=[0], sweeps=pieces, phase_known=True
    )
    assert beside_motion(plain, record, [0])[0] == (plain[0] if dwell == 8.0 else told)
