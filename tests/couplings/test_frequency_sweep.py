"""A sweep is predicted as an independent laboratory would record it, settled or not."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lab import two_modes as lab

from memsgyro_jax.couplings.bench import Bench, LeakPhasors, LockIn
from memsgyro_jax.couplings.frequency_sweep import FrequencySweep
from memsgyro_jax.couplings.modes import CoupledModes
from memsgyro_jax.effects import FiniteSweepRate
from memsgyro_jax.measurement.experiments import PolarNoise


NOISE = PolarNoise.from_peak_to_peak(1e-3, np.radians(3.0))


def modes(gyro):
    stiffness = gyro.matrices()[2]
    damping = np.array([[0.0, gyro.cxy], [gyro.cxy, 0.0]]) + np.diag(np.diag(gyro.matrices()[1]))
    return CoupledModes.from_coefficients(gyro.mass, stiffness, damping, gyro.lam_yx, gyro.lam_xy)


def bench(gyro, instrument, **effects):
    readout = LockIn(
        abs(instrument.gain),
        np.angle(instrument.gain),
        instrument.ratio,
        instrument.asymmetry,
        abs(instrument.drive_ratio),
        np.angle(instrument.drive_ratio),
    )
    return Bench(modes(gyro), readout, **effects)


def sweep(frequency, axis=0, rate=0.0):
    return FrequencySweep("test", 2 * np.pi * frequency, np.ones((len(frequency), 2)) + 0j, NOISE, axis=axis, rate=rate)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("rate", [0.0, 3.0])
def test_settled_sweep_equals_the_laboratory(axis, rate):
    gyro = lab.Gyro(rate=rate)
    instrument = lab.Instrument(ratio=1.3, asymmetry=0.1, drive_ratio=0.7 * np.exp(0.2j))
    predicted = sweep(lab.WIDE, axis, rate).predict(bench(gyro, instrument))
    np.testing.assert_allclose(predicted, lab.record(gyro, instrument, lab.WIDE, axis), rtol=2e-10)


SLOW = lab.Gyro(mass=1e-6, fx=60.0, fy=63.0, qx=150.0, qy=90.0, cxy=4e-7, kxy=3e-3, lam_yx=0.03, lam_xy=-0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("frequency", "axis"),
    [(np.linspace(69, 55, 141), 1), pytest.param(np.linspace(55, 69, 141), 0, marks=pytest.mark.slow)],
)
def test_moving_sweep_equals_the_integrated_equations(frequency, axis):
    speed = 2.0  # Hz/s: a decay time passes in a fifth of the half-power width
    expected = lab.chirped(SLOW, frequency, speed, axis)
    instrument = lab.Instrument()
    moving = bench(SLOW, instrument, sweep_rate=FiniteSweepRate(2 * np.pi * speed))
    predict = eqx.filter_jit(sweep(frequency, axis).predict)
    predicted = predict(moving) / (SLOW.mass * instrument.gain)
    np.testing.assert_allclose(predicted, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())
    settled = predict(bench(SLOW, instrument)) / (SLOW.mass * instrument.gain)
    assert np.abs(settled - expected).max() > 0.2 * np.abs(expected).max(), "the sweep of this test must be fast"


@pytest.mark.parametrize(
    "effect", [{"sweep_rate": FiniteSweepRate(0.0)}, {"feedthrough": LeakPhasors(jnp.zeros((2, 2)))}]
)
def test_an_effect_of_zero_strength_is_exactly_absent(effect):
    plain = sweep(lab.WIDE).predict(bench(lab.Gyro(), lab.Instrument()))
    np.testing.assert_array_equal(sweep(lab.WIDE).predict(bench(lab.Gyro(), lab.Instrument(), **effect)), plain)


@jax.jit
def with_slope(speed):
    """The prediction at a sweep speed and its derivative by it: one program for both."""
    narrow = sweep(np.linspace(55, 69, 41))

    def at(value):
        return narrow.predict(bench(SLOW, lab.Instrument(gain=1.0), sweep_rate=FiniteSweepRate(value)))

    return jax.jvp(at, (speed,), (jnp.ones(()),))


@pytest.mark.parametrize("speed", [0.0, 1e-6, 0.01, 1.0, 30.0])
def test_derivative_by_sweep_speed_agrees_with_differences(speed):
    slope = with_slope(speed)[1]
    step = max(1e-4 * speed, 1e-5)
    low = max(speed - step, 0.0)
    difference = (with_slope(speed + step)[0] - with_slope(low)[0]) / (speed + step - low)
    np.testing.assert_allclose(slope, difference, atol=2e-4 * float(jnp.abs(slope).max()))


def test_conditions_have_one_entry_per_row():
    conditions = sweep(lab.WIDE, rate=2.0).conditions()
    assert all(len(values) == len(lab.WIDE) for values in conditions.values())
    assert float(conditions["rate [rad/s]"][5]) == 2.0


def test_cartesian_noise_counts_both_parts():
    from memsgyro_jax.measurement.experiments import CartesianNoise

    white = CartesianNoise(0.5).whiten(jnp.array([[1 + 2j]]), jnp.array([[0j]]))
    np.testing.assert_allclose(white, [[[2.0, 4.0]]])


def test_polar_noise_wraps_the_phase():
    white = PolarNoise(0.1, 0.01).whiten(jnp.exp(1j * jnp.array([3.1])), jnp.exp(1j * jnp.array([-3.1])))
    np.testing.assert_allclose(white[0], [0.0, (6.2 - 2 * np.pi) / 0.01], atol=1e-9)
