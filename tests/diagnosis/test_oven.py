"""Temperatures that may be off by what a case declares: ± that hold it, in fits, verdicts, files and lots."""

import re
from dataclasses import replace

import numpy as np
import pytest
from lab.oven import DAMPED, OFF, REFERENCE, RESONANCE, SET_POINTS, STIFFER, oven

import memsgyro_jax as mg
from memsgyro_jax.app.report.fit_text import fit_entries, fit_text
from memsgyro_jax.diagnosis.compare import judged
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.instrument import with_declared
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.oven import SetPointErrors, oven_offer
from memsgyro_jax.diagnosis.promise import promised
from memsgyro_jax.diagnosis.search import start_search
from memsgyro_jax.effects import catalogue
from memsgyro_jax.measurement.case import load_case
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.readings import model_of, readings_of


STIFFNESS, DAMPING, TERM = "thermal_drift stiffness", "thermal_drift damping", "record_temperature"
TRUTH = {STIFFNESS: STIFFER, DAMPING: DAMPED, "k/m": RESONANCE**2}
SEEDS = range(6)


def fitted(folder, labels=(STIFFNESS, DAMPING), **more):
    return fit_case(load_case(oven(folder, **more)), [e for e in catalogue(1) if e.label in labels])


def off(fit):
    """By how many standard deviations each of the numbers of which the truth is known is off it."""
    found = {one.name: one for one in fit.estimates}
    return np.array([(found[name].value - true) / found[name].std for name, true in TRUTH.items()])


def warmth(fit):
    """(k, 2) what is told of the records' temperatures, with standard deviations."""
    return np.array([(one.value, one.std) for one in fit.estimates if one.name.startswith(TERM)])


@pytest.mark.slow
def test_errors_of_the_oven_are_in_the_uncertainty_of_what_depends_on_temperature(tmp_path):
    """Of six ovens, what is told is off by as much as it says; without the declaration by hundreds of times."""
    declared, exact = (
        np.array([off(fitted(tmp_path / f"{std} {seed}", seed=seed, declared=std)) for seed in SEEDS])
        for std in (OFF, None)
    )
    assert np.all(np.abs(declared) < 4.0)
    spread = np.sqrt(np.mean(declared**2, axis=0))
    assert np.all((spread > 0.5) & (spread < 1.7)), spread
    of_stiffness, _, at_reference = np.median(np.abs(exact), axis=0)
    assert min(of_stiffness, at_reference) > 10.0


def test_the_uncertainty_is_that_of_a_line_through_set_points_that_are_off(tmp_path):
    """By the closed formula of a straight line: of its slope, and of where it passes the reference temperature."""
    fit = fitted(tmp_path)
    away = np.array(SET_POINTS) - REFERENCE
    spread = np.sum((away - away.mean()) ** 2)
    found = {one.name: one.std for one in fit.estimates}
    assert found[STIFFNESS] == pytest.approx(abs(STIFFER) * OFF / np.sqrt(spread), rel=0.02)
    at_reference = OFF * np.sqrt(1 / away.size + away.mean() ** 2 / spread)
    assert found["k/m"] == pytest.approx(RESONANCE**2 * abs(STIFFER) * at_reference, rel=0.02)
    values, stds = warmth(fit).T
    assert np.all(stds < OFF)
    assert np.all(np.abs(values) < 3.0 * OFF)
    assert fit.scale == 1.0


def test_where_nothing_depends_on_temperature_nothing_is_said_and_nothing_changes(tmp_path):
    """A device that no temperature moves, in an oven that is off."""
    calm = {"stiffer": 0.0, "damped": 0.0}
    unsure, sure = (fitted(tmp_path / f"{declared}", (), declared=declared, **calm) for declared in (OFF, None))
    assert [one.name for one in unsure.estimates] == [one.name for one in sure.estimates]
    for one, other in zip(unsure.estimates, sure.estimates, strict=True):
        assert (one.value, one.std) == (pytest.approx(other.value, rel=1e-9), pytest.approx(other.std, rel=1e-6))
    assert unsure.chi2_per_dof == pytest.approx(sure.chi2_per_dof, rel=1e-9)
    assert TERM not in str(unsure)
    assert mg.compare(None, unsure.case).explained


def test_a_case_that_declares_none_has_the_model_it_had(tmp_path):
    case = load_case(oven(tmp_path, declared=None, rows=11))
    model = model_of(case, starting_device(case))
    assert with_declared(case, model).effects == model.effects


@pytest.mark.slow
def test_a_temperature_that_is_asked_for_by_name_is_there_once(tmp_path):
    case = load_case(oven(tmp_path, rows=11))
    (term,) = with_declared(case, model_of(case, starting_device(case))).effects
    assert [effect.label for effect in fit_case(case, [term]).joint.model.effects] == [TERM]


@pytest.mark.slow
def test_a_fitted_model_explains_its_case_from_its_file(tmp_path):
    """With the temperatures that it found; a case that says nothing of them takes them too."""
    fit = fitted(tmp_path / "case", rows=11)
    file = mg.write_model(fit.model, tmp_path / "model.toml")
    for case in (fit.case, replace(fit.case, records=tuple(replace(r, temperature_std=0.0) for r in fit.case.records))):
        again = mg.compare(mg.read_model(file), case, fitted=False)
        for error, before in zip(again.errors, fit.errors, strict=True):
            assert error.chi2 == pytest.approx(before.chi2, rel=1e-9)


def test_the_oven_is_no_part_of_the_device(tmp_path):
    """A lot drawn from a fit varies the device by what the oven leaves unsure of it."""
    fit = fitted(tmp_path, rows=11)
    assert not any(effect.of_instrument for effect in fit.device.effects)
    paths = fit.uncertainty.paths
    assert len(paths) == 5
    assert not any(TERM in path for path in paths)
    told = {one.name: one.std for one in fit.estimates}[STIFFNESS]
    assert fit.uncertainty.std[
        [STIFFNESS.split()[0] in path and "strength" in path for path in paths].index(True)
    ] == pytest.approx(told, rel=1e-6)


def test_the_result_of_a_fit_leaves_out_what_no_record_shows(tmp_path):
    calm = fitted(tmp_path / "calm", (), stiffer=0.0, damped=0.0, rows=11)
    assert TERM not in fit_text(calm, judged(calm))
    assert fit_entries(calm, judged(calm))["effects"] == []
    warm = fitted(tmp_path / "warm", rows=11)
    names = [effect["name"] for effect in fit_entries(warm, judged(warm))["effects"]]
    assert names == [STIFFNESS, DAMPING, *(f"{TERM}[{k}]" for k in range(5))]


@pytest.mark.slow
def test_a_record_that_is_not_fitted_may_be_off_as_well(tmp_path):
    """By the temperature that the case leaves open, which a comparison takes into account."""
    wide = {"judge": 55.0, "off": 0.3, "seed": 1}
    unsure = fitted(tmp_path / "unsure", declared=0.3, **wide)
    (judge,) = [error for error in unsure.errors if error.role == "validation"]
    assert not judge.explained
    assert unsure.p_value(judge) > 0.01
    assert judged(unsure).explained
    sure = fitted(tmp_path / "sure", declared=None, **wide)
    assert not judged(sure).explained


def test_scatter_is_told_from_a_course():
    """Numbers at nine temperatures of which a straight line is taken already."""
    kelvins, random = np.linspace(240.0, 360.0, 9), np.random.default_rng(1)
    line = np.linalg.qr(np.vander(kelvins - 300.0, 2))[0]
    ways = np.linalg.svd(np.eye(9) - line @ line.T)[2][:7]

    def seen(values):
        return SetPointErrors(ways, ways @ values, np.full(7, 1e-3))

    errors = [seen(0.1 * random.standard_normal(9)) for _ in range(300)]
    assert np.sqrt(np.mean([one.size**2 for one in errors])) == pytest.approx(0.1, rel=0.1)
    assert np.mean([one.is_course(kelvins) for one in errors]) < 0.03
    assert seen(1e-6 * (kelvins - 300.0) ** 3 + 1e-3 * random.standard_normal(9)).is_course(kelvins)
    assert seen(1e-4 * random.standard_normal(9)).size < 1e-3


def drifting(case):
    """A search beside drifts that are there, at their strengths."""
    drifts = (mg.effects.ThermalStiffness(STIFFER), mg.effects.ThermalDamping(DAMPED))
    joint = Joint(model_of(case, starting_device(case)).with_effect(*drifts), readings_of(case))
    return start_search(case, joint, 0.05, (0, 1), lambda text: None)


def test_a_warmer_set_point_moves_readings_as_a_model_with_a_number_for_it_says(tmp_path):
    """The differences that an offer is made of, against the derivatives of a model that carries the numbers."""
    search = drifting(load_case(oven(tmp_path, declared=None, rows=11, seed=1)))
    term, offer = oven_offer(search)
    joint, vector = search.joint, search.optimum.vector
    beside = Joint(joint.at(vector).with_effect(term), joint.readings)
    units = np.eye(beside.start.size)[beside.of_effect(2)]
    carried = beside.linearise(beside.start, units, beside.fitted)[1]
    assert carried.shape == offer.slopes.shape
    assert np.abs(offer.slopes - carried).max() < 1e-5 * np.abs(carried).max()


@pytest.mark.slow
def test_what_an_oven_was_off_explains_what_drifts_leave(tmp_path):
    """Where nothing is declared, at four temperatures or more; a promise is made of nothing but what is left."""
    case = load_case(oven(tmp_path / "five", declared=None, seed=1))
    search = drifting(case)
    term, offer = oven_offer(search)
    assert 0.05 < float(term.known_to[0]) < 0.3
    left = search.optimum.chi2 - promised(search.optimum, [offer], 0.05).gain
    assert search.optimum.chi2 > 10.0 * search.optimum.dof
    assert left < 1.3 * search.optimum.dof
    some = replace(case, records=case.records[:3])
    assert oven_offer(drifting(some)) is None
    search.case = replace(case, records=tuple(replace(r, temperature_std=OFF) for r in case.records))
    assert oven_offer(search) is None


def diagnosed(folder, **more):
    return mg.diagnose(None, load_case(oven(folder, **more)))


@pytest.mark.slow
def test_a_diagnosis_holds_what_is_declared(tmp_path):
    found = diagnosed(tmp_path, judge=55.0, seed=2)
    assert found.verdict == "found"
    assert {a.label for a in found.accepted} == {STIFFNESS, DAMPING}
    assert [a.label for a in found.instrument] == [TERM]
    assert "temperature_std" not in found.sentence
    (stiffer,) = [a for a in found.accepted if a.label == STIFFNESS]
    assert abs(stiffer.estimate[0] - STIFFER) < 3.0 * stiffer.std[0]
    assert stiffer.std[0] > 5e-8


@pytest.mark.slow
def test_a_diagnosis_of_a_device_that_no_temperature_moves_says_nothing_of_it(tmp_path):
    found = diagnosed(tmp_path, stiffer=0.0, damped=0.0, seed=6)
    assert found.verdict == "nothing_missing"
    assert found.instrument == ()
    assert TERM not in str(found)


@pytest.mark.slow
def test_what_an_oven_was_off_is_told_in_kelvin_where_a_case_holds_it_for_exact(tmp_path):
    """Over six ovens what is found is off by as much as it says, though nobody said how far they are off."""
    far, kelvins = [], []
    for seed in SEEDS:
        points = np.linspace(-30.0, 90.0, 7)
        found = diagnosed(tmp_path / f"{seed}", seed=seed, declared=None, set_points=points)
        assert found.verdict == "found"
        (stiffer,) = [a for a in found.accepted if a.label == STIFFNESS]
        far.append((stiffer.estimate[0] - STIFFER) / stiffer.std[0])
        assert [a.label for a in found.instrument] == [TERM]
        kelvins.append(float(re.search(r"scatter by ([\d.]+) K", found.sentence)[1]))
    assert 0.05 < np.sqrt(np.mean(np.square(kelvins))) < 0.2, kelvins
    assert np.sqrt(np.mean(np.square(far))) < 2.0, far


@pytest.mark.slow
def test_a_course_that_no_effect_follows_is_no_oven(tmp_path):
    points = np.linspace(-30.0, 85.0, 9)
    found = diagnosed(tmp_path, off=0.0, declared=None, set_points=points, further=lambda warming: 1e-10 * warming**3)
    assert TERM not in {a.label for a in found.instrument}
    assert "scatter by" not in found.sentence
