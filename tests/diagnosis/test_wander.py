"""A resonance that wanders over sweeps that follow each other in time: of a linear device, made by other code."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.diagnosis.describing import drift_over
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.instrument import beside_case_of, frequency_wander
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.search import start_search
from memsgyro_jax.diagnosis.wander import (
    _by_drive,
    beside_course,
    goes_with_drive,
    of_wander,
    with_wander,
    with_wander_first,
)
from memsgyro_jax.effects.instrument import FrequencyDrift, FrequencyWander
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.model_file import read_model, write_model
from memsgyro_jax.measurement.readings import model_of, readings_of


F0, Q, ROWS, DWELL, NOISE = 31.7e3, 4000.0, 41, 2.0, 3e-4  # Hz, 1, 1, s, of the strongest swing
SPAN = 3.0 * F0 / Q  # Hz to each side
UP_AND_DOWN = ((1, 1), (1, -1), (2, 1), (2, -1), (4, 1), (4, -1))  # drive in mV, direction
WHOLE = len(UP_AND_DOWN) * (ROWS + 10) * DWELL  # s
CASE = f"""schema = "memsgyro-case/1"
name = "wander"
device = "resonator"
[readout]
quantity = "velocity"
[[experiment]]
name = "sweeps"
kind = "frequency_sweep"
file = "sweeps.csv"
settled = true
drive_axis = "x"
noise_std = "{NOISE} V"
"""


def case_of(folder, course, sweeps=UP_AND_DOWN, bend=0.0, heat=0.0):
    """A case of one file of sweeps, whose resonance [Hz] a `course` tells from the share of the time that is past and
    the drive [mV]; with a spring that bends it by so many widths at the largest swing, or one that follows that swing
    as a body warms up, in a tenth of the whole time.
    """
    rng, whole = np.random.default_rng(3), WHOLE * len(sweeps) / len(UP_AND_DOWN)
    top, rows, warm = max(level for level, _ in sweeps), [], 0.0
    for k, (level, way) in enumerate(sweeps):
        frequency, swing = F0 + SPAN * np.linspace(-way, way, ROWS), 0.0
        time = DWELL * (k * (ROWS + 10) + np.arange(ROWS))
        for f, t in zip(frequency, time, strict=True):
            natural = F0 + course(t / whole, level) + heat * warm * F0 / Q
            for _ in range(200 if bend else 1):  # the branch that a sweep follows, of a spring that folds nothing over
                moved = natural + bend * swing**2 * F0 / Q
                volts = (level / top) * (1j * f * F0 / Q) / (moved**2 - f**2 + 1j * f * F0 / Q)
                swing = 0.7 * swing + 0.3 * abs(volts) if bend else abs(volts)
            warm += (swing**2 - warm) * (1.0 - np.exp(-10.0 * DWELL / whole))
            seen = volts + NOISE * (rng.standard_normal() + 1j * rng.standard_normal())
            rows.append((t, 1e-3 * level, f, seen.real, seen.imag))
    folder.mkdir(parents=True, exist_ok=True)
    np.savetxt(folder / "sweeps.csv", rows, "%.12g", ",", header="t [s],drive [V],f [Hz],X [V],Y [V]", comments="")
    (folder / "case.toml").write_text(CASE)
    return mg.load_case(folder)


def swinging(past, level=0.0):
    """An oven that swings about its set point, which it has yet to reach."""
    return 2.0 * np.exp(-3.0 * past) + np.sin(7.0 * past)


def searched(case):
    """The base model, with a spring as the only effect that may be found."""
    joint = Joint(model_of(case, starting_device(case)).with_effect(mg.effects.CubicStiffness()), readings_of(case))
    search = start_search(case, joint, 0.05, (), lambda text: None)
    return search, search.rank()


def test_its_course_is_a_sum_of_polynomials():
    past, parts = np.linspace(0.0, 1.0, 7), np.array([1e-6, -2e-6, 5e-7, 3e-7])
    term = FrequencyWander(parts, np.ones((1, 1, 4)))
    told = np.polynomial.chebyshev.chebval(2.0 * past - 1.0, [0.0, *parts])
    np.testing.assert_allclose(np.asarray(term.course(past)) @ parts, told, rtol=1e-12, atol=1e-20)
    np.testing.assert_allclose(term.course(jnp.asarray(past)) @ jnp.asarray(parts), told, rtol=1e-12, atol=1e-20)
    drift = FrequencyDrift((2e-6,), np.ones((1, 1, 1)))
    even = FrequencyWander((1e-6,), np.ones((1, 1, 1)))
    np.testing.assert_allclose(drift.course(past) @ drift.strength, even.course(past) @ even.strength, atol=1e-20)


def test_there_are_no_more_parts_than_single_sweeps(tmp_path):
    case = case_of(tmp_path, swinging)
    term = frequency_wander(case)
    assert term.strength.size == 6
    assert frequency_wander(case, 10) is None
    (record,) = case.records
    assert frequency_wander(replace(case, records=(replace(record, time=None),))) is None, "no clock"
    halves = [record.only(np.arange(3 * ROWS)), record.only(np.arange(3 * ROWS, 6 * ROWS))]
    joined = frequency_wander(replace(case, records=tuple(halves)))
    np.testing.assert_allclose(joined.span, [record.time[-1] - record.time[0]] * 2)
    at_once = [replace(half, time=half.time - half.time[0]) for half in halves]
    assert frequency_wander(replace(case, records=tuple(at_once))) is None, "each with a clock of its own"
    two = record.only(np.arange(2 * ROWS))
    assert frequency_wander(replace(case, records=(two,))) is None, "two sweeps"


def test_a_course_comes_back_from_a_file_in_as_many_parts(tmp_path):
    case = case_of(tmp_path, swinging)
    found = fit_case(case, [frequency_wander(case, 5)])
    again = beside_case_of(case, read_model(write_model(found.model, tmp_path / "m.toml")))
    assert mg.compare(again, case, fitted=False).fit.optimum.chi2 == pytest.approx(found.optimum.chi2, rel=1e-9)
    with pytest.raises(InputError, match=r"frequency_wander.*with 10 numbers"):
        beside_case_of(case, again.with_only([FrequencyWander(np.ones(10), np.ones((1, 1, 10)))]))


def test_a_resonance_that_wanders_is_found_with_the_device(tmp_path):
    search, first = searched(case_of(tmp_path, swinging))
    assert search.base.chi2_per_dof > 100.0
    found = with_wander_first(search, first)
    (term,) = found.steps[-1].fit.model.present.effects
    assert term.name == "frequency_wander"
    assert 3 <= term.strength.size <= 6
    assert [step.added for step in found.steps] == ["", "frequency_wander"]
    quality = found.steps[-1].fit.modes[1]
    assert quality.value == pytest.approx(Q, abs=4.0 * quality.std)
    past = np.linspace(0.05, 0.95, 50)
    told = F0 * np.asarray(term.course(past)) @ np.asarray(term.strength)
    assert np.std(told - swinging(past * float(term.span[0]) / WHOLE)) < 0.05, "Hz, of a course of 2 Hz"
    assert not goes_with_drive(found)
    assert "the resonance moves over 2" in drift_over(found.steps[-1].fit, term)


@pytest.mark.parametrize(
    ("course", "made"),
    [
        (lambda past, level: 3.0 * past, {}),  # a drift says it in one number
        (lambda past, level: np.cos(40.0 * past), {}),  # no course of few parts
        (lambda past, level: 2.0 * (past > 0.4) - 2.0 * (past > 0.7), {}),  # jumps
        (lambda past, level: 0.0, {"bend": 0.6}),  # a spring
        (lambda past, level: 0.0, {"heat": 0.6}),  # memory of the swing
        (lambda past, level: 0.0, {}),  # nothing
    ],
)
def test_a_resonance_that_does_anything_else_is_not_said_to_wander(tmp_path, course, made):
    search, first = searched(case_of(tmp_path, course, **made))
    assert with_wander_first(search, first) is None


def test_a_resonance_that_goes_with_a_drive_set_once_is_not_told_from_one_that_wanders(tmp_path):
    """Each level at its own time: 1, 2 and 4 mV up and down tell, if time goes on while a level stays."""
    once, both = ((1, 1), (2, 1), (4, 1), (8, 1)), ((1, 1), (2, 1), (4, 1), (8, 1), (4, -1), (1, -1))
    found = [
        with_wander(searched(case_of(tmp_path / name, course, sweeps))[0])
        for name, course, sweeps in (
            ("power", lambda past, level: 0.05 * level**2, once),
            ("time", lambda past, level: swinging(past), both),
        )
    ]
    assert [goes_with_drive(one) for one in found] == [True, False]
    assert ["cannot tell a resonance that wanders" in of_wander(one) for one in found] == [True, False]
    assert all("An oven moves a resonance so" in of_wander(one) for one in found)


def test_a_spring_stays_beside_a_resonance_that_wanders(tmp_path):
    """Alone the course leaves what the spring bends."""
    search, first = searched(case_of(tmp_path, swinging, bend=0.5))
    assert with_wander_first(search, first) is None
    (spring,) = first.places
    search.take(spring, search.with_one_more(spring, first.slopes[0], 30))
    assert search.optimum.chi2 > 10.0 * search.optimum.dof
    found = with_wander_first(search, search.rank())
    assert found.steps[-1].fit.leaves_noise
    assert {effect.name for effect in found.steps[-1].fit.model.present.effects} == {
        "cubic_stiffness",
        "frequency_wander",
    }
    fit = found.steps[-1].fit
    assert fit.modes[1].value == pytest.approx(Q, abs=4.0 * fit.modes[1].std)


def test_a_drive_is_one_whichever_files_hold_its_sweeps(tmp_path):
    """Else each file had a resonance of its own, and nothing told the drive from the time."""
    whole = case_of(tmp_path, swinging)
    (record,) = whole.records
    alone = tuple(record.only(np.arange(record.rows)[rows]) for rows in record.sweeps)
    assert _by_drive(whole) == [{(0, 0), (0, 1)}, {(0, 2), (0, 3)}, {(0, 4), (0, 5)}]
    apart = replace(whole, records=tuple(replace(one, name=f"file {k}") for k, one in enumerate(alone)))
    assert _by_drive(apart) == [{(0, 0), (1, 0)}, {(2, 0), (3, 0)}, {(4, 0), (5, 0)}]


def test_what_a_longer_course_takes_as_well_is_no_effect(tmp_path):
    """Of a course that ends with the part by which it is told; a spring that bends far more is one."""
    told = []
    for bend in (0.0, 0.03):
        search, _ = searched(case_of(tmp_path / str(bend), swinging, bend=bend))
        begin = with_wander(search)

        def with_spring(begin, ranking):
            (spring,) = ranking.places
            begin.take(spring, begin.with_one_more(spring, ranking.slopes[0], 30))
            return begin, begin.rank()

        told.append(beside_course(begin, with_spring)[0].accepted != [])
        assert begin.accepted == [], "it goes on by itself"
    assert told == [False, True]


# ---- whole diagnoses


@pytest.mark.slow
def test_of_a_linear_device_that_wanders_the_instrument_alone_is_told(tmp_path):
    told = mg.diagnose(None, case_of(tmp_path, swinging))
    assert told.verdict == "instrument_only", told.sentence
    assert [term.name for term in told.instrument] == ["frequency_wander"]
    assert "shows from" not in told.sentence
    assert "An oven moves a resonance so" in told.sentence
    assert "cannot tell" not in told.sentence


@pytest.mark.slow
def test_a_spring_is_found_beside_a_resonance_that_wanders(tmp_path):
    told = mg.diagnose(None, case_of(tmp_path, swinging, bend=0.5))
    assert told.verdict == "found", told.sentence
    assert [effect.label for effect in told.accepted] == ["cubic_stiffness x"]
    assert [term.name for term in told.instrument] == ["frequency_wander"]


@pytest.mark.slow
@pytest.mark.parametrize("course", [swinging, lambda past, level: 0.0])
def test_a_resonance_that_remembers_the_swing_stays_unknown(tmp_path, course):
    told = mg.diagnose(None, case_of(tmp_path, course, heat=0.6))
    assert told.verdict in ("unknown_effect", "partly_explained"), told.sentence
    assert "frequency_wander" not in [term.name for term in told.instrument]
