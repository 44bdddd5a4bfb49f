"""Rate-table tests of gyros that plain NumPy makes up: figures, their intervals, and what a test cannot tell."""

import json

import numpy as np
import pytest
from oracles.rate_table import back_to_zero, flicker, low_passed, rates_over_time

import memsgyro_jax as mg


RAMP = np.arange(500.0)
STEPS = (50.0, 100.0, 150.0, 200.0, 250.0, 300.0)


def log(path, header, *columns):
    np.savetxt(path, np.column_stack(columns), "%.9g", ",", header=header, comments="")
    return path


def automotive(seed=0, curve=500e-6, sample_rate=200.0):
    """±300 deg/s with 0.2 % of scale, 0.7 deg/s on average and 20 Hz, 5 mdeg/s/√Hz and flicker: time, rate, output."""
    rng = np.random.default_rng(seed)
    rate = rates_over_time(back_to_zero(*STEPS, *(-step for step in STEPS)), 4.0, sample_rate)
    time = np.arange(len(rate)) / sample_rate
    white = 0.005 * np.sqrt(sample_rate / 2.0) * rng.standard_normal(len(rate))
    output = low_passed(1.002 * rate + 0.7 + curve * 1.002 * rate**2 / 300.0 + white, 20.0, sample_rate)
    wander = flicker(rng, len(rate), sample_rate, 0.002)
    return time, rate + 0.002 * rng.standard_normal(len(rate)), output + wander - wander.mean()


@pytest.fixture(scope="module")
def raw(tmp_path_factory):
    path = tmp_path_factory.mktemp("table") / "raw.csv"
    return log(path, "t [s],table rate [deg/s],gyro [deg/s]", *automotive())


def held(figure, truth):
    return figure.low <= truth <= figure.high


def test_a_raw_log_of_an_automotive_gyro(raw):
    found = mg.scale_factor_test(raw)
    figures = found.figures
    assert len(found.rate) == 25
    assert held(figures["scale_factor"], 1.002)
    assert figures["scale_factor"].high - figures["scale_factor"].low < 2e-4
    assert held(figures["zero_rate_plateaus"], 0.7)
    assert held(figures["quadratic"], 500.0)
    assert figures["quadratic"].low > 400.0
    assert figures["cubic"].verdict == "within the noise"
    assert "of a curve" in figures["asymmetry"].verdict
    assert "off the line" in figures["zero_rate_plateaus"].verdict
    assert "settling" in found.notes[0]
    entries = json.loads(found.to_json())
    assert entries["schema"] == "memsgyro-scale-factor-test/1"
    assert entries["figures"]["scale_factor"]["unit"] == "1"
    table = found.to_xarray()
    assert table["rate"].attrs["units"] == "rad/s"
    assert "scale factor" in found._repr_html_()
    assert len(found.to_pandas()) == 25
    found.plot().figure.clear()


def rows(rate, output, unit="V", **more):
    """One row a plateau."""
    named = {name.replace("_", " "): values for name, values in more.items()}
    return {"table rate [deg/s]": np.asarray(rate), f"output [{unit}]": np.asarray(output), **named}


SWEEP = np.linspace(-300.0, 300.0, 13)
UP_DOWN = np.concatenate([SWEEP, SWEEP[-2::-1], SWEEP[1:], SWEEP[-2::-1]])


def around(rate, seed=0, noise=2e-5):
    """10 mV per deg/s about 2.5 V."""
    return 0.01 * np.asarray(rate) + 2.5 + noise * np.random.default_rng(seed).standard_normal(len(rate))


def test_intervals_hold_the_truth():
    """In 40 tests in volts with a walk of the bias and a curve, of which a plain line knows nothing."""
    mixed = np.array(back_to_zero(*np.random.default_rng(3).permutation(SWEEP[SWEEP != 0.0])))
    line = np.polyfit(mixed, 0.01 * mixed * (1.0 + 2e-4 * mixed / 300.0), 1)
    held_by = []
    for seed in range(40):
        walk = 3e-5 * np.cumsum(np.random.default_rng(100 + seed).standard_normal(len(mixed)))
        output = around(mixed, seed) + 0.01 * 2e-4 * mixed**2 / 300.0 + walk
        figures = mg.scale_factor_test(rows(mixed, output)).figures
        truth = {"scale_factor": line[0], "quadratic": 200.0, "cubic": 0.0}
        truth |= {"zero_rate_plateaus": 2.5 + walk.mean(), "zero_rate_line": 2.5 + line[1] + walk.mean()}
        held_by.append([held(figures[name], value) for name, value in truth.items()])
    assert np.all(np.mean(held_by, axis=0) >= 0.85)


def test_noise_is_not_read_as_nonlinearity():
    figures = mg.scale_factor_test(rows(UP_DOWN, around(UP_DOWN, noise=1e-3))).figures
    assert "within the noise, which alone makes up to" in figures["nonlinearity_max"].verdict
    assert figures["nonlinearity_max"].low == 0.0
    assert figures["asymmetry"].verdict == "within the noise"
    bent = mg.scale_factor_test(rows(UP_DOWN, around(UP_DOWN) - 0.01 * 3e-4 * UP_DOWN**3 / 300.0**2)).figures
    assert held(bent["cubic"], -300.0)
    assert bent["nonlinearity_max"].verdict in ("at -300 deg/s", "at 300 deg/s")


def test_a_kink_at_zero_is_asymmetry_and_a_curve_is_not():
    kinked = mg.scale_factor_test(rows(UP_DOWN, around(UP_DOWN) + 2e-6 * np.maximum(UP_DOWN, 0.0))).figures
    assert kinked["asymmetry"].verdict == "a kink at zero"
    assert held(kinked["asymmetry"], 200.0)
    bent = mg.scale_factor_test(rows(UP_DOWN, around(UP_DOWN) + 2e-6 * UP_DOWN**2 / 300.0)).figures
    assert bent["asymmetry"].verdict == "of a curve, not of a kink at zero"


def test_hysteresis_is_told_from_drift():
    sense = np.concatenate([[0.0], np.sign(np.diff(UP_DOWN))])
    figures = mg.scale_factor_test(rows(UP_DOWN, around(UP_DOWN) + 0.01 * 300.0 * 100e-6 * sense)).figures
    assert held(figures["hysteresis"], 200.0)
    assert figures["hysteresis"].verdict == ""
    drifting = around(UP_DOWN) + 0.01 * np.linspace(0.0, 0.1, len(UP_DOWN))
    figures = mg.scale_factor_test(rows(UP_DOWN, drifting, **{"t [min]": np.arange(len(UP_DOWN))})).figures
    assert figures["hysteresis"].verdict == "within the noise"
    assert held(figures["drift"], 0.1 * 60.0 / (len(UP_DOWN) - 1))
    assert figures["drift"].unit == "deg/s/h"


def test_a_monotone_sweep_cannot_tell_drift_from_scale_factor():
    drift = 0.01 * np.linspace(0.0, 0.3, 13)
    found = mg.scale_factor_test(rows(SWEEP, around(SWEEP) + drift))
    assert found.figures["scale_factor"].value == pytest.approx(0.01 * (1.0 + 500e-6), rel=2e-5)
    assert "any drift of the bias in it" in found.figures["scale_factor"].verdict
    assert found.figures["drift"].value is None
    assert "0.3 deg/s from begin to end would count as 500 ppm" in str(found)
    both = np.array(back_to_zero(*SWEEP[SWEEP != 0.0]))
    mended = mg.scale_factor_test(rows(both, around(both) + 0.01 * np.linspace(0.0, 0.3, len(both)))).figures
    assert held(mended["scale_factor"], 0.01)
    assert held(mended["drift"], 0.3)


def test_a_bent_drift_in_one_sweep_up_and_down_is_said_to_hide():
    once = np.concatenate([SWEEP, SWEEP[-2::-1]])
    warm = 0.005 * np.exp(-np.arange(25) / 5.0)
    found = mg.scale_factor_test(rows(once, around(once) + warm))
    assert "bent course, as in warm-up" in str(found)


def test_runs_and_what_a_mean_of_them_is_known_to():
    run = np.repeat([1, 2, 3, 4], len(UP_DOWN))
    rate, scale = np.tile(UP_DOWN, 4), np.array([0.0, 2e-4, -1e-4, 3e-4])[run - 1]
    bias = np.array([0.0, 0.02, -0.03, 0.01])[run - 1]
    found = mg.scale_factor_test(rows(rate, around(rate) + 0.01 * (scale * rate + bias), **{"run [1]": run}))
    assert found.runs == 4
    assert found.figures["scale_factor_repeatability"].value == pytest.approx(182.6, rel=0.03)
    assert found.figures["zero_rate_repeatability"].value == pytest.approx(0.0216, rel=0.05)
    assert held(found.figures["scale_factor"], 0.01 * (1.0 + 1e-4))
    assert found.figures["scale_factor"].high - found.figures["scale_factor"].low > 0.01 * 2e-4
    assert "of a mean of 4 runs" in str(found)
    same = mg.scale_factor_test(rows(rate, around(rate, 1), **{"run [1]": run})).figures
    assert "within the noise" in same["scale_factor_repeatability"].verdict


def test_temperatures_tell_sensitivities():
    celsius = np.repeat([-40.0, 25.0, 85.0], len(UP_DOWN))
    rate, warm = np.tile(UP_DOWN, 3), celsius - 25.0
    output = around(rate, 2) + 0.01 * (-100e-6 * warm * rate + 0.02 * warm)
    figures = mg.scale_factor_test(rows(rate, output, **{"T [degC]": celsius})).figures
    assert held(figures["zero_rate_temperature"], 0.02)
    assert held(figures["scale_factor_temperature"], -100.0 / (1.0 - 100e-6 * np.mean(warm)))
    assert figures["scale_factor_temperature"].high - figures["scale_factor_temperature"].low < 0.5


def test_a_warm_up_with_rates_that_grow_is_no_cubic_part_for_sure():
    """Temperature rises with time and the rates with both, so that its scale factor looks like a cubic."""
    rate = np.array(back_to_zero(*(sign * step for step in STEPS for sign in (1.0, -1.0))))
    warm = 8.0 * (1.0 - np.exp(-np.arange(len(rate)) / 15.0))
    found = mg.scale_factor_test(rows(rate, around(rate) - 0.01 * 80e-6 * warm * rate, **{"T [degC]": 25.0 + warm}))
    assert found.figures["scale_factor_temperature"].value is None
    assert found.figures["cubic"].verdict == "or a scale factor that drifts"
    assert "mix the order of the rates" in str(found)
    assert "Time and temperature run together" in str(found)


def test_what_few_rates_cannot_tell():
    two = mg.scale_factor_test(rows([-100.0, 100.0], [1.5, 3.5]))
    assert two.figures["scale_factor"].value == pytest.approx(0.01)
    assert np.isinf(two.figures["scale_factor"].high)
    assert two.figures["nonlinearity_max"].value is None
    assert two.figures["zero_rate_plateaus"].verdict == "no plateau at zero rate"
    assert "no interval is told" in str(two)
    assert json.loads(two.to_json())["figures"]["scale_factor"]["high"] is None
    side = mg.scale_factor_test(rows(SWEEP[7:], around(SWEEP[7:])))
    assert side.figures["asymmetry"].value is None
    assert "extrapolated" in side.figures["zero_rate_line"].verdict
    assert "All rates are positive or zero" in str(side)


def test_a_plateau_that_stands_alone_is_named():
    output = around(UP_DOWN)
    output[7] += 1e-3
    notes = " ".join(mg.scale_factor_test(rows(UP_DOWN, output)).notes)
    assert "plateau of 50 deg/s that begins in line 8" in notes
    assert "far off" not in " ".join(mg.scale_factor_test(rows(UP_DOWN, around(UP_DOWN))).notes)


def test_counts_of_any_unit_and_exact_numbers():
    found = mg.scale_factor_test(rows(UP_DOWN, 100.0 * UP_DOWN + 5.0, "LSB", **{"output std [LSB]": np.full(49, 2.0)}))
    assert found.figures["scale_factor"].unit == "LSB/(deg/s)"
    assert found.figures["nonlinearity_max"].value < 1e-6
    assert "within the noise" in found.figures["nonlinearity_max"].verdict
    assert found.figures["noise"].value == pytest.approx(0.02)
    assert found.to_xarray().attrs["output_unit"] == "LSB"


def test_a_gyro_upside_down_on_a_table_that_tells_turns_a_minute(tmp_path):
    """Its rate was taken for the output where the unit is 1/min, and its curve had the other sign."""
    turns = np.array([0.0, 10, -10, 20, -20, 30, -30, 40, -40, 50, -50, 0.0])
    true = -6.0 * turns
    output = 1.7 + true * (1.0 + 200e-6 * (true / 300.0) ** 2) + 1e-4 * np.cos(7.0 * np.arange(12))
    for header in ("Drehzahl [1/min],Ausgang [deg/s]", "speed [rev/min],gyro [deg/s]", "table [RPM],output [deg/s]"):
        found = mg.scale_factor_test(log(tmp_path / "turns.csv", header, turns, output))
        assert found.unit == "deg/s"
        np.testing.assert_allclose(found.rate, 2 * np.pi / 60 * turns)
        assert held(found.figures["cubic"], 200.0)
        assert found.figures["cubic"].low > 100.0
        assert "ppm off -1" in found.figures["scale_factor"].verdict
        assert "upside down" in " ".join(found.notes)
        assert "The rate is `" + header.split(" ")[0] in str(found)


@pytest.mark.parametrize(
    ("source", "options", "words"),
    [
        ({"t [s]": [0, 1], "a [V]": [1, 2]}, {}, "table rate.*none can be told"),
        ({"rate [deg/s]": [0, 1], "a [V]": [1, 2], "b [V]": [1, 2]}, {}, "`a`, `b` may all be it.*--output-column"),
        ({"x [deg/s]": [0, 1], "y [deg/s]": [1, 2]}, {}, "--rate-column"),
        ({"rate [deg/s]": [0, 1], "output [V]": [1, 2]}, {"output_column": "outptu"}, "did you mean `output`"),
        ({"rate [deg/s]": [0, 1], "output [V]": [1, 2]}, {"settle": "1 s"}, "one row a plateau"),
        ({"rate [deg/s]": [0, 1], "output [V]": [1, 2], "T [C]": [1, 2]}, {}, "degC"),
        ({"rate [deg/s]": [1, 1], "output [V]": [1, 2]}, {}, "two rates or more"),
        ({"rate [deg/s]": [0, 1], "output [V]": [1, 1]}, {}, "must follow the rate"),
        ({"rate [deg/s]": np.arange(500.0), "output [V]": np.arange(500.0)}, {}, "must have times"),
        ({"t [s]": RAMP, "rate [deg/s]": RAMP, "output [V]": RAMP}, {}, "rates that stand still"),
        ({"rate [deg/s]": [0, 1], "output [V]": [1, 2]}, {"full_scale": 0.0}, "full_scale"),
        ({"t [s]": [0, 0], "rate [deg/s]": [0, 1], "output [V]": [1, 2]}, {}, "line 2.*behind"),
        ({"rate [deg/s]": [0, np.nan], "output [V]": [1, 2]}, {}, "finite numbers"),
        (3.0, {}, "must be a file"),
    ],
)
def test_unusable_tests_are_refused(source, options, words):
    with pytest.raises(mg.InputError, match=words):
        mg.scale_factor_test(source, **options)


def test_an_output_of_another_axis_and_numbers_of_plateaus():
    noise = np.random.default_rng(0).standard_normal(len(UP_DOWN))
    found = mg.scale_factor_test(rows(UP_DOWN, noise))
    assert "does not follow the rate" in found.status
    assert "nonlinearity_max" not in found.figures
    numbered = mg.scale_factor_test(rows(UP_DOWN, around(UP_DOWN), **{"sequence [1]": np.arange(len(UP_DOWN))}))
    assert numbered.runs == 1
    assert "tells no runs" in str(numbered)


def test_samples_that_are_missing_within_a_plateau_are_refused():
    time, rate, output = automotive()
    keep = np.ones(len(time), bool)
    keep[300:340] = False
    with pytest.raises(mg.InputError, match=r"line 301, column `t`.*are rows missing"):
        mg.scale_factor_test({"t [s]": time[keep], "table rate [deg/s]": rate[keep], "gyro [deg/s]": output[keep]})


def test_a_table_that_lags_its_command_is_settling():
    """The column is what was asked for; the table takes 6 s for the greatest step."""
    sequence, sample_rate = (0.0, 100.0, -100.0, 200.0, -200.0, 300.0, -300.0, 0.0, 150.0, 0.0), 20.0
    command, rate, at = np.repeat(sequence, 400), [], 0.0
    for wanted in command:
        at += np.clip(wanted - at, -5.0, 5.0)
        rate.append(at)
    output = 1.001 * np.array(rate) + 0.02 * np.random.default_rng(0).standard_normal(len(rate))
    source = {"t [s]": np.arange(len(rate)) / sample_rate, "command [deg/s]": command, "gyro [deg/s]": output}
    found = mg.scale_factor_test(source)
    assert held(found.figures["scale_factor"], 1.001)
    assert held(found.figures["nonlinearity_max"], 0.0)


def test_rows_with_times_are_no_raw_log():
    """Whose rate changes from row to row; all rows were taken for one plateau."""
    rate = np.array(back_to_zero(*np.random.default_rng(0).permutation(SWEEP[SWEEP != 0.0])))
    found = mg.scale_factor_test(rows(rate, around(rate), **{"t [min]": np.arange(len(rate))}))
    assert len(found.rate) == len(rate)
    assert held(found.figures["scale_factor"], 0.01)


def test_small_steps_of_a_command_and_averages_of_a_second():
    """Half a degree among 300, and ten rows a plateau."""
    steps = (0.0, 0.5, 0.0, -0.5, 0.0, 300.0, 0.0, -300.0, 0.0)
    rate = np.repeat(steps, 12)
    noise = 1e-3 * np.random.default_rng(4).standard_normal(len(rate))
    source = {"t [s]": np.arange(len(rate)), "table rate [deg/s]": rate, "gyro [deg/s]": rate + noise}
    found = mg.scale_factor_test(source)
    np.testing.assert_allclose(np.degrees(found.rate), steps, atol=1e-9)
    assert held(found.figures["scale_factor"], 1.0)


def test_settling_is_left_out_as_long_as_it_takes():
    """A pole of 0.5 Hz: e-fold in 0.32 s, a millionth of a step after 4.4 s of plateaus of 20 s."""
    rng, sample_rate = np.random.default_rng(5), 50.0
    rate = rates_over_time(back_to_zero(100.0, -100.0, 200.0, -200.0), 20.0, sample_rate)
    output = low_passed(rate + 0.05 * rng.standard_normal(len(rate)), 0.5, sample_rate)
    source = {"t [s]": np.arange(len(rate)) / sample_rate, "table rate [deg/s]": rate, "gyro [deg/s]": output}
    found = mg.scale_factor_test(source)
    left = float(found.notes[0].split(" and ")[-1].split(" s ")[0])
    assert 3.0 < left < 6.0
    assert held(found.figures["scale_factor"], 1.0)
    assert held(found.figures["nonlinearity_max"], 0.0)
    short = mg.scale_factor_test(source, settle=0.1)
    assert (
        not held(short.figures["scale_factor"], 1.0)
        or short.figures["scale_factor"].high > found.figures["scale_factor"].high
    )
    slow = dict(source, **{"gyro [deg/s]": low_passed(rate, 0.05, sample_rate)})
    assert "does not settle" in str(mg.scale_factor_test(slow))


ONCE = [*np.linspace(-300.0, 300.0, 9), *np.linspace(225.0, -300.0, 8)]
BACK = back_to_zero(*STEPS, *(-step for step in STEPS))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sequence", "strength", "walk", "warm"),
    [
        (BACK, 0.0, 0.0, 0.0),
        (BACK, 0.005, 0.0, 0.0),
        (BACK, 0.0, 0.002, 0.0),
        (BACK, 0.001, 0.0, 0.05),
        ([*ONCE, *ONCE[1:]], 0.002, 0.0, 0.0),
        (ONCE, 0.0, 0.002, 0.0),
    ],
    ids=["white", "flicker", "walk", "warm-up", "two sweeps", "one sweep"],
)
def test_intervals_of_raw_logs_hold_the_truth(sequence, strength, walk, warm):
    """In 100 logs each behind a filter of 20 Hz, with a quadratic and a cubic part."""
    sample_rate, held_by = 200.0, []
    at = np.array(sequence)
    curve = lambda rate: 1.002 * (rate + 3e-4 * rate**2 / 300.0 - 2e-4 * rate**3 / 300.0**2)  # noqa: E731
    rate = rates_over_time(sequence, 4.0, sample_rate)
    time = np.arange(len(rate)) / sample_rate
    line = np.polyfit(at, curve(at), 1)
    powers = np.polyfit(at / 300.0, curve(at), 3) / (300.0 * line[0]) * 1e6
    largest = np.max(np.abs(curve(at) - np.polyval(line, at))) / (300.0 * line[0]) * 1e6
    truth = {"scale_factor": line[0], "quadratic": powers[1], "cubic": powers[0], "nonlinearity_max": largest}
    for seed in range(100):
        rng = np.random.default_rng(seed)
        white, steps = rng.standard_normal((2, len(rate)))
        output = low_passed(curve(rate) + 0.7 + 0.005 * np.sqrt(sample_rate / 2.0) * white, 20.0, sample_rate)
        output += flicker(rng, len(rate), sample_rate, strength) + warm * np.exp(-time / 40.0)
        output += walk * np.cumsum(steps) / np.sqrt(sample_rate)
        source = {"t [s]": time, "table rate [deg/s]": rate, "gyro [deg/s]": output}
        figures = mg.scale_factor_test(source).figures
        held_by.append([held(figures[name], value) for name, value in {**truth, "hysteresis": 0.0}.items()])
    assert np.all(np.mean(held_by, axis=0) >= 0.89), np.mean(held_by, axis=0)
