"""Temperatures that may be off by what a case declares: ± that hold it, in fits, verdicts, files and lots."""

import numpy as np
import pytest
from lab.oven import DAMPED, OFF, REFERENCE, RESONANCE, SET_POINTS, STIFFER, oven

import memsgyro_jax as mg
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.instrument import with_declared
from memsgyro_jax.effects import catalogue
from memsgyro_jax.measurement.case import load_case
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.readings import model_of


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


def test_a_temperature_that_is_asked_for_by_name_is_there_once(tmp_path):
    case = load_case(oven(tmp_path, rows=11))
    (term,) = with_declared(case, model_of(case, starting_device(case))).effects
    assert [effect.label for effect in fit_case(case, [term]).joint.model.effects] == [TERM]
