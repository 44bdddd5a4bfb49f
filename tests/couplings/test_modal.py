"""Modes, couplings and the paper's estimators against plain linear algebra."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lab import two_modes as lab

from memsgyro_jax.couplings.modal import SingleMode, circle, coupled_poles, half_power, partial_fractions
from memsgyro_jax.couplings.modes import AxisAngles, CoupledModes, drive_errors, mirrored, sense_errors
from memsgyro_jax.couplings.ratio import (
    ComplexRatio,
    ExactRatio,
    TruncatedRatio,
    conversion_ratio,
    goodness_of_fit,
    low_pass,
    peak_to_peak,
    phase_offset,
    relative_error,
)


def modes(gyro):
    damping = gyro.matrices()[1]
    return CoupledModes.from_coefficients(gyro.mass, gyro.matrices()[2], damping, gyro.lam_yx, gyro.lam_xy)


REFERENCE = modes(lab.Gyro())
NARROW = jnp.asarray(2 * np.pi * lab.NARROW)


@pytest.mark.parametrize("gyro", [lab.Gyro(), lab.Gyro(fy=8014.31, cxy=2e-8), lab.Gyro(fx=100.0, fy=130.0, qx=5, qy=8)])
@pytest.mark.parametrize("rate", [0.0, 2.0])
def test_poles_are_eigenvalues(gyro, rate):
    mass, damping, stiffness, _ = lab.replace(gyro, rate=rate).matrices()
    inverse = np.linalg.inv(mass)
    system = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ stiffness, -inverse @ damping]])
    eigenvalues = np.linalg.eigvals(system)
    expected = np.sort_complex(eigenvalues[eigenvalues.imag > 0])
    found = np.sort_complex(np.asarray(coupled_poles(modes(gyro), rate)))
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_partial_fractions_add_up_to_the_response():
    fractions = partial_fractions(REFERENCE, 1, 0.5)
    total = (fractions.residues / (1j * NARROW[:, None, None] - fractions.poles[:, None])).sum(axis=1)
    np.testing.assert_allclose(total, REFERENCE.response(NARROW, 1, 0.5), rtol=1e-8)


def test_poles_are_differentiable():
    def pole(stiffness):
        return coupled_poles(CoupledModes(REFERENCE.omega, REFERENCE.quality, REFERENCE.damping_coupling, stiffness))

    here = REFERENCE.stiffness_coupling
    _, slope = jax.jvp(pole, (here,), (jnp.ones_like(here),))
    step = 1e-3 * here
    np.testing.assert_allclose(slope, (pole(here + step) - pole(here - step)) / (2 * step), rtol=1e-4)


def test_a_lone_mode_is_found_by_both_ways():
    frequency = jnp.asarray(2 * np.pi * np.linspace(7990, 8030, 4001))
    lone = CoupledModes(REFERENCE.omega, [2000.0, 1500.0])
    response = lone.response(frequency, 0)[:, 0]
    peak = half_power(frequency, jnp.abs(response))
    assert float(peak.omega) == pytest.approx(float(lone.omega[0]), rel=1e-6)
    assert float(peak.quality) == pytest.approx(2000.0, rel=2e-3)
    exact = circle(frequency, response)
    assert float(exact.omega) == pytest.approx(float(lone.omega[0]), rel=1e-8)
    assert float(exact.quality) == pytest.approx(2000.0, rel=1e-4)
    assert float(SingleMode.of_pole(coupled_poles(lone)[0]).quality) == pytest.approx(2000.0, rel=1e-9)


def test_no_half_power_point_is_nan():
    frequency = jnp.asarray(2 * np.pi * np.linspace(8014.3, 8020.0, 500))
    assert np.isnan(float(half_power(frequency, jnp.abs(REFERENCE.response(frequency, 0)[:, 0])).quality))


def test_coupled_poles_lie_where_the_findings_put_them():
    """14 mHz and 1 % of Q away from the values the formulas need."""
    pole = coupled_poles(REFERENCE)[0]
    assert float(pole.imag / 2 / np.pi) - 8014.3 == pytest.approx(-0.014, abs=0.001)
    assert float(SingleMode.of_pole(pole).quality) / 45_000 - 1 == pytest.approx(-0.0106, abs=0.0005)


def test_published_errors_at_the_identified_point():
    """Table 6 of the paper: 0.542 ppm, 6.09 %, 0.205 ppm; the reference device gives 0.56 ppm, 6.09 %, 0.205 ppm."""
    error = np.abs(relative_error(TruncatedRatio(), REFERENCE, NARROW))
    np.testing.assert_allclose(error, [0.563e-6, 0.0609, 0.205e-6], rtol=0.02)


@pytest.mark.parametrize(
    ("noise", "low", "high"), [(lab.RAW, 11.42 / 1.3, 11.42 * 1.3), (lab.FILTERED, 0.087 / 1.3, 0.087 * 1.3)]
)
def test_published_noise_errors(noise, low, high):
    """> 1000 % before and about 9 % after the low-pass."""
    rng = np.random.default_rng(3)
    clean = np.asarray(REFERENCE.response(NARROW, 0))
    draws = jnp.stack([(lambda z: z[:, 1] / z[:, 0])(lab.noisy(clean, *noise, rng)) for _ in range(300)])
    error = jax.vmap(lambda ratio: relative_error(TruncatedRatio(), REFERENCE, NARROW, ratio)[1])(draws)
    assert low < float(jnp.sqrt(jnp.mean(error**2))) < high


@pytest.mark.slow
@given(
    force=st.floats(-0.5, 0.5),
    damping=st.floats(-1.0, 1.0),
    stiffness=st.floats(-0.02, 0.02),
    quality=st.floats(100.0, 1e5),
)
def test_the_exact_ratio_returns_noise_free_coefficients(force, damping, stiffness, quality):
    omega = REFERENCE.omega
    made = CoupledModes(omega, [quality, 0.7 * quality], damping * omega[0] / quality, stiffness * omega[0] ** 2, force)
    response = made.response(NARROW, 0)
    found = ExactRatio()(NARROW, response[:, 1] / response[:, 0], made)
    scale = np.array([1.0, float(omega[0] / quality), float(omega[0] ** 2)])
    expected = [float(made.force_yx), float(made.damping_coupling), float(made.stiffness_coupling)]
    # η is carried by the imaginary part alone, behind α: its absolute accuracy follows the larger of the two.
    size = scale * np.array([1.0, 1.0, 1.0]) + np.array([0.0, abs(stiffness) * float(omega[0]), 0.0])
    np.testing.assert_allclose(np.asarray(found.values()) / size, expected / size, atol=1e-9)


def test_the_mirrored_experiment_gives_the_other_force_coupling():
    response = REFERENCE.response(NARROW, 1)
    found = ExactRatio()(NARROW, response[:, 0] / response[:, 1], mirrored(REFERENCE))
    assert float(found.force) == pytest.approx(lab.Gyro().lam_xy, rel=1e-9)


def test_the_deviations_of_a_ratio_are_those_of_least_squares():
    """Few rows: the numbers that were found count among the degrees of freedom."""
    frequency = NARROW[:: len(NARROW) // 4][:4]
    response = np.asarray(REFERENCE.response(frequency, 0))
    ratio = response[:, 1] / response[:, 0] * (1 + 1e-3 * np.array([1.0, -2.0, 0.5j, 1.0 - 1.0j]))
    found = ComplexRatio()(frequency, ratio, REFERENCE)
    dx, dy, *_ = (np.asarray(part) for part in REFERENCE.dynamic_stiffness(frequency))
    columns = np.stack([dx / dy, -1j * np.asarray(frequency) / dy, -1 / dy], axis=1)
    columns, wanted = np.concatenate([columns.real, columns.imag]), np.concatenate([ratio.real, ratio.imag])
    size = np.linalg.norm(columns, axis=0)
    values, rest, *_ = np.linalg.lstsq(columns / size, wanted)
    std = np.sqrt(np.diag(np.linalg.inv((columns / size).T @ (columns / size))) * rest[0] / (8 - 3)) / size
    np.testing.assert_allclose(np.asarray(found.values()), values / size, rtol=1e-6)
    np.testing.assert_allclose(np.asarray(found.std), std, rtol=1e-6)


def test_the_complex_ratio_keeps_the_truncation():
    error = np.abs(relative_error(ComplexRatio(), REFERENCE, NARROW))
    assert 1e-6 < error[0] < 0.01
    assert error[1] < 1e-4


def test_corrections_recover_gain_ratio_and_phase_without_coupling():
    frequency = jnp.asarray(2 * np.pi * np.linspace(8000, 8050, 8001))
    lone = CoupledModes(REFERENCE.omega, [4000.0, 3000.0])
    channels = jnp.array([np.exp(0.3j), 1.7 * np.exp(0.5j)])
    x, y = lone.response(frequency, 0) * channels, lone.response(frequency, 1) * channels
    assert float(conversion_ratio(x, y, lone)) == pytest.approx(1.7, rel=1e-4)
    assert float(phase_offset(frequency, x[:, 0], lone.omega[0])) == pytest.approx(0.3, abs=1e-3)
    assert float(phase_offset(frequency, y[:, 1], lone.omega[1])) == pytest.approx(0.5, abs=1e-3)


def test_goodness_of_fit_is_one_for_a_perfect_and_zero_for_no_curve():
    curve = jnp.linspace(1.0, 2.0, 11)
    assert float(goodness_of_fit(curve, curve)) == 1.0
    assert float(goodness_of_fit(curve, 0 * curve)) == 0.0


def test_peak_to_peak_and_low_pass_of_a_record():
    rng = np.random.default_rng(0)
    record = 5.0 + 0.1 * rng.uniform(-0.5, 0.5, 4000)
    amplitude, _ = peak_to_peak(record, record)
    assert float(amplitude) == pytest.approx(0.02, rel=0.01)
    smooth = low_pass(record, 0.002, 1.0)
    assert np.ptp(smooth[500:-500]) < 0.2 * np.ptp(record)
    assert smooth.mean() == pytest.approx(5.0, abs=1e-3)


def test_damping_is_in_phase_and_stiffness_in_quadrature_with_coriolis():
    errors = sense_errors(REFERENCE, REFERENCE.omega[0], 1e-6, 0.02).relative()
    assert float(abs(errors["damping"].imag)) < 1e-12 * float(abs(errors["damping"].real))
    assert float(errors["damping"].real) == pytest.approx(float(REFERENCE.damping_coupling) / 0.04, rel=1e-9)
    assert float(abs(errors["stiffness"].real)) < 1e-12 * float(abs(errors["stiffness"].imag))
    # at the drive resonance the electrode force is in phase with velocity, and so with Coriolis
    assert float(abs(errors["force"].imag)) < 1e-9 * float(abs(errors["force"].real))


def test_small_errors_add_up_to_the_true_sense_motion():
    small = lab.Gyro(cxy=-7e-12, kxy=1e-6, lam_yx=-3e-7, rate=0.01)
    device, frequency = modes(lab.replace(small, rate=0.0)), 2 * np.pi * 8014.2
    motion = lab.steady(small, [8014.2])[0]
    errors = sense_errors(device, frequency, motion[0], small.rate)
    total = errors.coriolis + errors.damping + errors.stiffness + errors.force
    assert complex(total) == pytest.approx(complex(motion[1]), rel=1e-4)
    wave = errors.in_time(jnp.array([0.0, 1e-5]), frequency)
    assert float(wave["coriolis"][0, 0]) == pytest.approx(float(errors.coriolis.real))


def test_the_drive_axis_is_the_mirror_image():
    mirror = sense_errors(mirrored(REFERENCE), REFERENCE.omega[1], 1e-6, -0.02)
    own = drive_errors(REFERENCE, REFERENCE.omega[1], 1e-6, 0.02)
    assert complex(own.coriolis) == complex(mirror.coriolis)
    assert complex(own.force) == complex(mirror.force)


@given(*(st.floats(-0.7, 0.7) for _ in range(4)))
def test_angles_and_coefficients_are_one_to_one(stiffness, damping, drive, sense):
    made = AxisAngles(stiffness, damping, drive, sense).modes(1e-6, (120.0, 90.0), (3e-6, 2e-6))
    back = AxisAngles.of(made)
    np.testing.assert_allclose(
        [back.stiffness, back.damping, back.drive, back.sense], [stiffness, damping, drive, sense], atol=1e-9
    )


def test_a_turned_stiffness_axis_couples_with_half_the_difference():
    made = AxisAngles(stiffness=np.radians(45.0)).modes(1.0, (120.0, 90.0), (1.0, 1.0))
    assert float(made.stiffness_coupling) == pytest.approx(15.0)
    assert float(made.damping_coupling) == pytest.approx(0.0, abs=1e-12)
