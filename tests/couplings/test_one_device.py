"""Coupled modes, bench and gyro are one device: converted both ways, and predicted alike by loop and bench."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.joint_normal import JointNormal
from memsgyro_jax.couplings.bench import Bench
from memsgyro_jax.couplings.frequency_sweep import FrequencySweep
from memsgyro_jax.couplings.modes import AxisAngles, CoupledModes
from memsgyro_jax.couplings.sense_view import SeenBench
from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.effects import CubicStiffness, ElectricalFeedthrough, FiniteSweepRate, ForceMisalignment, ReadoutDelay
from memsgyro_jax.measurement.experiments import CartesianNoise, HarmonicSweep
from memsgyro_jax.measurement.model import Model


MASS, SCALE = 2e-7, (5e5, 4e5)
MODES = CoupledModes([3.1e4, 3.2e4], [900.0, 700.0], 0.4, 2.1e6, 0.013, -0.021)


def same(a, b, rtol=1e-14):
    for mine, other in zip(eqx.filter(a, eqx.is_array).__dict__.values(), b.__dict__.values(), strict=True):
        np.testing.assert_allclose(mine, other, rtol=rtol)


def test_modes_become_a_gyro_and_come_back():
    same(CoupledModes.of(MODES.gyro(MASS)), MODES)
    gyro = mg.SingleMassGyro.chi2010().with_effect(ForceMisalignment("x", "y", 0.02), ForceMisalignment("y", "x", 0.01))
    back = CoupledModes.of(gyro).gyro(gyro.mass)
    for name in ("mass", "kxx", "kyy", "kxy", "dxx", "dyy", "dxy"):
        np.testing.assert_allclose(getattr(back, name), getattr(gyro, name), rtol=1e-14)
    assert [e.label for e in back.effects] == [e.label for e in gyro.effects]


def test_the_angles_of_a_structure_become_a_gyro():
    angles = AxisAngles(0.01, 0.02, 0.003, -0.004)
    gyro = angles.modes(MASS, (180.0, 200.0), (6e-6, 9e-6)).gyro(MASS)
    found = AxisAngles.of(CoupledModes.of(gyro))
    assert float(found.drive) == pytest.approx(0.003, rel=1e-12)
    assert float(found.sense) == pytest.approx(-0.004, rel=1e-12)
    # The diagonal orders the principal axes: the smaller one first turns them by a right angle.
    assert float(jnp.tan(2 * found.stiffness)) == pytest.approx(np.tan(0.02), rel=1e-9)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_bench_and_a_model_of_one_gyro_predict_the_same(axis):
    """Closed form of two modes beside the general model, effects and a rate included."""
    gyro = MODES.gyro(MASS).with_effect(
        ElectricalFeedthrough("x", "x", 3e3),
        ElectricalFeedthrough("x", "y", -2e3),
        ElectricalFeedthrough("y", "y", 1e3),
        ReadoutDelay(7e-6),
    )
    omega, force, rate = np.linspace(3.0e4, 3.3e4, 41), 3e-8, 2.0
    noise, none = CartesianNoise(1e-3), jnp.zeros((41, 2)) + 0j
    sweep = FrequencySweep("closed", omega, none, noise, drive=force, axis=axis, rate=rate)
    predict = eqx.filter_jit(lambda sweep, bench: sweep.predict(bench))
    general = HarmonicSweep(
        name="general",
        frequency=jnp.asarray(omega),
        force=jnp.asarray(np.outer(np.full(41, force), np.eye(2)[axis]) + 0j),
        measured=none,
        noise=noise,
        surroundings=Conditions(rate=rate).rows(41),
        near=none,
        direction=jnp.ones(41),
    )
    expected = predict(general, Model(gyro, scale=SCALE))
    np.testing.assert_allclose(predict(sweep, Bench.of(gyro, SCALE)), expected, rtol=1e-9)
    np.testing.assert_allclose(predict(sweep, SeenBench.of(Bench.of(gyro, SCALE))), expected, rtol=1e-9)


def test_in_a_later_sweep_a_device_is_one_with_other_stiffness():
    gyro, share = MODES.gyro(MASS), 1e-3
    stiffer = eqx.tree_at(lambda g: (g.kxx, g.kyy, g.kxy), gyro, replace_fn=lambda k: k * (1 + share) ** 2)
    same(MODES.offset(share), CoupledModes.of(stiffer))
    bench = eqx.tree_at(lambda b: b.offsets, Bench(MODES), jnp.array([share]), is_leaf=lambda leaf: leaf is None)
    omega = np.linspace(3.0e4, 3.3e4, 41)
    none, noise = jnp.zeros((41, 2)) + 0j, CartesianNoise(1e-3)
    first, second = (FrequencySweep("sweep", omega, none, noise, number=number) for number in (0, 1))
    for seen in (bench, SeenBench.of(bench)):
        np.testing.assert_allclose(first.predict(seen), first.predict(Bench(MODES)), rtol=1e-12)
        np.testing.assert_allclose(second.predict(seen), first.predict(Bench(MODES.offset(share))), rtol=1e-9)


def test_a_bench_becomes_a_gyro_and_comes_back():
    gyro = MODES.gyro(MASS).with_effect(
        *(ElectricalFeedthrough(s, t, 1e3 * (1 + s + 2 * t)) for s in (0, 1) for t in (0, 1)),
        FiniteSweepRate(7.0),
        ReadoutDelay(7e-6),
    )
    back = Bench.of(gyro, SCALE).gyro(MASS)
    assert [e.label for e in back.effects] == [e.label for e in gyro.effects]
    for mine, other in zip(back.effects, gyro.effects, strict=True):
        np.testing.assert_allclose(mine.strength, other.strength, rtol=1e-14)


def test_what_two_modes_cannot_hold_is_refused():
    with pytest.raises(InputError, match=r"no effect but `force_misalignment`.*`cubic_stiffness x`"):
        CoupledModes.of(MODES.gyro(MASS).with_effect(CubicStiffness("x", 1e9)))
    with pytest.raises(InputError, match="cross_damping_asymmetry"):
        CoupledModes.of(mg.SingleMassGyro(1e-7, 1.0, 1.1, 0.0, 1e-6, 1e-6, 0.0, dyx=1e-9))


def test_numbers_that_were_given_have_no_uncertainty():
    """The variance of a product by hand, and no entry for what does not move."""
    root, loose = np.diag([0.1, 0.2]), np.array([False, False])
    joint = JointNormal.of(["mass", "kxx"], lambda v: CoupledModes.of(MODES.gyro(MASS)).gyro(MASS * v[0] * v[1]),
                           np.array([2.0, 3.0]), root, loose)  # fmt: skip
    assert joint.paths == ("mass", "kxx")
    np.testing.assert_allclose(joint.std / joint.values, np.hypot(0.1 / 2, 0.2 / 3), rtol=1e-12)
    fixed = JointNormal.of(["mass", "kxx"], lambda v: mg.SingleMassGyro(MASS, 1.0, v[0], 0.0, 1e-6, 1e-6, 0.0),
                           np.array([2.0]), np.eye(1), np.zeros(1, bool))  # fmt: skip
    assert fixed.paths == ()
