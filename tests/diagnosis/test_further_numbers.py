"""Effects with several numbers, and with a sign that physics gives them."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench
from lab.die import Hidden, Outside

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.diagnosis.optimum import bent
from memsgyro_jax.effects import CubicStiffness, ForceEffect, QuadraticDamping, on_axis, parameter, strength
from memsgyro_jax.measurement.model_file import model_text, read_model, write_model


SPRING, EXPONENT = 3.9 * RESONATOR.kxx, 3.0
STOP, GAP = 0.03 * RESONATOR.kxx, 0.05


class PowerSpring(ForceEffect):
    """F = −s·|q|^p·sign(q)."""

    name, unit, law = "power_spring", "1", "F = −s·|q|^p·sign(q)"
    axis: int = on_axis()
    strength: object = strength()
    exponent: object = parameter(start=2.3, low=1.5, high=6.0)

    def force(self, now):
        q = now.displacement[self.axis]
        size = jnp.maximum(jnp.abs(q), 1e-30)
        return self.along(now, -self.strength * jnp.sign(q) * size**self.exponent)


class Stop(ForceEffect):
    """A spring behind a gap."""

    name, unit, law = "stop", "N/m", "F = −s·max(q − g, 0)"
    axis: int = on_axis()
    strength: object = strength(sign=+1)
    gap: object = parameter(start=0.035, low=0.0, high=0.2, unit="m")

    def force(self, now):
        return self.along(now, -self.strength * jnp.maximum(now.displacement[self.axis] - self.gap, 0.0))


def fitted(hidden, effect, **more):
    return mg.fit(None, bench(hidden, 1, ONE_AXIS, RESONATOR).case, effects=[effect], **more)


@pytest.fixture(scope="module")
def powered():
    return fitted(Hidden(cubic_stiffness_x=SPRING), PowerSpring("x"))


def test_a_free_exponent_is_found_within_its_uncertainty(powered):
    found = {e.name: e for e in powered.estimates}
    exponent = found["power_spring x exponent"]
    assert abs(exponent.value - EXPONENT) < 4.5 * exponent.std
    assert exponent.std < 0.1
    assert abs(found["power_spring x"].value - SPRING) < 4.5 * found["power_spring x"].std
    assert all(error.explained for error in powered.errors)


@pytest.mark.slow
@pytest.mark.parametrize("start", [0.035, 0.18])
def test_a_free_threshold_is_found_within_its_uncertainty(start):
    """From beyond the largest swing too, where nothing would show the effect."""
    fit = fitted(Hidden(outside=Outside(stop_x=STOP, stop_gap=GAP)), Stop("x", gap=start))
    found = {e.name: e for e in fit.estimates}
    gap = found["stop x gap"]
    assert gap.unit == "V", "of a record whose scale nobody knows"
    assert abs(gap.value - GAP) < 4.5 * gap.std
    assert gap.std < 0.01
    assert abs(found["stop x"].value - STOP) < 4.5 * found["stop x"].std


@pytest.mark.slow
def test_a_threshold_beyond_the_swing_is_found_by_a_diagnosis():
    case = bench(Hidden(outside=Outside(stop_x=STOP, stop_gap=GAP)), 1, ONE_AXIS, RESONATOR).case
    outcome = mg.diagnose(None, case, effects=[Stop("x", gap=0.18)])
    assert outcome.verdict == "found"
    assert [one.label for one in outcome.accepted] == ["stop x"]


@pytest.mark.slow
def test_a_number_may_be_fixed():
    fit = fitted(Hidden(cubic_stiffness_x=SPRING), PowerSpring("x", exponent=3.0), fixed=["power_spring x exponent"])
    assert float(fit.model.effects[0].exponent) == 3.0
    (found,) = [e for e in fit.estimates if e.name.startswith("power_spring")]
    assert abs(found.value - SPRING) < 4.5 * found.std
    assert fit.uncertainty.paths[3:] == ("effects.power_spring_x.strength",)
    with pytest.raises(InputError, match="did you mean `power_spring x`"):
        fitted(Hidden(cubic_stiffness_x=SPRING), PowerSpring("x"), fixed=["power_sprung x"])


def test_all_numbers_are_in_the_model_file(powered, tmp_path):
    assert "exponent = " in model_text(powered.model)
    again = read_model(write_model(powered.model, tmp_path / "model.toml"), (PowerSpring("x"),))
    assert bool(eqx.tree_equal(again, replace(powered.model, holds_gain=False))), "a model of a file has its own mass"


def test_a_fit_hands_on_its_device_and_its_joint_uncertainty(powered):
    """Widths by the joint covariance agree with those of the parameters that they are made of."""
    device, joint = powered.device, powered.uncertainty
    base = ("resonance", "quality_factor", "static_gain")
    assert joint.paths == (*base, "effects.power_spring_x.strength", "effects.power_spring_x.exponent")
    np.testing.assert_allclose(joint.values[0], device.resonance, rtol=1e-12)
    np.testing.assert_allclose(joint.values[4], device.effects.power_spring_x.exponent, rtol=1e-12)
    estimates = {e.name: e for e in powered.estimates}
    stiffness = estimates["k/m"]
    assert joint.std[0] / joint.values[0] == pytest.approx(0.5 * stiffness.std / stiffness.value, rel=1e-6)
    assert joint.std[4] == pytest.approx(estimates["power_spring x exponent"].std, rel=1e-6)
    assert np.all(np.linalg.eigvalsh(joint.covariance / np.outer(joint.std, joint.std)) > 0)


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_a_damping_never_gives_energy(seed):
    """On a sound device an estimate would be negative in every second draw; then it is zero, and the fit the base's."""
    case = bench(Hidden(), seed, ONE_AXIS, RESONATOR).case
    fit, base = mg.fit(None, case, effects=[QuadraticDamping("x")]), mg.fit(None, case)
    (found,) = [e for e in fit.estimates if e.name == "quadratic_damping x"]
    assert 0.0 <= found.value < 4.0 * found.std < np.inf
    assert fit.optimum.chi2 <= base.optimum.chi2 + 1e-3
    if found.value == 0.0:
        assert fit.optimum.chi2 == pytest.approx(base.optimum.chi2, abs=1e-3)


def test_a_step_towards_a_bound_never_reaches_it():
    start, low, high = np.array([2.0, 2.0, 0.0]), np.array([0.0, -np.inf, 0.0]), np.array([np.inf, 3.0, np.inf])
    for step in (np.array([-1e9, 1e9, -1.0]), np.array([-1.95, 0.97, 2.0]), np.zeros(3)):
        value, slope = bent(start, step, low, high)
        assert np.all((value >= low) & (value <= high))
        ends = [bent(start, step + h, low, high)[0] for h in (1e-6, -1e-6)]
        np.testing.assert_allclose(slope[:2], (ends[0] - ends[1])[:2] / 2e-6, atol=1e-6)
    np.testing.assert_array_equal(bent(start, np.zeros(3), low, high)[0], start)


@pytest.mark.slow
def test_a_device_with_an_effect_goes_into_compare_fit_and_diagnose(powered):
    """The effect is free in a fit, part of what is compared, and given to a diagnosis; and what comes out goes on."""
    case = bench(Hidden(cubic_stiffness_x=SPRING), 1, ONE_AXIS, RESONATOR).case
    bare = powered.device.with_only(())
    fit = mg.fit(bare.with_effect(CubicStiffness("x")), case)
    (found,) = [e for e in fit.estimates if e.name == "cubic_stiffness x"]
    assert abs(found.value - SPRING) < 4.5 * found.std
    assert mg.compare(fit.device, case).explained
    assert not mg.compare(bare, case).explained
    given = mg.diagnose(bare.with_effect(CubicStiffness("x")), case)
    assert (given.verdict, given.given) == ("nothing_missing", ("cubic_stiffness x",))
    assert [e.label for e in given.device.effects] == ["cubic_stiffness x"]
    np.testing.assert_allclose(given.device.effects.cubic_stiffness_x.strength, found.value, rtol=1e-3)
    assert "effects.cubic_stiffness_x.strength" in given.uncertainty.paths
