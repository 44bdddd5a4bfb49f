"""Devices from frequencies, quality factors and mass: the modes are those asked for, the coupling what it says."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import memsgyro_jax as mg
from memsgyro_jax.device.gyro import Inertial


def modes_of(gyro):
    """Frequencies [Hz], ascending, and quality factors, by the eigenvalues of the state matrix."""
    dynamics = gyro.dynamics(Inertial())
    stiffness, damping = np.array(dynamics.stiffness, float), np.array(dynamics.damping, float)
    state = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -damping]])
    roots = np.linalg.eigvals(state)
    roots = sorted(roots[roots.imag > 0], key=abs)
    return np.abs(roots) / (2 * np.pi), np.array([-abs(root) / (2 * root.real) for root in roots])


QUALITY, LOW = st.floats(100.0, 1e5), st.floats(2e3, 6e4)


@given(
    low=LOW, split=st.floats(5.0, 2e3), q=st.tuples(QUALITY, QUALITY), angle=st.floats(-3.0, 3.0), swap=st.booleans()
)
def test_the_modes_of_a_single_mass_are_those_asked_for(low, split, q, angle, swap):
    order = -1 if swap else 1
    gyro = mg.SingleMassGyro.from_modes(1e-8, (low, low + split)[::order], q[::order], angle=angle)
    frequency, quality = modes_of(gyro)
    np.testing.assert_allclose(mg.mode_frequencies(gyro), [low, low + split], rtol=1e-10)
    np.testing.assert_allclose(frequency, [low, low + split], rtol=1e-9)
    np.testing.assert_allclose(quality, q, rtol=1e-6)


@given(low=LOW, split=st.floats(100.0, 2e3), q=QUALITY, share=st.floats(-0.9, 0.9), ratio=st.floats(1.1, 3.0))
def test_the_modes_of_two_masses_are_those_asked_for(low, split, q, share, ratio):
    limit = np.pi * split / ratio**0.5  # nearly the most that modes so far apart couple by
    gyro = mg.DualMassGyro.from_modes(ratio * 1e-8, 1e-8, (low, low + split), q, quadrature=0.5 * share * limit)
    np.testing.assert_allclose(mg.mode_frequencies(gyro), [low, low + split], rtol=1e-10)
    assert float(gyro.kyx) == pytest.approx(2e-8 * 2 * np.pi * low * 0.5 * share * limit, rel=1e-12)
    assert float(gyro.dyy) == pytest.approx(1e-8 * 2 * np.pi * (low + split) / q, rel=1e-12)


def test_the_device_of_the_thesis_from_its_modes():
    """Its numbers come back from the eigenvectors of its stiffness, found here without the package."""
    want = mg.SingleMassGyro.chi2010()
    mass = float(want.mass)
    values, vectors = np.linalg.eigh([[want.kxx, want.kxy], [want.kxy, want.kyy]])
    damping = vectors.T @ np.array([[want.dxx, want.dxy], [want.dxy, want.dyy]]) @ vectors
    frequency = np.sqrt(values / mass) / (2 * np.pi)
    first = vectors[:, 0] * np.sign(vectors[0, 0])
    second = np.array([-first[1], first[0]])
    cross = damping[0, 1] * (second @ vectors[:, 1]) * np.sign(vectors[0, 0]) / np.sqrt(damping[0, 0] * damping[1, 1])
    made = mg.SingleMassGyro.from_modes(
        mass, tuple(frequency), tuple(np.sqrt(values * mass) / np.diag(damping)), angle=np.arctan2(first[1], first[0]),
        cross_damping=cross,
    )  # fmt: skip
    for name in ("kxx", "kyy", "kxy", "dxx", "dyy", "dxy"):
        assert float(getattr(made, name)) == pytest.approx(float(getattr(want, name)), rel=1e-10), name


def test_quadrature_is_the_rate_it_looks_like():
    """The force of kxy·x at the amplitude of x, beside that of the rate."""
    low, rate = 20e3, np.radians(300.0)
    gyro = mg.SingleMassGyro.from_modes(2e-9, (low, 21e3), 5e3, quadrature=rate)
    speed = 2 * np.pi * low  # of a displacement of 1 m
    coriolis = np.array(gyro.dynamics(Inertial(rate)).coriolis)[1, 0] * speed
    coupling = np.array(gyro.dynamics(Inertial()).stiffness)[1, 0]
    assert abs(coupling) == pytest.approx(coriolis, rel=1e-12)
    np.testing.assert_allclose(mg.mode_frequencies(gyro), [low, 21e3], rtol=1e-12)


def test_what_couples_is_differentiable():
    made = lambda angle: mg.SingleMassGyro.from_modes(2e-9, (2e4, 2.1e4), 5e3, angle=angle).kxy  # noqa: E731
    w = 2 * np.pi * np.array([2e4, 2.1e4])
    assert float(jax.grad(made)(0.0)) == pytest.approx(2e-9 * (w[0] ** 2 - w[1] ** 2), rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"frequency": (1e4, -1.0)}, "`frequency` must be positive"),
        ({"frequency": (1e4, 1.1e4, 3.0)}, "`frequency` must be a pair"),
        ({"quality_factor": 0.0}, "`quality_factor` must be positive"),
        ({"mass": 0.0}, "`mass` must be positive"),
        ({"cross_damping": 1.2}, "damping matrix must be positive definite"),
        ({"angle": 0.1, "quadrature": 1.0}, "either `angle` or `quadrature`"),
        ({"frequency": (1e4, 1.0005e4), "quadrature": 20.0}, "at most 900.2 deg/s between these frequencies, but 1146"),
    ],
)  # fmt: skip
def test_what_no_device_has_is_told(changes, words):
    usual = {"mass": 1e-9, "frequency": (1e4, 1.1e4), "quality_factor": 1e3}
    with pytest.raises(mg.InputError, match=words):
        mg.SingleMassGyro.from_modes(**usual | changes)


def test_two_masses_couple_no_more_than_their_modes_allow():
    with pytest.raises(mg.InputError, match="`quadrature` must be smaller"):
        mg.DualMassGyro.from_modes(3e-9, 2e-9, (1e4, 1.0005e4), 1e3, quadrature=200.0)


def _gyro(numbers):
    kxx, kyy, kxy = numbers
    return mg.SingleMassGyro(1.8e-7, kxx, kyy, kxy, 3.6e-6, 4.5e-6, 0.0)


def test_equal_modes_have_the_derivative_of_their_mean():
    equal = np.array([64.0, 64.0, 0.0])
    asked = lambda numbers: mg.mode_frequencies(_gyro(numbers))  # noqa: E731
    mean = asked(equal)[0] / (4.0 * 64.0)  # of each by either stiffness: f is the root of it, and the mean half of both
    for derive in (jax.jacrev, jax.jacfwd):
        np.testing.assert_allclose(derive(asked)(equal), [[mean, mean, 0.0]] * 2, rtol=1e-12)
    # What does not ask which is which has that derivative indeed.
    np.testing.assert_allclose(jax.grad(lambda n: asked(n).sum())(equal)[0], 2 * mean, rtol=1e-12)
    shift = np.array([1e-4, 0.0, 0.0])
    differences = (asked(equal + shift).sum() - asked(equal - shift).sum()) / 2e-4
    np.testing.assert_allclose(differences, 2 * mean, rtol=1e-6)


@pytest.mark.parametrize("numbers", [(64.0, 96.0, 12.8), (64.0, 64.0, 0.1), (96.0, 64.0, 0.0), (64.0, 64.001, 0.0)])
def test_modes_apart_have_their_own_derivatives(numbers):
    asked, numbers = lambda given: mg.mode_frequencies(_gyro(given)), np.array(numbers)
    step = 1e-6 * np.eye(3)
    wanted = np.stack([(asked(numbers + h) - asked(numbers - h)) / 2e-6 for h in step], axis=1)
    for derive in (jax.jacrev, jax.jacfwd):
        np.testing.assert_allclose(derive(asked)(numbers), wanted, rtol=1e-5, atol=1e-4)
