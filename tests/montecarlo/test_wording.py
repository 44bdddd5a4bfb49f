"""What a sweep prints of a rate that moves, of a bias, and where every die is lost."""

from dataclasses import replace

import pytest

import memsgyro_jax as mg
from memsgyro_jax.montecarlo.following import Following
from memsgyro_jax.montecarlo.merit import StraightError
from memsgyro_jax.montecarlo.wording import following_text, straight_entries, straight_text


SHORT = {"dies": 4, "sample_rate": 50e3, "duration": 4e-3, "chunk": 4}


def loop_of(travel: float = 1e-3) -> mg.ClosedLoop:
    """With a filter that estimates the motion and the rate alone: it compiles in a fraction of the time."""
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    known = tuple(name for name in gyro.model.names if name != "rate")
    observer = mg.ExtendedKalmanFilter.for_device(gyro, readout, known=known, with_offsets=False)
    return mg.ClosedLoop(gyro, readout, observer, mg.OpenLoop(), travel=travel)


@pytest.mark.slow
def test_the_error_of_a_moving_rate_is_no_bias_and_no_bound_is_told_with_its_reason():
    summary = mg.sweep(loop_of(), mg.Spread(), mg.Sine(amplitude=0.5, frequency=300.0), **SHORT).summary
    rows = dict(summary.rows())
    assert "bias, scale-factor error" not in rows
    assert rows["mean rate error"].endswith(
        "(over the dies, ± its standard error; the lag behind a moving rate is in it)"
    )
    reason = "none, as it is that of a constant rate on a constant device, but the rate moves"
    assert rows["information bound"] == reason
    assert "mean_error_dps" in summary.as_dict()
    assert "bias_dps" not in summary.as_dict()
    unasked = mg.sweep(loop_of(), mg.Spread(), mg.Sine(amplitude=0.5, frequency=300.0), bound_dies=0, **SHORT).summary
    assert "information bound" not in dict(unasked.rows())


def test_a_rate_that_has_come_to_rest_has_a_bias_and_many_dies_more_digits():
    summary = mg.sweep(loop_of(), mg.Spread(), mg.Step(at=1e-3, after=0.5), **SHORT).summary
    many = dict(replace(summary, dies=1_000_000, states=14, nees=13.94).rows())["consistency (NEES, NIS)"]
    assert "NEES 13.94 of 14 (99 %: 13.986 to 14.014;" in many
    assert "(mean over the dies ± its standard error)" in dict(summary.rows())["bias, scale-factor error"]
    assert "the rate moves" in dict(summary.rows())["information bound"], "it steps during the run"


@pytest.mark.slow
def test_where_every_die_is_lost_the_times_are_told_and_no_number_is():
    summary = mg.sweep(loop_of(travel=0.8e-6), mg.Spread(), **SHORT).summary
    rows = dict(summary.rows())
    assert rows["dies"].startswith("4, of which 4 lost")
    assert rows["rate error"] == "none, as every die was lost"
    times = summary.as_dict()["lost_at_s"]
    told = "{:.3g}, {:.3g}, {:.3g} ms: beyond 0.8 µm (`travel`), or not finite".format(*(1e3 * t for t in times))
    assert rows["  lost at (first, median, last)"] == told
    assert 0.0 < times[0] <= times[2] <= SHORT["duration"]
    assert "nan" not in repr(summary)


@pytest.mark.parametrize(("scale", "words"), [(None, "mean over the dies ± its"), (0.01, "line through the dies ±")])
def test_what_stands_behind_a_plus_minus_is_said(scale, words):
    error = StraightError(0.1, 0.01, scale, scale and 0.002)
    assert f"({words} standard error" in straight_text(error, moves=False)
    assert straight_entries(error, moves=False)["scale_factor_error"]["value"] == scale
    assert list(straight_entries(error, moves=True)) == ["mean_error_dps"]


def test_a_delay_longer_than_the_run_is_not_told():
    found = Following(0.1, 2e-3, (-0.395, 0.399), None, None)
    assert "delay not shown by this run," in following_text(found, 10e-3)
    assert "delay below 399 ms," in following_text(found, 1.0)
