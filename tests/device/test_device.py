"""Equations of motion against their matrices written out, the coefficient table, mode frequencies, and bad input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import kalman, motion

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import DUAL_MASS, SINGLE_MASS, DualMassGyro, Inertial, SingleMassGyro, mode_frequencies
from memsgyro_jax.device.normalised import NormalisedDevice


SINGLE = {"mass": 1.8e-7, "kxx": 63.96, "kyy": 95.92, "kxy": 12.78, "dxx": 3.6e-6, "dyy": 4.5e-6, "dxy": 3.6e-7}
DUAL = {
    "mass_x": 2.6e-7, "mass_y": 1.6e-7, "kxx": 92.38, "kyy": 85.26, "kxy": 0.92, "kyx": 0.25, "dxx": 5.2e-6,
    "dyy": 4.8e-6,
}  # fmt: skip
FRAMES = st.builds(
    motion.Frame,
    **{name: st.floats(-100.0, 100.0) for name in ("wx", "wy", "wz", "ax", "ay")},
    spin=st.floats(-1e4, 1e4),
    damping=st.tuples(*[st.floats(-0.9, 4.0)] * 3),
)


def state_matrix(dynamics):
    """(A, B, c) of a `Dynamics`, as the oracle has them."""
    a = np.zeros((4, 4))
    a[0, 2] = a[1, 3] = 1.0
    a[2:, :2], a[2:, 2:] = -np.array(dynamics.stiffness, float), -np.array(dynamics.velocity, float)
    b = np.zeros((4, 2))
    b[2, 0], b[3, 1] = dynamics.gain
    return a, b, np.array([0.0, 0.0, *dynamics.bias])


def inertial(f):
    return Inertial(f.wz, f.spin, (f.wx, f.wy), (f.ax, f.ay), f.damping)


@pytest.mark.parametrize("full", [False, True], ids=["simplified", "all terms of (2.4)"])
@given(frame=FRAMES)
def test_single_mass_equations(full, frame):
    gyro = SingleMassGyro(**SINGLE, dyx=4e-7, rotating_frame=full)
    want = motion.single_mass(*SINGLE.values(), dyx=4e-7, frame=frame, full=full)
    for ours, theirs in zip(state_matrix(gyro.dynamics(inertial(frame))), want, strict=True):
        assert np.allclose(ours, theirs.astype(float), rtol=1e-13, atol=1e-12)


@pytest.mark.parametrize("full", [False, True], ids=["simplified", "all terms of (2.4)"])
@given(frame=FRAMES)
def test_dual_mass_equations(full, frame):
    gyro = DualMassGyro(**DUAL, rotating_frame=full)
    want = motion.dual_mass(*DUAL.values(), frame=frame, full=full)
    for ours, theirs in zip(state_matrix(gyro.dynamics(inertial(frame))), want, strict=True):
        assert np.allclose(ours, theirs.astype(float), rtol=1e-13, atol=1e-12)


def test_a_resting_frame_is_the_simplified_equation():
    for kind, numbers in ((SingleMassGyro, SINGLE), (DualMassGyro, DUAL)):
        plain, full = (kind(**numbers, rotating_frame=flag).dynamics(Inertial()) for flag in (False, True))
        for a, b in zip(state_matrix(plain), state_matrix(full), strict=True):
            assert np.array_equal(a, b)


@pytest.mark.parametrize(
    ("model", "table", "gyro"),
    [(SINGLE_MASS, kalman.SINGLE, SingleMassGyro(**SINGLE)), (DUAL_MASS, kalman.DUAL, DualMassGyro(**DUAL))],
    ids=["single", "dual"],
)
@pytest.mark.parametrize("rate", [0.0, -3.0])
def test_coefficients_assemble_to_the_dynamics(model, table, gyro, rate):
    """The table an observer reads, filled with the device's coefficients, is the device; and it is linear."""
    theta = gyro.coefficients(rate)
    ours, want = state_matrix(model.assemble(theta)), state_matrix(gyro.dynamics(Inertial(rate)))
    for a, b in zip(ours, want, strict=True):
        assert np.allclose(a, b, rtol=1e-14, atol=0.0)
    rng = np.random.default_rng(0)
    values, signals = rng.standard_normal(len(model.names)), rng.standard_normal(6)
    a, b, _ = state_matrix(model.assemble(tuple(values)))
    by_table = kalman.influence(table, signals) @ values
    assert np.allclose(a[2:] @ signals[:4] + b[2:] @ signals[4:], by_table, rtol=1e-13)


def test_rate_and_damping_are_kept_apart():
    """A controller that cancels damping must leave the Coriolis force alone."""
    dynamics = SINGLE_MASS.assemble((5.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 1.0))
    assert np.array_equal(np.array(dynamics.damping), [[1.0, 3.0], [3.0, 2.0]])
    assert np.array_equal(np.array(dynamics.coriolis), [[0.0, -10.0], [10.0, 0.0]])
    assert np.array_equal(np.array(dynamics.velocity), [[1.0, -7.0], [13.0, 2.0]])


def test_unequal_cross_damping_is_a_rate():
    """Thesis 4.1.2: dyx - dxy acts as a rate of (dyx - dxy)/(4 mass); 3.6e-9 and 3.96e-9 N·s/m are 0.02865 °/s."""
    uneven = SingleMassGyro(**SINGLE | {"dxy": 3.6e-9}, dyx=3.96e-9)
    bias = (3.96e-9 - 3.6e-9) / (4 * SINGLE["mass"])
    assert np.rad2deg(bias) == pytest.approx(0.02865, rel=1e-3)
    as_rate = SINGLE_MASS.assemble(uneven.coefficients(bias))
    assert np.allclose(np.array(as_rate.velocity), np.array(uneven.dynamics(Inertial()).velocity), rtol=1e-12)
    assert float(uneven.coefficients(0.0)[6]) == pytest.approx(3.78e-9 / 1.8e-7, rel=1e-14)


def test_damping_change_is_relative():
    gyro = SingleMassGyro(**SINGLE, dyx=5e-7)
    before, after = (gyro.dynamics(Inertial(damping_change=change)).damping for change in ((0,) * 3, (0.5, 0.4, 4.0)))
    assert np.allclose(np.array(after) / np.array(before), [[1.5, 5.0], [5.0, 1.4]], rtol=1e-14)


def test_design_values_and_modes_of_the_thesis():
    """2.893 and 3.758 kHz, Q 942 and 919 (thesis 5.1)."""
    gyro = SingleMassGyro.chi2010()
    assert {name: float(getattr(gyro, name)) for name in SINGLE} == pytest.approx(SINGLE, rel=1e-15)
    assert mode_frequencies(gyro) == pytest.approx([2893.0, 3758.0], abs=1.0)
    q = [float(np.sqrt(k * gyro.mass) / d) for k, d in ((gyro.kxx, gyro.dxx), (gyro.kyy, gyro.dyy))]
    assert q == pytest.approx([942.0, 919.0], rel=0.005)
    dual = DualMassGyro.chi2010()
    assert {name: float(getattr(dual, name)) for name in DUAL} == pytest.approx(DUAL, rel=1e-15)


@pytest.mark.parametrize("gyro", [SingleMassGyro(**SINGLE), DualMassGyro(**DUAL)], ids=["single", "dual"])
def test_mode_frequencies_are_eigenvalues(gyro):
    values = np.sort(np.sqrt(np.linalg.eigvals(np.array(gyro.dynamics(Inertial()).stiffness)))) / (2 * np.pi)
    assert mode_frequencies(gyro) == pytest.approx(values, rel=1e-13)


def test_mode_frequencies_of_many_dies():
    gyro = SingleMassGyro(**SINGLE | {"kxx": jnp.array([63.96, 70.0, 50.0])})
    frequencies = mode_frequencies(gyro)
    assert frequencies.shape == (3, 2)
    assert frequencies[1] == pytest.approx(mode_frequencies(SingleMassGyro(**SINGLE | {"kxx": 70.0})), rel=1e-14)


def test_devices_are_frozen_trees_of_arrays():
    gyro = SingleMassGyro(**SINGLE)
    assert len(jax.tree.leaves(gyro)) == 8
    assert all(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(gyro))
    with pytest.raises(AttributeError):
        gyro.mass = 1.0


BAD = [
    (SingleMassGyro, SINGLE, {"mass": 0.0}, "`mass` must be positive and finite, but 0 was given"),
    (SingleMassGyro, SINGLE, {"mass": -1.8e-7}, "`mass` must be positive and finite, but -1.8e-07"),
    (SingleMassGyro, SINGLE, {"mass": float("nan")}, "`mass` must be positive and finite, but nan"),
    (SingleMassGyro, SINGLE, {"mass": float("inf")}, "`mass` must be positive and finite, but inf"),
    (SingleMassGyro, SINGLE, {"kxx": float("inf")}, "stiffness matrix must be positive definite .* xx = inf"),
    (SingleMassGyro, SINGLE, {"mass": jnp.array([1e-7, -2e-7])}, "`mass` must be positive and finite, but -2e-07"),
    (SingleMassGyro, SINGLE, {"kxy": 90.0}, "stiffness matrix must be positive definite .* lower the coupling"),
    (SingleMassGyro, SINGLE, {"kxx": -63.96}, "stiffness matrix must be positive definite"),
    (SingleMassGyro, SINGLE, {"kyy": float("nan")}, "stiffness matrix must be positive definite"),
    (SingleMassGyro, SINGLE, {"dxy": 1e-5}, "damping matrix must be positive definite"),
    (SingleMassGyro, SINGLE, {"dyx": 1e-4}, "damping matrix must be positive definite"),
    (DualMassGyro, DUAL, {"mass_y": -1e-7}, "`mass_y` must be positive"),
    (DualMassGyro, DUAL, {"mass_x": 1e-7}, "mass_x - mass_y"),
    (DualMassGyro, DUAL, {"kxx": 0.0}, "`kxx` must be positive"),
    (DualMassGyro, DUAL, {"kyy": -1.0}, "`kyy` must be positive"),
    (DualMassGyro, DUAL, {"kxy": 100.0, "kyx": 100.0}, r"kxx\*kyy - kxy\*kyx"),
    (DualMassGyro, DUAL, {"dxx": 0.0}, "`dxx` must be positive"),
    (DualMassGyro, DUAL, {"dyy": -1.0}, "`dyy` must be positive"),
]


@pytest.mark.parametrize(("kind", "numbers", "change", "words"), BAD, ids=[f"{k.__name__} {c}" for k, _, c, _ in BAD])
def test_impossible_devices_are_refused(kind, numbers, change, words):
    with pytest.raises(InputError, match=words):
        kind(**numbers | change)


def test_an_unknown_coefficient_is_named():
    with pytest.raises(InputError, match=r"must be one of rate, kxx.* but `mass` was given"):
        SINGLE_MASS.index("mass")


@pytest.mark.parametrize("gyro", [SingleMassGyro(**SINGLE), DualMassGyro(**DUAL)], ids=["single", "dual"])
def test_coefficients_follow_a_change_of_damping(gyro):
    """The table assembles to the same equations of motion as the device has under the change."""
    change = (0.5, -0.2, 0.3)
    true = gyro.dynamics(Inertial(rate=1.5, damping_change=change))
    found = gyro.model.assemble(gyro.coefficients(1.5, change))
    np.testing.assert_allclose(found.damping, true.damping, rtol=1e-14)
    assert gyro.coefficients(1.5, (0.0, 0.0, 0.0)) == gyro.coefficients(1.5)


def test_a_device_per_mass_has_its_matrices():
    gyro = SingleMassGyro.from_modes(3e-9, (9.4e3, 9.75e3), (2500.0, 4000.0), angle=0.2, cross_damping=-0.1)
    bare, (mass, kxx, kyy, kxy, dxx, dyy, dxy) = NormalisedDevice.of(gyro), jax.tree.leaves(gyro)[:7]
    np.testing.assert_allclose(bare.stiffness_matrix * mass, [[kxx, kxy], [kxy, kyy]], rtol=1e-14)
    np.testing.assert_allclose(bare.damping_matrix * mass, [[dxx, dxy], [dxy, dyy]], rtol=1e-14)
    np.testing.assert_allclose(bare.resonances(), 2.0 * np.pi * np.array([9.4e3, 9.75e3]), rtol=1e-12)
