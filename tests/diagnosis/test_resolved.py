"""A law with a kink is predicted with as many harmonics and samples as it needs, a smooth one with the first few; a
record in time with steps as short as its law and its noise need."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench
from lab.die import Hidden, Outside
from lab.protocol import Laboratory, Raw

from memsgyro_jax.diagnosis.drives import without_rows
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.resolved import UNSURE, sharpened
from memsgyro_jax.effects import CubicStiffness, ForceEffect, Scanned, catalogue, on_axis, strength
from memsgyro_jax.measurement.envelope import LONGEST
from memsgyro_jax.measurement.import_case import import_case
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.readings import model_of, readings_of
from memsgyro_jax.measurement.steady import FINENESS


GAP, STIFF = 0.05, 0.5 * RESONATOR.kxx
QUIET = Laboratory(tuple(replace(sweep, noise=2e-5) for sweep in ONE_AXIS.experiments), digits=17)


class Contact(ForceEffect):
    """A stiff stop behind a known gap: a kink."""

    name, unit, law = "contact", "N/m", "F = −s·max(q − 0.05, 0)"
    axis: int = on_axis()
    strength: object = strength(sign=+1)

    def force(self, now):
        return self.along(now, -self.strength * jnp.maximum(now.displacement[self.axis] - GAP, 0.0))


@pytest.mark.slow  # so much is asked of a softer stop in `test_diagnose.py::test_a_user_s_own_effect_is_then_found`
def test_the_exact_law_with_a_kink_leaves_noise():
    """With three harmonics it left several times the noise."""
    hidden = Hidden(outside=Outside(stop_x=STIFF, stop_gap=GAP))
    touched = fit_case(bench(hidden, 1, QUIET, RESONATOR).case, [Contact("x")])
    assert {r.experiment.fineness for r in touched.joint.readings} <= set(FINENESS[1:])
    assert all(error.explained for error in touched.errors)
    (found,) = [e for e in touched.estimates if e.name == "contact x"]
    assert found.value == pytest.approx(STIFF, rel=1e-3)
    assert touched.apart == 0.0
    coarse = touched.joint.readings[0].experiment
    first = replace(coarse, fineness=FINENESS[0]).residual(touched.model)
    assert np.sqrt(np.mean(np.asarray(first) ** 2)) > 2.0


@pytest.mark.slow
def test_a_smooth_law_keeps_the_first_resolution():
    case = bench(Hidden(cubic_stiffness_x=3.9 * RESONATOR.kxx), 1, ONE_AXIS, RESONATOR).case
    fit = fit_case(case, [CubicStiffness("x")])
    assert {r.experiment.fineness for r in fit.joint.readings} == {FINENESS[0]}
    assert "resolved" not in fit.status


PER_STEP = "forces", "increments"
CLEAN = Laboratory((Raw("raw", interval=2e-5, samples=1000, force=3e-6, noise=2e-5),), digits=17)


def test_a_strong_law_in_a_clean_record_is_integrated_in_shorter_steps():
    """Steps of 0.1 rad left several times the noise of what the true device leaves nothing of."""
    made = bench(Hidden(cubic_stiffness_x=1e11), 1, CLEAN)
    model = made.model((CubicStiffness("x"),))
    (first,) = readings = readings_of(made.case)
    (finer,), apart = sharpened(model, readings)
    coarse, fine = (np.mean(np.asarray(r.experiment.residual(model)) ** 2) for r in (first, finer))
    assert coarse > 2.0
    assert fine == pytest.approx(1.0, abs=0.1)
    assert finer.experiment.parts > 1
    assert apart < UNSURE


def test_shorter_steps_change_nothing_but_the_steps():
    made = bench(Hidden(), 1, CLEAN)
    (first,) = readings_of(made.case)
    linear = made.model(())
    assert sharpened(linear, [first]) == ((first,), 0.0)
    finer = first.experiment.finer
    once, twice = (np.asarray(e.residual(linear)) for e in (first.experiment, finer))
    assert twice == pytest.approx(once, abs=1e-6)
    again, once = finer.finer.coarse, first.experiment
    assert again.parts == 1
    for name in ("forces", "increments", "step"):
        np.testing.assert_array_equal(getattr(again, name), getattr(once, name))


def test_rows_that_are_left_out_keep_no_record_coarse():
    """The finer resolution went to the rest, and what predicts all rows stayed coarse."""
    made = bench(Hidden(cubic_stiffness_x=1e11), 1, CLEAN)
    model = made.model((CubicStiffness("x"),))
    readings = without_rows(readings_of(made.case), {0: (40, 700)})
    assert readings[0].whole is not None
    (finer,), _ = sharpened(model, readings)
    assert finer.experiment.parts == finer.whole.parts > 1
    assert eqx.tree_equal(sharpened(model, [finer.changed(lambda e: e.coarse)])[0][0].whole, finer.whole)
    joint = Joint(model, [finer])
    (left,) = joint.residual(joint.start, joint.fitted)
    np.testing.assert_allclose(left, np.asarray(finer.experiment.residual(model)), atol=1e-6)


def test_a_finer_decay_of_phasors_without_some_rows_is_ranked(tmp_path):
    """What it asked in first steps was answered in finer ones: `scan got values with different leading axis sizes`."""
    time, rng = np.arange(200) / 800.0, np.random.default_rng(3)
    noise = 1e-4 * (rng.standard_normal(time.size) + 1j * rng.standard_normal(time.size))
    seen = 0.4 * np.exp((2j * np.pi * 3.0 - np.pi * 9.0) * time) + noise
    rows = np.column_stack([time, seen.real, seen.imag])
    np.savetxt(tmp_path / "decay.csv", rows, "%.9g", ",", header="t [s],Vx_I [V],Vx_Q [V]", comments="")
    case = import_case([tmp_path / "decay.csv"], tmp_path / "case", reference="9000 Hz").case
    effects = [e for e in catalogue(1) if not isinstance(e, Scanned)]
    model = model_of(case, starting_device(case)).with_effect(*effects)
    finer = [r.changed(lambda e: e.finer) for r in without_rows(readings_of(case), {0: (3,)})]
    joint = Joint(model, finer)
    units = np.eye(joint.start.size)[np.concatenate([joint.of_effect(i) for i in range(len(effects))])]
    value, slopes = joint.linearise(joint.start, units, joint.fitted)
    np.testing.assert_allclose(value, np.asarray(finer[0].experiment.residual(model.present)), atol=1e-6)
    assert np.isfinite(slopes).all()
    assert np.any(slopes, axis=0).any()


def test_a_long_record_has_no_shorter_steps_than_a_fit_can_keep():
    """65 000 rows in 64 steps each took 15 GB, and the process was killed."""
    (first,) = readings_of(bench(Hidden(), 1, CLEAN).case)
    times = LONGEST // len(first.experiment.forces)
    long = replace(first.experiment, **{k: np.tile(getattr(first.experiment, k), (times, 1)) for k in PER_STEP})
    assert first.experiment.finer is not None
    assert long.finer is None
