"""Whole diagnoses of small cases whose truth the laboratory knows."""

import json
from dataclasses import replace

import numpy as np
import pytest
from bench_case import DIE, ONE_AXIS, RESONATOR, TINY, bench
from json_schema import fits
from kept import kept
from lab.devices import DEVICES
from lab.die import Hidden, Outside
from lab.faults import Faults
from lab.strengths import VISIBLE, visible

from memsgyro_jax.app.commands.schema import schema_of
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.diagnosis.diagnose import diagnose
from memsgyro_jax.diagnosis.scans import scan, scans
from memsgyro_jax.effects import ParasiticMode, load_effects
from memsgyro_jax.measurement.steady import FINENESS


SWEEPS = replace(TINY, experiments=TINY.experiments[:2])


# ---- a gyro, the whole catalogue: all kinds of records where one hides nothing, sweeps of both axes where it does


@pytest.fixture(scope="module")
def sound():
    return diagnose(None, bench().case)


@pytest.fixture(scope="module")
def cubic():
    return diagnose(None, bench(visible("cubic_stiffness_y"), protocol=SWEEPS).case)


@pytest.mark.slow
def test_nothing_is_missing_from_a_sound_device(sound):
    assert sound.verdict == "nothing_missing"
    assert sound.accepted == ()
    assert 0.85 < sound.base.chi2_per_dof < 1.15
    assert all(c.p_value > 0.05 for c in sound.candidates)
    assert [s.added for s in sound.steps] == [""]


def test_nothing_is_missing_from_sweeps_of_a_sound_gyro(cubic):
    """Through the programs that found the spring."""
    found = diagnose(None, bench(protocol=SWEEPS).case)
    assert found.verdict == "nothing_missing"
    assert found.accepted == ()
    assert 0.85 < found.base.chi2_per_dof < 1.15
    assert {c.label for c in found.candidates} == {c.label for c in cubic.first}
    assert all(c.p_value > 0.05 for c in found.candidates)


def test_a_hidden_spring_is_found(cubic):
    assert cubic.verdict == "found"
    (found,) = cubic.accepted
    assert found.label == "cubic_stiffness y"
    assert found.confused_with == ()
    assert abs(found.estimate[0] - VISIBLE["cubic_stiffness_y"]) < 4.5 * found.std[0]
    assert found.std[0] < 0.02 * VISIBLE["cubic_stiffness_y"]


def test_the_error_falls_to_the_noise_on_records_that_were_not_fitted(cubic):
    before, after = ({e.name: e.rms for e in fit.errors if e.role == "validation"} for fit in (cubic.base, cubic.final))
    assert before["sweep_y"] > 5.0
    assert all(value < 1.25 for value in after.values())
    (found,) = cubic.accepted
    assert found.error_before > 5.0 > 1.2 > found.error_after
    assert [s.added for s in cubic.steps] == ["", "cubic_stiffness y"]


def test_a_diagnosis_goes_into_a_file(cubic, tmp_path):
    data = kept(cubic, tmp_path)
    assert data.attrs["verdict"] == "found"
    assert list(data["effect"].values) == ["cubic_stiffness y"]
    assert float(data["estimate"][0]) == cubic.accepted[0].estimate[0]
    assert np.all(data["rms_final"] <= data["rms_base"] * 1.1)
    assert len(cubic.plot().get_yticklabels()) == len(cubic.case.records)


def test_what_is_unexplained_hands_on_no_uncertainty_and_what_has_not_converged_says_so(cubic):
    assert np.all(np.isfinite(cubic.uncertainty.std))
    with pytest.raises(InputError, match="ends with unknown effect has no uncertainty"):
        _ = replace(cubic, verdict="unknown_effect").uncertainty
    assert "not converged" not in str(cubic)
    optimum = replace(cubic.final.optimum, converged=False)
    assert "The fit is not converged after" in str(replace(cubic, final=replace(cubic.final, optimum=optimum)))


def test_the_answer_is_readable_by_machines(cubic):
    answer = json.loads(cubic.to_json())
    assert fits(answer, schema_of("diagnosis"), schema_of("diagnosis"))
    assert answer["schema"] == "memsgyro-diagnosis/1"
    assert answer["verdict"] == "found"
    assert [(e["name"], e["axis"], e["unit"]) for e in answer["effects"]] == [("cubic_stiffness", "y", "N/m³")]
    assert answer["residual"] == {}
    first = answer["candidates_of_base"][0]
    assert first["label"] == "cubic_stiffness y"
    assert first["explained_share"] > 0.9


@pytest.mark.slow
def test_candidates_say_what_would_have_been_seen(sound):
    """A strength well above `smallest_visible` was found, and would not have been at a hundredth of it."""
    (spring,) = [c for c in sound.first if c.label == "cubic_stiffness y"]
    assert spring.excited
    assert 0.01 * VISIBLE["cubic_stiffness_y"] < spring.smallest_visible < 0.1 * VISIBLE["cubic_stiffness_y"]


@pytest.mark.slow
def test_a_mode_is_looked_for_in_sweeps_and_not_in_the_raw_capture_at_the_first_resolution(sound):
    base, readings = sound.base, sound.base.joint.fitted
    (grid,) = [g for g in scans(sound.case) if g[0].label == "parasitic_mode x"]
    found = scan(base.model, base.optimum, readings, grid)
    assert isinstance(found.effect, ParasiticMode)
    assert found.score.p_value * found.points > 0.01
    finer = [replace(r, experiment=r.experiment.finer or r.experiment) for r in readings]
    assert any(new.experiment is not old.experiment for new, old in zip(finer, readings, strict=True))
    again = scan(base.model, base.optimum, finer, grid)
    assert again.score.statistic == pytest.approx(found.score.statistic, rel=1e-9)


def test_an_impossible_level_is_refused():
    with pytest.raises(InputError, match="Argument `level` must lie between 0 and 1, but is 2"):
        diagnose(None, bench().case, level=2.0)


# ---- a resonator with a stop, which no catalogue lists


STOP = Hidden(outside=Outside(stop_x=0.03 * RESONATOR.kxx, stop_gap=0.05))
OWN = """
import jax.numpy as jnp
from memsgyro_jax.effects import ForceEffect, strength


class Stop(ForceEffect):
    name, unit, law = "stop", "N/m", "F = -s max(q - gap, 0)"
    axis: int = 0
    strength: object = strength()

    def force(self, now):
        return self.along(now, -self.strength * jnp.maximum(now.displacement[self.axis] - 0.05, 0.0))
"""


@pytest.fixture(scope="module")
def stopped():
    return bench(STOP, 1, ONE_AXIS, RESONATOR).case


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """The user's effect; among the candidates of all diagnoses below, so that they share their programs."""
    path = tmp_path_factory.mktemp("own") / "own.py"
    path.write_text(OWN)
    return load_effects(path, 1)


@pytest.mark.slow
def test_physics_outside_the_catalogue_is_not_called_found(stopped):
    """No strength is quoted of what is not the law: the model stays the base model; what was tried stands apart."""
    outcome = diagnose(None, stopped)
    assert outcome.verdict == "unknown_effect"
    assert any(not e.explained for e in outcome.final.errors)
    assert "sweep" in outcome.sentence
    assert outcome.accepted == ()
    assert outcome.final is outcome.base
    assert 0 < len(outcome.tried) <= 2
    assert outcome.tried[-1].chi2_per_dof < outcome.base.chi2_per_dof
    answer = json.loads(outcome.to_json())
    assert (answer["effects"], len(answer["tried"]), len(answer["steps"])) == ([], len(outcome.tried), 1)
    assert {c["smallest_visible"] for c in answer["candidates"] + answer["candidates_of_base"]} == {None}
    assert answer["next_experiments"] == []
    assert "none is predicted" in answer["next_experiment"]


@pytest.mark.parametrize("times", [pytest.param(3.0, marks=pytest.mark.slow), 0.3])
def test_a_noise_that_is_declared_wrong_is_called_that(times, own):
    """White deviations of three times the declared noise are no effect, and those of a third are no alarm."""
    case = bench(Hidden(), 0, ONE_AXIS, RESONATOR).case
    case = replace(case, records=tuple(replace(r, noise_std=r.noise_std / times) for r in case.records))
    outcome = diagnose(None, case, effects=own)
    assert (outcome.verdict, outcome.accepted) == ("nothing_missing", ())
    assert ("times what is declared in sweep" in outcome.sentence) == (times > 1)
    assert outcome.scale == pytest.approx(max(times, 1.0), rel=0.25)


FLICKER = replace(ONE_AXIS, faults=Faults(corner=20.0))  # at twenty rows a second


def test_a_noise_that_is_slow_is_called_that(own):
    """1/f noise beside which a sound device leaves four times the declared, white noise is no effect."""
    outcome = diagnose(None, bench(Hidden(), 0, FLICKER, RESONATOR).case, effects=own)
    assert (outcome.verdict, outcome.accepted, outcome.instrument) == ("nothing_missing", (), ())
    assert outcome.base.chi2_per_dof > 3.0
    assert "The noise is not white but grows towards low frequencies, in sweep over" in outcome.sentence
    assert "its noise is slow" in str(outcome)
    assert json.loads(outcome.to_json())["residual"] == {}


@pytest.mark.slow
@pytest.mark.parametrize("corner", [20.0, 200.0])
def test_slow_noise_is_called_that_where_few_rows_tell_its_spectrum(corner):
    """Of a gyro; and of a sweep and a ring-down that the fit to the sweep foretells by its uncertainty only."""
    few = DEVICES["8 kHz, one sweep and one ring-down"]
    for protocol, die in ((TINY, DIE), (few.protocol, few.die)):
        outcome = diagnose(None, bench(Hidden(), 1, replace(protocol, faults=Faults(corner=corner)), die).case)
        assert (outcome.verdict, outcome.accepted, outcome.instrument) == ("nothing_missing", (), ())
        assert "The noise is not white" in outcome.sentence


def test_a_spring_is_found_beside_slow_noise(own):
    spring = Hidden(cubic_stiffness_x=3.9 * RESONATOR.kxx)
    outcome = diagnose(None, bench(spring, 1, FLICKER, RESONATOR).case, effects=own)
    assert [a.label for a in outcome.accepted] == ["cubic_stiffness x"]
    assert outcome.verdict == "found"


@pytest.mark.slow
def test_a_delay_that_is_a_phase_as_well_is_not_told_from_it(own):
    turned = replace(ONE_AXIS, faults=Faults(phase=-0.026))
    outcome = diagnose(None, bench(Hidden(), 0, turned, RESONATOR).case, effects=own)
    assert outcome.verdict == "instrument_only"
    assert [term.label for term in outcome.instrument] == ["reference_phase"]
    assert (outcome.accepted, outcome.device.effects) == ((), ())
    assert json.loads(outcome.to_json())["instrument"][0]["name"] == "reference_phase"
    assert "cannot tell it from readout_delay" in outcome.sentence
    assert "reference_phase" in str(outcome)


@pytest.mark.slow
def test_a_user_s_own_effect_is_then_found(stopped, own):
    outcome = diagnose(None, stopped, effects=own)
    assert [a.label for a in outcome.accepted] == ["stop x"]
    (found,) = outcome.accepted
    assert found.estimate[0] == pytest.approx(STOP.outside.stop_x, rel=0.05)
    assert {r.experiment.fineness for r in outcome.final.joint.readings} <= set(FINENESS[1:])
    assert outcome.verdict == "found"


@pytest.mark.slow
def test_a_change_of_units_is_no_rival(own):
    """A scale error of the only axis is another mass and another spring; where there is no spring it explains none
    of the misfit.
    """
    spring = Hidden(cubic_stiffness_x=3.9 * RESONATOR.kxx)
    outcome = diagnose(None, bench(spring, 1, ONE_AXIS, RESONATOR).case, effects=own)
    assert [a.label for a in outcome.accepted] == ["cubic_stiffness x"]
    assert outcome.accepted[0].confused_with == ()
    base = outcome.base  # its rows are filled up to the shape of those that are not fitted, which counts for nothing
    assert base.optimum.residual.size > sum(e.count for e in base.errors if e.role == "fit")
    assert base.optimum.chi2 / base.optimum.dof == pytest.approx(base.chi2_per_dof)


def test_what_a_lock_in_cannot_see_is_not_excited(own):
    case = bench(Hidden(), 1, ONE_AXIS, RESONATOR).case
    outcome = diagnose(None, case, effects=own)
    assert outcome.verdict == "nothing_missing"
    excited = {c.label: c.excited for c in outcome.first}
    assert not excited["thermal_drift stiffness"]
    assert not excited["pickoff_nonlinearity x"], "a square has no part at the drive frequency"
