"""Profiles by hand, their slopes, what a scenario says at a moment, and bad records."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.loop.scenario import Chirp, Constant, Ramp, RandomWalk, Recorded, Scenario, Sine, Step, as_scenario
from memsgyro_jax.loop.unreached import unreached


TIMES = np.linspace(0.0, 2.0, 41)
PROFILES = {
    "constant": (Constant(3.0), lambda t: 3.0 + 0 * t),
    "nothing": (Constant(), lambda t: 0.0 * t),
    "step": (Step(0.5, 2.0, -1.0), lambda t: np.where(t < 0.5, -1.0, 2.0)),
    "ramp": (Ramp(0.5, 4.0, 1.0), lambda t: np.where(t < 0.5, 1.0, 1.0 + 4.0 * (t - 0.5))),
    "sine": (Sine(2.0, 10.0, 0.3), lambda t: 2.0 * np.sin(20 * np.pi * t + 0.3)),
    "record": (Recorded([0.5, 1.0, 2.0], [1.0, 3.0, -1.0]), lambda t: np.interp(t, [0.5, 1.0, 2.0], [1.0, 3.0, -1.0])),
    "sum": (
        Sine(2.0, 10.0) + Ramp(0.5, 4.0) + Constant(1.0),
        lambda t: 2.0 * np.sin(20 * np.pi * t) + 4.0 * np.maximum(t - 0.5, 0.0) + 1.0,
    ),
}


@pytest.mark.parametrize("name", PROFILES)
def test_profiles_are_what_they_say(name):
    profile, by_hand = PROFILES[name]
    assert np.allclose([float(profile.value(t)) for t in TIMES], by_hand(TIMES), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", ["step", "ramp", "record", "sum"])
def test_a_change_beyond_the_end_of_a_run_is_told(name):
    profile = PROFILES[name][0]
    (said,) = unreached(Scenario(rate=profile), 0.4)
    assert "of `scenario.rate` at 0.5 s lies beyond the end of the run at 0.4 s and never comes" in said
    assert unreached(Scenario(rate=profile), 0.6) == (), "it comes"
    assert "`scenario.offset_drift.1`" in unreached(Scenario(offset_drift=(Constant(), profile)), 0.4)[0]


def test_what_changes_nothing_is_not_missed():
    still = Step(0.5, 1.0, 1.0), Ramp(0.5, 0.0), Recorded([0.5, 1.0], [2.0, 2.0]), Sine(1.0, 1.0), Constant(1.0)
    assert [unreached(Scenario(rate=profile), 0.4) for profile in still] == [()] * 5
    assert jax.eval_shape(lambda at: len(unreached(Scenario(rate=Step(at, 1.0)), 0.4)) * at, 0.5).shape == ()


def test_chirp_integrates_its_frequency():
    """Frequency rises linearly and stays; the phase is its integral."""
    profile = Chirp(2.0, 1.0, 30.0, 1.0)
    for t in TIMES[::4]:
        turns, _ = quad(lambda s: min(1.0 + 29.0 * s, 30.0), 0.0, t, points=[1.0], limit=200)
        assert float(profile.value(t)) == pytest.approx(2.0 * np.sin(2 * np.pi * turns), abs=1e-9)


def test_the_variance_of_a_random_walk_grows_by_its_intensity():
    walks = RandomWalk(intensity=3.0, duration=0.4, start=1.0, realisation=np.arange(4000) / 4000, rows=40)
    for time in (0.1, 0.4, 9.0):
        levels = np.asarray(walks.value(time))
        variance = 3.0 * min(time, 0.4)
        assert np.mean(levels) == pytest.approx(1.0, abs=4 * np.sqrt(variance / 4000))
        assert np.var(levels) == pytest.approx(variance, rel=4 * np.sqrt(2 / 4000))


@given(st.floats(0.01, 1.9))
def test_spin_is_the_slope_of_the_rate(time):
    scenario = Scenario(rate=Sine(2.0, 10.0, 0.3) + Ramp(0.0, 5.0))
    inertial = scenario.at(time).inertial
    assert float(inertial.rate) == pytest.approx(2.0 * np.sin(20 * np.pi * time + 0.3) + 5.0 * time, abs=1e-12)
    slope = 40 * np.pi * np.cos(20 * np.pi * time + 0.3) + 5.0
    assert float(inertial.angular_acceleration) == pytest.approx(slope, abs=1e-9)


def test_everything_else_is_zero_unless_asked_for():
    conditions = Scenario().at(0.3)
    assert all(float(leaf) == 0.0 for leaf in jax.tree.leaves(conditions))


def test_each_profile_reaches_its_place():
    names = iter(range(1, 10))
    made = {
        "rate": Constant(next(names)),
        "offset_drift": tuple(Constant(next(names)) for _ in range(2)),
        "damping_change": tuple(Constant(next(names)) for _ in range(3)),
        "cross_rate": tuple(Constant(next(names)) for _ in range(2)),
    }
    seen = Scenario(**made, acceleration=(Constant(10.0), Constant(11.0))).at(0.1)
    inertial = seen.inertial
    assert float(inertial.rate) == 1
    assert [float(v) for v in seen.offset_drift] == [2, 3]
    assert [float(v) for v in inertial.damping_change] == [4, 5, 6]
    assert [float(v) for v in inertial.cross_rate] == [7, 8]
    assert [float(v) for v in inertial.acceleration] == [10, 11]
    assert float(inertial.angular_acceleration) == 0.0


def test_a_number_or_profile_is_a_scenario():
    assert float(as_scenario(2.0).at(0.0).inertial.rate) == 2.0
    assert float(as_scenario(Sine(1.0, 0.25)).at(1.0).inertial.rate) == pytest.approx(1.0)
    scenario = Scenario()
    assert as_scenario(scenario) is scenario


BAD = [
    (([0.0, 1.0], [1.0, float("nan")]), "finite numbers only; remove the rows with NaN"),
    (([0.0, float("inf")], [1.0, 2.0]), "finite numbers only"),
    (([0.0, 2.0, 1.0], [1.0, 2.0, 3.0]), r"must rise strictly, but row 3 \(1 s\) does not"),
    (([0.0, 0.0], [1.0, 2.0]), r"must rise strictly, but row 2 \(0 s\) does not"),
    (([0.0], [1.0]), "two equally long columns of at least 2 rows"),
    (([0.0, 1.0], [1.0, 2.0, 3.0]), "two equally long columns"),
    (([[0.0, 1.0]], [[1.0, 2.0]]), "two equally long columns"),
]


@pytest.mark.parametrize(("columns", "words"), BAD, ids=[words for _, words in BAD])
def test_bad_records_are_refused(columns, words):
    with pytest.raises(InputError, match=words):
        Recorded(*map(np.array, columns))


@pytest.mark.parametrize("duration", [0.0, -1.0, float("nan")])
def test_a_chirp_must_take_time(duration):
    with pytest.raises(InputError, match="`duration` must be positive"):
        Chirp(1.0, 1.0, 10.0, duration)


@pytest.mark.parametrize(
    "make",
    [
        lambda bad: Constant(bad), lambda bad: Step(0.5, bad), lambda bad: Step(bad, 1.0), lambda bad: Ramp(0.0, bad),
        lambda bad: Sine(1.0, bad), lambda bad: Constant(bad) + Constant(1.0), lambda bad: RandomWalk(1.0, 1.0, bad),
        lambda bad: Scenario(rate=Constant(bad)), lambda bad: Scenario(temperature=Constant(bad)), as_scenario,
    ],
)  # fmt: skip
def test_a_number_that_is_none_is_refused(make):
    with pytest.raises(InputError, match=r"^Argument `\w+` of a \w+ must be a number, but is NaN\.$"):
        make(float("nan"))
    make(1.0)


def test_a_step_may_never_come():
    assert Step(np.inf, 2.0, -1.0).value(1e9) == -1.0


def test_numbers_of_profiles_may_be_traced():
    def rate(level):
        return Scenario(rate=Constant(level) + Sine(level, 10.0)).at(0.3).inertial.rate

    assert jax.jit(rate)(2.0) == pytest.approx(float(rate(2.0)))
    assert jax.grad(rate)(2.0) == pytest.approx(float(rate(1.0)))
    assert np.isnan(jax.jit(rate)(np.nan))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"rate": 1.0}, "Argument `rate` must be a profile over time"),
        ({"rate": None}, "Argument `rate` must be a profile over time"),
        ({"temperature": 300.0}, "Argument `temperature` must be a profile over time"),
        ({"offset_drift": (1.0, 2.0)}, "Argument `offset_drift` must be a profile over time"),
        ({"offset_drift": Constant(1.0)}, "Argument `offset_drift` must be a tuple of 2 profiles"),
        (
            {"damping_change": (Constant(1.0),) * 2},
            "Argument `damping_change` must be a tuple of 3 profiles, but has 2",
        ),
    ],
)
def test_what_is_no_profile_is_refused(given, words):
    with pytest.raises(InputError, match=words):
        Scenario(**given)
