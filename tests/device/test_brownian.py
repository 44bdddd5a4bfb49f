"""The Brownian force of a damping matrix: its covariance over a sample, drawn numbers, and k T/2 for every mode."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_lyapunov

import memsgyro_jax as mg
from memsgyro_jax.device.brownian import BOLTZMANN, correlated, thermal_acceleration
from memsgyro_jax.device.gyro import Inertial
from memsgyro_jax.device.propagate import Exact, ForwardEuler
from memsgyro_jax.device.sizes import numbers_of


DEVICES = {
    "coupled": mg.SingleMassGyro.chi2010(),
    "two masses": mg.DualMassGyro.chi2010(),
    "matched, strong cross damping": mg.SingleMassGyro.from_modes(2e-9, (14e3, 14e3), (300.0, 20e3), cross_damping=0.9),
}


def matrix(rows):
    return np.array([[float(entry) for entry in row] for row in rows])


def system(device, temperature):
    """(A, B S Bᵀ) by plain NumPy: forces 2 k T D on masses M."""
    rest = device.dynamics(Inertial())
    stiffness, damping, inverse = matrix(rest.stiffness), matrix(rest.damping), np.diag(np.array(rest.gain, float))
    force = 2.0 * 1.380649e-23 * temperature * np.linalg.inv(inverse) @ damping
    a, b = np.zeros((4, 4)), np.zeros((4, 4))
    a[:2, 2:], a[2:, :2], a[2:, 2:] = np.eye(2), -stiffness, -damping
    b[2:, 2:] = inverse @ (0.5 * (force + force.T)) @ inverse
    return a, b


def van_loan(a, b, h):
    """∫ exp(A s) B exp(Aᵀ s) ds over h, by one exponential (Van Loan, 1978), with time in natural units."""
    omega = np.sqrt(np.max(np.abs(a[2:, :2])))
    unit = np.diag([omega, omega, 1.0, 1.0])
    a, b, size = unit @ a @ np.linalg.inv(unit), unit @ b @ unit, np.max(b)
    whole = expm(h * np.block([[-a, b / size], [np.zeros((4, 4)), a.T]]))
    found = size * whole[4:, 4:].T @ whole[:4, 4:]
    return np.linalg.inv(unit) @ found @ np.linalg.inv(unit)


@pytest.mark.parametrize("name", DEVICES)
@pytest.mark.parametrize("samples", [2.5, 27.0, 1000.0])
def test_covariance_of_a_sample(name, samples):
    """Of the higher mode's period, from next to nothing to a thousand samples."""
    device = DEVICES[name]
    highest = float(mg.mode_frequencies(device)[-1])
    rest, rate = device.dynamics(Inertial()), samples * highest
    density = thermal_acceleration(rest.damping, rest.gain, 300.0)
    found = Exact.covering(highest, rate).white(rest.stiffness, rest.damping, density, 1.0 / rate)
    expected = van_loan(*system(device, 300.0), 1.0 / rate)
    std = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(matrix(found) / np.outer(std, std), expected / np.outer(std, std), atol=1e-10)
    root = np.stack([np.array(correlated(found, tuple(unit)), float) for unit in np.eye(4)], axis=1)
    np.testing.assert_allclose(root @ root.T / np.outer(std, std), expected / np.outer(std, std), atol=1e-10)


@pytest.mark.parametrize("name", ["coupled", "matched, strong cross damping"])
def test_every_mode_holds_half_k_t(name):
    """What samples gather, and damping takes, ends at k T/2 in each displacement and velocity, at any sample rate."""
    device = DEVICES[name]
    rest, rate = device.dynamics(Inertial()), 3.3 * float(mg.mode_frequencies(device)[-1])
    density = thermal_acceleration(rest.damping, rest.gain, 250.0)
    held = matrix(Exact.covering(rate / 3.3, rate).white(rest.stiffness, rest.damping, density, 1.0 / rate))
    scale = np.sqrt(1.380649e-23 * 250.0 * np.array(rest.gain, float)[[0, 1, 0, 1]])
    scale[:2] /= np.sqrt(matrix(rest.stiffness)[0, 0])
    step = expm(system(device, 250.0)[0] / rate) / scale[:, None] * scale
    steady = solve_discrete_lyapunov(step, held / np.outer(scale, scale)) * np.outer(scale, scale)
    mass = np.diag(1.0 / np.array(rest.gain, float))
    for energy in (mass @ matrix(rest.stiffness) @ steady[:2, :2], mass @ steady[2:, 2:]):
        np.testing.assert_allclose(energy / (1.380649e-23 * 250.0), np.eye(2), atol=1e-6)


def test_none_without_temperature_and_none_at_zero():
    plain = mg.SingleMassGyro.chi2010()
    assert plain.temperature is None
    assert plain.at_temperature(300.0).at_temperature(None) == plain
    assert numbers_of(plain.at_temperature(300.0)) == numbers_of(plain)
    rest = plain.dynamics(Inertial())

    def moved(temperature):
        density = thermal_acceleration(rest.damping, rest.gain, temperature)
        return jnp.stack(correlated(Exact().white(rest.stiffness, rest.damping, density, 1e-5), (1.0, -1.0, 2.0, 0.5)))

    assert np.all(np.asarray(moved(0.0)) == 0.0)
    slope = jax.jacfwd(moved)
    assert np.all(np.isfinite(slope(0.0)))
    np.testing.assert_allclose(slope(300.0), moved(300.0) / 600.0, rtol=1e-12)
    with pytest.raises(mg.InputError, match="temperature"):
        plain.at_temperature(-1.0)


def test_a_step_of_euler_puts_it_all_into_the_velocities():
    rest = mg.SingleMassGyro.chi2010().dynamics(Inertial())
    density = thermal_acceleration(rest.damping, rest.gain, 300.0)
    found = matrix(ForwardEuler().white(rest.stiffness, rest.damping, density, 1e-7))
    assert np.all(found[:2] == 0.0)
    np.testing.assert_allclose(
        found[2:, 2:], 1e-7 * 2.0 * BOLTZMANN * 300.0 * matrix(rest.damping) / 1.8e-7, rtol=1e-12
    )
    assert correlated(found.tolist(), (1.0, 1.0, 1.0, 1.0))[0] == 0.0


def test_a_device_by_its_modes_may_know_its_temperature():
    by_modes = {"frequency": ("17.6 kHz", "18.05 kHz"), "quality_factor": (6000, 1500)}
    warm = mg.SingleMassGyro.from_modes("9 ug", **by_modes, temperature="27 degC")
    assert float(warm.temperature) == pytest.approx(300.15)
    assert float(mg.DualMassGyro.from_modes("9 ug", "5 ug", **by_modes, temperature=250.0).temperature) == 250.0
    assert mg.SingleMassGyro.from_modes("9 ug", **by_modes).temperature is None
