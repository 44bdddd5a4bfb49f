"""Devices driven so hard that their resonance bends over by several widths, one record in a file for each drive."""

from types import SimpleNamespace

import numpy as np
import pytest
from bench_case import bench
from lab import bent, both_bent

import memsgyro_jax as mg
from memsgyro_jax.diagnosis import climb
from memsgyro_jax.diagnosis.climb import by_surroundings
from memsgyro_jax.diagnosis.drives import FAR, driven_axes, stages, without_rows
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.search import start_search
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.readings import model_of, readings_of


@pytest.mark.parametrize("levels", [(5, 20, 60), (60, 20)])
def test_a_bent_resonance_tells_its_linear_device(tmp_path, levels):
    device = starting_device(mg.load_case(bent.bent_sweeps(tmp_path / "case", levels)))
    natural = np.sqrt(float(device.stiffness[0]))
    assert natural / (2.0 * np.pi) == pytest.approx(bent.F0, abs=0.1 * bent.F0 / bent.Q)
    assert natural / float(device.damping[0]) == pytest.approx(bent.Q, rel=0.05)
    assert float(device.mobility) == pytest.approx(1.0 / bent.MASS, rel=0.05)


@pytest.mark.parametrize("rows", [61, 81, 161])
def test_a_quality_factor_that_is_left_to_the_records_is_that_of_the_least_driven(tmp_path, rows):
    """Of all drives together a resonance as narrow as a rounding was told, on one row alone."""
    case = mg.load_case(bent.bent_sweeps(tmp_path / "case", (5, 20, 60), rows))
    assert case.design["quality_factor"].value == pytest.approx(bent.Q, rel=0.02)


@pytest.mark.parametrize(("levels", "alone"), [((1, 2), True), ((1, 20, 60), False)])
def test_a_misfit_of_the_surroundings_alone_is_no_reason_to_climb(tmp_path, levels, alone):
    """A device two widths lower at another temperature, which leaves the lowest drive as far off as a bent resonance;
    one that bends over as well is climbed.
    """
    folder = bent.bent_sweeps(tmp_path / "case", levels, rows=61)
    bent.add_soak(folder, level=1, rows=61, shift=-2.0 / bent.Q)
    case = mg.load_case(folder)
    joint = Joint(model_of(case, starting_device(case)), readings_of(case))
    search = start_search(case, joint, 0.045, (), lambda text: None)
    assert search.optimum.chi2 > FAR * search.optimum.dof
    assert by_surroundings(search, stages(case, joint.fitted)) == alone


def test_every_stage_has_readings_also_without_some_rows(tmp_path):
    """A row that was left out belongs to no record, which once left no stage anything to fit."""
    case = mg.load_case(bent.bent_sweeps(tmp_path / "case", (5, 20, 60), rows=41))
    readings = tuple(r for r in readings_of(case) if r.fitted)
    whole = stages(case, readings)
    fewer = stages(case, without_rows(readings, {1: (10,)}))
    assert [len(stage) for stage in fewer] == [len(stage) for stage in whole]
    assert len(whole) == 3
    assert all(whole)


@pytest.mark.slow
def test_a_fit_climbs_too(tmp_path):
    case = mg.load_case(bent.bent_sweeps(tmp_path / "case", (5, 20, 60), rows=81))
    made = mg.fit(None, case, effects=[mg.effects.CubicStiffness("x")])
    assert made.chi2_per_dof < 700.0, "the phase of the reference is left; 900 at the brink, 1e5 off the resonance"
    found = {estimate.name: estimate.value for estimate in made.estimates}
    assert found["cubic_stiffness x"] == pytest.approx(bent.CUBIC, rel=0.06), "what the phase makes of it"


@pytest.mark.slow
def test_a_spring_is_found_beside_a_drift_that_goes_on_from_record_to_record(tmp_path):
    """Of 29 parts in a million over three sweeps, a tenth of a width."""
    folder = bent.bent_sweeps(tmp_path / "case", (5, 20, 60), drift=1.4e-8)
    found = mg.diagnose(None, mg.load_case(folder))
    assert found.verdict == "found", found.sentence
    (spring,) = found.accepted
    assert spring.label == "cubic_stiffness x"
    assert spring.estimate[0] == pytest.approx(bent.CUBIC, abs=5.0 * spring.std[0] + 1e-3 * bent.CUBIC)
    (drift,) = [term for term in found.instrument if term.label == "frequency_drift throughout"]
    whole = 1.4e-8 * bent.DWELL * (3 * 161 + 2 * 10 - 1)
    assert drift.estimate[0] == pytest.approx(whole, abs=5.0 * drift.std[0])


@pytest.mark.slow
@pytest.mark.parametrize("levels", [(20,), (20, 60)])
def test_a_reference_far_off_hides_no_spring(tmp_path, levels):
    """Of one drive alone this was told as slow noise beside which nothing is missing."""
    found = mg.diagnose(None, mg.load_case(bent.bent_sweeps(tmp_path / "case", levels, phase=0.66)))
    assert found.verdict == "found", found.sentence
    (spring,) = found.accepted
    assert spring.label == "cubic_stiffness x"
    assert spring.estimate[0] == pytest.approx(bent.CUBIC, abs=5.0 * spring.std[0] + 1e-3 * bent.CUBIC)
    turned = next(term for term in found.instrument if term.name == "reference_phase")
    assert turned.estimate[0] == pytest.approx(0.66, abs=2e-3)


@pytest.mark.slow
def test_a_cubic_spring_is_found_by_a_climb_from_the_lowest_drive(tmp_path):
    found = mg.diagnose(None, mg.load_case(bent.bent_sweeps(tmp_path / "case", (5, 20, 60))))
    assert found.verdict == "found"
    (spring,) = found.accepted
    assert spring.label == "cubic_stiffness x"
    assert spring.estimate[0] == pytest.approx(bent.CUBIC, abs=5.0 * spring.std[0] + 1e-3 * bent.CUBIC)
    (turned,) = found.instrument
    assert (turned.name, turned.estimate[0]) == ("reference_phase", pytest.approx(bent.PHASE, abs=1e-3))


@pytest.mark.slow
def test_two_axes_that_bend_by_less_than_a_width_need_no_climb(tmp_path):
    """A step with the best effect is far off, as another is missing; one more step is not."""
    told: list[str] = []
    folder = both_bent.both_bent(tmp_path / "case", levels=(50, 100, 150))
    found = mg.diagnose(None, mg.load_case(folder), tell=told.append)
    assert not [line for line in told if line.startswith("climb")]
    assert {spring.label for spring in found.accepted} == {"cubic_stiffness x", "cubic_stiffness y"}, found.sentence
    for spring in found.accepted:
        assert spring.estimate[0] == pytest.approx(both_bent.CUBIC["xy".index(spring.where)], abs=5.0 * spring.std[0])


@pytest.mark.slow
def test_each_of_two_axes_that_bend_over_gets_its_spring(tmp_path):
    """At the lowest drive neither shows, at the next both are off by a width, at the last by six."""
    found = mg.diagnose(None, mg.load_case(both_bent.both_bent(tmp_path / "case")))
    assert found.verdict == "found", found.sentence
    springs = {spring.label: spring for spring in found.accepted}
    assert set(springs) == {"cubic_stiffness x", "cubic_stiffness y"}
    for axis, cubic in zip("xy", both_bent.CUBIC, strict=True):
        spring = springs[f"cubic_stiffness {axis}"]
        assert spring.estimate[0] == pytest.approx(cubic, abs=5.0 * spring.std[0])
        assert spring.std[0] < 1e-3 * abs(cubic)
    assert len(found.first) > len(springs), "what else was followed is told as well"


@pytest.mark.parametrize(
    ("before", "after", "goes_on"),
    [
        ((20.0, 20.0), (1.0, 20.0), True),  # the other axis lacks something of its own
        ((20.0, 1.0), (6.0, 9.0), True),
        ((20.0, 1.0), (8.0, 1.0), False),  # an internal resonance: any bending takes two thirds
        ((20.0, 20.0), (8.0, 8.0), False),
        ((20.0, 1.0), (20.0, 0.1), False),
        ((8.0, 8.0), (8.0, 8.0), True),  # near as it is
    ],
)
def test_an_effect_is_followed_up_where_it_takes_most_of_one_axis(monkeypatch, before, after, goes_on):
    axes = np.repeat([0, 1], 50)
    base, end = (SimpleNamespace(residual=np.take(sizes, axes), vector=None, free=None) for sizes in (before, after))
    monkeypatch.setattr(climb, "driven_axes", lambda step: axes)
    monkeypatch.setattr(climb, "optimise", lambda *_, **__: base)
    assert climb._takes_most(None, base, end, ()) == goes_on


def test_each_number_knows_the_axis_along_which_the_device_was_driven():
    fit = fit_case(bench().case)
    axes = driven_axes(fit.joint.fitted)
    assert axes.size == fit.optimum.residual.size
    told = {record.name: record.axis for record in fit.case.records if hasattr(record, "setting")}
    starts = np.cumsum([0, *(r.size for r in fit.joint.fitted)])
    for begin, readings in zip(starts, fit.joint.fitted, strict=False):
        mine = axes[begin : begin + readings.size].reshape(readings.record.size, -1)
        for number in set(readings.record.tolist()) - {-1}:
            name = fit.case.records[number].name
            if name in told:
                assert set(mine[readings.record == number].ravel().tolist()) == {told[name]}
