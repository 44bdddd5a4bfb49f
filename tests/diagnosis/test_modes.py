"""Resonance and quality factor of a fit, beside what error propagation by hand gives."""

import numpy as np
import pytest

from memsgyro_jax.diagnosis.modes import coupling_estimates, mode_estimates
from memsgyro_jax.diagnosis.optimum import Optimum


def optimum(vector, std):
    """A fit whose first numbers, as many as `std` has, are known that well, each for itself."""
    free = np.arange(len(std))
    return Optimum(np.asarray(vector), free, np.zeros(len(std)), np.diag(1.0 / np.asarray(std)), np.zeros(0), True, 1)


def test_one_axis():
    w, q = 2 * np.pi * 1.04e6, 8200.0
    f0, quality = mode_estimates(optimum([w**2, w / q, 1.0, 0.0], [1e-7 * w**2, 1e-4 * w / q]), 1)
    assert (f0.name, f0.unit, quality.name) == ("resonance frequency", "Hz", "quality factor")
    np.testing.assert_allclose([f0.value, f0.std], [1.04e6, 0.5e-7 * 1.04e6], rtol=1e-6)
    np.testing.assert_allclose([quality.value, quality.std], [q, q * np.hypot(1e-4, 0.5e-7)], rtol=1e-6)


def test_two_axes_whose_coupling_turns_the_modes():
    """The lower of two modes 1 % apart: f falls by the mean square of the coupling, to first order not at all."""
    w = 2 * np.pi * np.array([8000.0, 8080.0])
    vector = [*w**2, 0.0, *(w / [900.0, 700.0]), 0.0, 1.0, 0.0, 0.0]
    low, high, *quality = mode_estimates(optimum(vector, [1e-6 * w[0] ** 2, 1e-5 * w[1] ** 2, 1e-4 * w[0] ** 2]), 2)
    np.testing.assert_allclose([low.value, high.value], [8000.0, 8080.0])
    np.testing.assert_allclose([low.std, high.std], [0.004, 0.0404], rtol=1e-3)
    np.testing.assert_allclose([one.value for one in quality], [900.0, 700.0])
    assert [low.name, high.name] == ["lower undamped frequency", "upper undamped frequency"]
    assert [one.name for one in quality] == ["lower mode quality factor", "upper mode quality factor"]


def test_what_couples_two_axes_is_told_over_the_mass():
    """Of one that the fit did not move, there is no standard deviation."""
    vector = [5e8, 6e8, 3e6, 20.0, 30.0, -4.0, 1.0, 0.0, 0.0]
    stiffness, damping = coupling_estimates(optimum(vector, [1e3, 2e3, 3e3]), 2)
    assert (stiffness.name, stiffness.value, stiffness.std, stiffness.unit) == (
        "kxy/m",
        3e6,
        pytest.approx(3e3),
        "rad²/s²",
    )
    assert (damping.name, damping.value, damping.unit) == ("dxy/m", -4.0, "1/s")
    assert np.isnan(damping.std)
    assert coupling_estimates(optimum([1e8, 20.0, 1.0, 0.0], [1.0, 1.0]), 1) == ()


def test_what_is_not_held_is_said():
    loose = Optimum(
        np.array([1e8, 20.0, 1.0, 0.0]), np.arange(2), np.zeros(2), np.diag([1.0, 0.0]), np.zeros(0), True, 1
    )
    assert all(np.isinf(one.std) for one in mode_estimates(loose, 1))


def test_an_unstable_fit_has_no_frequency():
    assert mode_estimates(optimum([-1.0, 20.0, 1.0, 0.0], [1e-3, 1e-3]), 1)[0].value == pytest.approx(0.0)


@pytest.mark.parametrize("share", [3.0, 1e3, 4e5])
def test_a_damping_known_to_far_more_than_its_size_bounds_the_quality_factor(share):
    """From 12 rows beside a resonance a fit had no damping to speak of, and read 6.97e5 ± 1.9e5: the difference of
    quality factors went through none.
    """
    w, q = 22.8, 7e5
    quality = mode_estimates(optimum([w**2, w / q, 1.0, 0.0], [1e-7 * w**2, share * w / q]), 1)[1]
    assert np.isinf(quality.std)
    assert quality.above == pytest.approx(q / (1.0 + 1.645 * share), rel=1e-3)
