"""The figures of a datasheet against linear algebra of the same dies, and what it must not claim."""

import json
import re
from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest
from oracles import classic

import memsgyro_jax as mg
from memsgyro_jax.app.report.datasheet_page import datasheet_page
from memsgyro_jax.loop.noise_budget import thermal_left_out
from memsgyro_jax.loop.settling import settling_time_constant
from memsgyro_jax.measurement.bandwidth_cause import knobs, limits
from memsgyro_jax.measurement.datasheet import _rate_left_out, at_rest, impossible_ends, notes_of, step_told, unsettled
from memsgyro_jax.measurement.datasheet_rows import NOT_MODELLED, DatasheetRow
from memsgyro_jax.measurement.datasheet_tests import Answer, best_line, noises, start_up, with_trim
from memsgyro_jax.measurement.lot_outputs import Outputs, lot_outputs
from memsgyro_jax.measurement.rate_tests import RateTests
from memsgyro_jax.montecarlo.parts import computation_of


RATE, DIES, DENSITY = 100e3, 4, 1e-7
GYRO = mg.SingleMassGyro.from_modes(1e-8, (5e3, 5.3e3), (400.0, 200.0), quadrature=np.radians(30.0), cross_damping=1e-3)
READOUT = mg.DirectReadout(1e5, noise_density=DENSITY)
CONTROL = mg.ClassicControl.open_loop(GYRO, READOUT, amplitude=1e-6, bandwidth=60.0, drive_bandwidth=400.0)
LOOP = mg.ClosedLoop(GYRO, READOUT, mg.NoObserver.for_device(GYRO, READOUT), CONTROL, start=(0.0,) * 4)
SPREAD = mg.Spread.relative(0.002)


@pytest.fixture(scope="module")
def sheet():
    return mg.datasheet(
        LOOP, SPREAD, full_scale="200 deg/s", dies=DIES, sample_rate=RATE, duration=0.2, settle=0.15,
        noise_duration=4.0, trim=True, seed=3,
    )  # fmt: skip


@pytest.fixture(scope="module")
def dies():
    drawn = SPREAD.draw(LOOP.sampled_at(RATE, duration=0.2), mg.Scenario(), 3, np.arange(DIES)).loop.device
    return [jax.tree.map(lambda leaf, n=n: np.broadcast_to(leaf, DIES)[n], drawn) for n in range(DIES)]


def test_zero_rate_output_scale_factor_and_quadrature_are_those_of_the_dies(sheet, dies):
    conversion, near = complex(*map(float, CONTROL.sense.conversion)), float(CONTROL.drive.frequency)

    def steady(gyro, rate):
        lock = near * np.sqrt(float(gyro.kxx * GYRO.mass / gyro.mass / GYRO.kxx))
        return classic.steady(gyro, rate, 1.0 / RATE, 1e-6, conversion, False, lock, velocity=False)[2:]

    full = np.radians(200.0)
    still = np.array([steady(gyro, 0.0) for gyro in dies])
    slope = np.array([(steady(g, full)[0] - steady(g, -full)[0]) / (2.0 * full) for g in dies])
    assert sheet.lost == 0
    assert sheet.row("zero-rate output").values == pytest.approx(np.degrees(still[:, 0]), abs=1e-4)
    assert sheet.row("quadrature").values == pytest.approx(np.degrees(still[:, 1]), abs=1e-4)
    assert sheet.row("scale factor").values == pytest.approx(slope, abs=1e-6)
    assert np.ptp(slope) > 1e-2
    assert sheet.row("scale factor").trimmed == pytest.approx(1.0, abs=1e-5)
    assert sheet.row("zero-rate output").trimmed == pytest.approx(0.0, abs=1e-4)


def answer(frequency, control=CONTROL):
    plain = mg.SingleMassGyro.from_modes(1e-8, (5e3, 5.3e3), (400.0, 200.0))
    return classic.rate_response(plain, 2.0 * np.pi * float(control.drive.frequency), 1.0 / RATE, control, frequency)


def half_power(control):
    at = np.linspace(40.0, 120.0, 401)
    return at[np.argmax(np.abs([answer(f, control) for f in at]) < np.sqrt(0.5) * abs(answer(1e-2, control)))]


def test_bandwidth_delay_and_noise_are_those_of_theory(sheet):
    assert np.median(sheet.row("bandwidth").values) == pytest.approx(half_power(CONTROL), rel=0.02)
    delay = -np.angle(answer(0.1) / answer(1e-2)) / (2.0 * np.pi * 0.09)
    assert np.median(sheet.row("group delay").values) == pytest.approx(1e3 * delay, rel=0.03)
    # Both products of the demodulation carry the noise: twice its power, turned into rate by the conversion.
    per_volt = abs(complex(*map(float, CONTROL.sense.conversion))) / 1e5
    density = np.degrees(np.sqrt(2.0) * DENSITY * per_volt)
    found = sheet.row("noise density").values
    assert np.mean(found) == pytest.approx(density, rel=0.1)
    walk = sheet.row("angle random walk").values
    assert np.nanmean(walk) == pytest.approx(60.0 * density / np.sqrt(2.0), rel=0.15)


def test_the_cause_of_the_bandwidth_is_named_with_what_it_does(sheet):
    """Against the theory of the same step."""
    found = re.search(
        r"set by `bandwidth` of the demodulator: a fifth more turns (\S+) Hz into (\S+) Hz", sheet.notes[0]
    )
    before, after = map(float, found.groups())
    assert before == pytest.approx(np.median(sheet.row("bandwidth").values[:3]), rel=1e-3)
    more = eqx.tree_at(lambda c: c.sense.demodulator.bandwidth, CONTROL, 72.0)
    assert after / before == pytest.approx(half_power(more) / half_power(CONTROL), rel=0.02)


def test_a_walk_that_no_allan_deviation_tells_is_that_of_the_density(sheet):
    """White noise of one rad/s at 400 Hz."""
    rate = np.random.default_rng(0).standard_normal((DIES, 4000))
    run = Outputs(rate, np.full_like(rate, np.nan), np.ones(DIES, bool), 1.0 / 400)
    bench = RateTests(lambda s: run, lambda *_: run, lambda *_: [run], LOOP, mg.Scenario(), 1.0, 0.0, 10.0, RATE)
    answer = Answer(np.arange(4.0), rate, run.alive, np.full(DIES, 8.0), "")
    density, walk, instability = noises(bench, answer, 10.0)
    assert np.mean(walk.values) == pytest.approx(60.0 * np.degrees(np.sqrt(1.0 / 400)), rel=0.15)
    np.testing.assert_allclose(walk.values, 60.0 / np.sqrt(2.0) * density.values)
    assert "density/√2" in walk.note
    assert not density.note
    assert "too short" in instability.missing
    assert not sheet.row("angle random walk").note, "an Allan deviation tells it there"


def test_what_a_model_cannot_give_says_so(sheet):
    reasons = {row.name: row.reason for row in sheet.rows}
    for name in ("sensitivity to acceleration, x", "cross-axis sensitivity, y", "scale factor over temperature"):
        assert reasons[name].startswith(NOT_MODELLED)
        assert sheet.row(name).as_dict()["before_trim"] is None
    assert "falls to its end" in reasons["bias instability"]
    written = json.loads(json.dumps(sheet.as_dict(), allow_nan=False))
    assert written["schema"] == "memsgyro-datasheet/1"
    assert "not modelled" in repr(sheet)
    page = datasheet_page(sheet, mg.default_study()).html()
    assert page.count("<svg") == 2
    assert all(row.definition in page for row in sheet.rows if "'" not in row.definition)


def test_figures_of_a_start_are_not_given_without_a_word(sheet):
    assert not any("have not started" in note for note in sheet.notes)
    bench = RateTests.of("sheet", LOOP, SPREAD, 0.0, full_scale=1.0, dies=3, sample_rate=RATE, duration=0.2,
                         settle=0.1, seed=0)  # fmt: skip
    row = DatasheetRow("start-up time", "s", "", "", np.array([0.02, 0.15, np.nan, np.nan]))
    (lost, late, *_) = notes_of(np.array([True, True, True, False]), row, bench)
    assert lost.startswith("1 of 4")
    assert late.startswith("2 of 4 dies have not started by 0.1 s")
    assert re.search(r'`duration = "0.\d+ s"` in the study\'s `\[sweep\]` should do; they are left out', late)
    rest = np.array([True, False, False, False])
    (held,) = at_rest((replace(row, missing=""),), rest, unsettled(np.ones(4, bool), row, bench))
    assert held.reason == "not settled: a note says when it would be"
    assert np.isfinite(held.values).tolist() == rest.tolist()
    (kept,) = at_rest((replace(row, values=np.ones(4)),), ~rest, "some have not")
    assert not kept.missing, "three dies tell it"
    assert (kept.over_dies.dies, np.isnan(kept.values).tolist()) == (3, rest.tolist())
    settled = Answer(np.zeros(1), np.zeros((2, 1)), np.ones(2, bool), np.full(2, np.nan), "it does not settle")
    still = Outputs(*(np.random.default_rng(0).normal(size=(2, 400)),) * 2, np.ones(2, bool), 1e-3)
    rows = noises(replace(bench, noisy=lambda *_: still), settled, 0.4)
    assert all("it does not settle" in row.reason for row in rows)
    assert rows[1].reason.endswith("deg/√h of the design by the closed form (`noise_budget`)")


def test_a_sweep_of_a_loop_that_is_still_starting_says_so():
    """The sense mode rings with 2 Q/ω behind an open loop, longer than any filter of it."""
    ring = 2.0 * 200.0 / (2.0 * np.pi * 5.3e3)
    assert settling_time_constant(LOOP) == pytest.approx(ring, rel=0.03)

    def notes(loop, duration):
        return computation_of(
            loop, SPREAD, 0.0, dies=3, sample_rate=RATE, duration=duration, settle=None, tolerance=1.0, seed=0,
            chunk=None, bound_dies=0,
        ).notes  # fmt: skip

    (note,) = notes(LOOP, 2.0 * ring)
    assert "time constant of 0.012 s" in note
    assert notes(LOOP, float(re.search(r"`duration` of ([\d.]+) s", note)[1])) == ()
    assert not any("time constant" in note for note in notes(mg.default_study().loop, 1e-3)), "no classic control"


def test_percents_below_any_meaning_are_told_as_a_bound():
    tiny = DatasheetRow("cross-axis sensitivity, x", "%", "", "", np.array([-6e-9, 1e-9, 2e-9]))
    assert "< 0.001" in tiny.cells(tiny.over_dies)
    assert tiny.as_dict()["before_trim"]["least"] == -6e-9, "the file keeps the number"
    shown = replace(tiny, values=np.array([0.0, 1e-9, 2e-3]))
    assert "< 0.001" not in shown.cells(shown.over_dies)


def test_an_interval_that_passes_what_a_die_can_be_is_told():
    def row(name, values, positive=True):
        return DatasheetRow(name, "1", "", "", np.array(values), positive=positive)

    told = impossible_ends((row("a", [0.1, 0.1, 5.0]), row("b", [3.0, 3.1, 3.2]), row("c", [-1.0, 1.0, 9.0], False)))
    assert [sentence.startswith("The 95 % interval of a passes zero") for sentence in told] == [True]
    assert impossible_ends((row("b", [3.0, 3.1, 3.2]),)) == ()


def test_a_lost_die_spoils_no_other():
    rates = np.linspace(-1.0, 1.0, 9)
    outputs = np.stack([0.1 + 2.0 * rates, np.full(9, np.nan)], axis=1)
    assert best_line(rates, outputs)[:, 0] == pytest.approx([0.1, 2.0])
    trimmed = with_trim((DatasheetRow("scale factor", "1", "", "", np.array([2.0, np.nan])),), rates, outputs, 1.0)
    np.testing.assert_allclose(trimmed[0].trimmed, [1.0, np.nan])


def test_settings_that_cannot_be_run():
    with pytest.raises(mg.InputError, match="`full_scale` must be positive"):
        mg.datasheet(LOOP, SPREAD, full_scale=0.0)
    with pytest.raises(mg.InputError, match="`settle` must lie within"):
        mg.datasheet(LOOP, SPREAD, settle=3.0)
    for held in ((298.15,), (0.0, 298.15)):
        with pytest.raises(mg.InputError, match="`temperatures` must hold two or more"):
            mg.datasheet(LOOP, SPREAD, temperatures=held)


@pytest.mark.parametrize(
    ("power", "settle", "words"),
    [
        (lambda t: np.exp(-8.0 * t), 0.0, "power falls to 1/.*still rings"),
        (lambda t: np.exp(8.0 * t), 0.0, "power rises to .*still rings"),
        (np.ones_like, 0.9, "too short.*of the design by the closed form"),
    ],
)
def test_a_loop_without_observer_blames_none(power, settle, words):
    """And where the record does not tell the walk, the closed form stands beside."""
    time = np.linspace(0.0, 1.0, 400)
    rate = np.sqrt(power(time)) * np.random.default_rng(0).standard_normal((DIES, 400))
    run = Outputs(rate, np.full_like(rate, np.nan), np.ones(DIES, bool), 1.0 / 400)
    bench = RateTests(lambda s: run, lambda *_: run, lambda *_: [run], LOOP, mg.Scenario(), 1.0, settle, 1.0, RATE)
    _, walk, _ = noises(bench, Answer(time, rate, run.alive, np.full(DIES, 60.0), ""), 1.0)
    assert "observer" not in walk.missing
    assert not np.isfinite(walk.values).any()
    reason = re.search(words, walk.missing)
    assert reason
    said = float(re.search(r"([\d.e-]+) deg/√h of the design", walk.missing)[1])
    assert said == pytest.approx(60.0 * np.degrees(float(mg.noise_budget(LOOP, sample_rate=RATE).total)), rel=1e-3)


def test_an_output_that_still_creeps_at_the_end_has_no_start_up_time():
    """Its distance to the end of the record falls below any band, whatever it creeps to."""
    time = np.linspace(0.0, 1.0, 400)
    rate = np.tile(1.0 - np.exp(-2.0 * time), (DIES, 1))
    run = Outputs(rate, rate, np.ones(DIES, bool), 1.0 / 400)
    bench = RateTests(lambda s: run, lambda *_: run, lambda *_: [run], LOOP, mg.Scenario(), 1.0, 0.5, 1.0, RATE)
    row = start_up(bench, run)
    assert not np.isfinite(row.values).any()
    assert "not come to rest" in row.reason


@pytest.mark.parametrize("bandwidth", [20.0, 90.0, pytest.param(700.0, marks=pytest.mark.slow)])
def test_a_bandwidth_is_that_of_the_output_whatever_the_windows(bandwidth):
    """In 400 windows of a second, in which what is fast folds back, and finer ones where it must be looked at."""
    decay, finest = 2.0 * np.pi * bandwidth, []

    def bench_of(windows):
        edges = np.linspace(0.0, 1.0, windows + 1)
        since = np.maximum(edges - 0.5, 0.0)
        risen = windows * np.diff(since + np.expm1(-decay * since) / decay)

        def run(scenario):
            finest.append(windows)
            turned = float(scenario.rate.value(1.0) - scenario.rate.value(0.0))
            rate = np.tile(turned * risen, (DIES, 1))
            return Outputs(rate, rate, np.ones(DIES, bool), 1.0 / windows)

        finer = lambda: bench_of(10 * windows)  # noqa: E731
        return RateTests(run, None, None, LOOP, mg.Scenario(), 1.0, 0.5, 1.0, RATE, finer)

    bench = bench_of(400)
    used, _, (row, delay) = step_told(bench, bench.run(bench.at(0.0)), lambda sentence: None)
    np.testing.assert_allclose(row.values, bandwidth, rtol=0.015)
    np.testing.assert_allclose(delay.values, 1e3 / decay, rtol=0.01)
    assert max(finest) == {20.0: 400, 90.0: 4000, 700.0: 40_000}[bandwidth]
    assert (used is bench) is (bandwidth == 20.0)


def test_an_output_near_zero_has_not_started():
    rate = np.full((DIES, 400), 1e-3)
    run = Outputs(rate, rate, np.ones(DIES, bool), 1.0 / 400)
    bench = RateTests(lambda s: run, lambda *_: run, lambda *_: [run], LOOP, mg.Scenario(), 1.0, 0.5, 1.0, RATE)
    assert "shows 0.1 % of the rate" in start_up(bench, run).reason


def test_a_filter_that_takes_the_rate_for_constant_is_told_so():
    """And every kind of number that may be a cause is found in its loop, coefficients by name."""
    answer = Answer(
        np.arange(4.0), np.zeros((DIES, 4)), np.ones(DIES, bool), np.full(DIES, np.nan), "it does not settle"
    )
    bench = RateTests(None, None, None, mg.default_study().loop, mg.Scenario(), 1.0, 0.0, 1.0, RATE)
    (note,) = limits(bench, answer)
    assert note.startswith("No bandwidth: `observer.process_noise.rate` is zero")
    filtered = replace(LOOP, filter=mg.Lowpass(100.0))
    assert list(knobs(filtered)) == ["`bandwidth` of the demodulator", "`bandwidth` of the output filter"]


def test_a_record_of_noise_that_ends_before_it_counts_is_refused():
    """It was "stationary noise: its power rises to nan times", below three warnings of NumPy."""
    with pytest.raises(mg.InputError, match=r"^Argument `noise_duration` must be 0\.055 s or more, .* but is 0\.05 s"):
        mg.datasheet(LOOP, SPREAD, dies=3, sample_rate=RATE, duration=0.1, noise_duration=0.05)


@pytest.mark.slow
def test_no_noise_is_none_of_the_mass_either():
    """The thermomechanical force shook the runs "without noise", and a spread of a noise was refused there."""
    loop = LOOP.sampled_at(RATE, duration=2e-3)
    warm = replace(loop, device=GYRO.at_temperature(300.0))
    noise = (
        mg.Vary("readout.noise_density.0", mg.Normal(relative=0.1)), mg.Vary("device.temperature", mg.Normal(std=5.0))
    )  # fmt: skip
    still = tuple(mg.Vary(f"device.{name}", mg.Normal()) for name in ("mass", "kyy"))  # as many numbers, none moved
    own, joint = (mg.Vary("device.kxx", mg.Normal(relative=1e-3)),), ((1.0, 0.5, 0.2), (0.5, 1.0, 0.0), (0.2, 0.0, 1.0))
    settings = {"dies": 3, "seed": 0, "sample_rate": RATE, "windows": 4, "window": 50}
    scenario = mg.Scenario(rate=mg.Constant(1.0))
    quiet = lot_outputs(warm, mg.Spread(noise + own, joint), scenario, silent=True, **settings)
    cold = lot_outputs(loop.silent, mg.Spread(still + own, joint), scenario, **settings)
    assert np.array_equal(quiet.rate, cold.rate)
    kept = mg.Spread(noise + own, joint).of_silent
    assert [item.path for item in kept.items] == ["device.kxx"]
    assert kept.correlation == ((1.0,),)


def test_a_spread_of_the_rate_is_left_out_of_tests_that_set_it():
    own = (mg.Vary("device.kxx", mg.Normal(relative=1e-3)),)
    rates = (mg.Vary("scenario.rate.level", mg.Uniform(low=-1.0, high=1.0)),)
    settings = {"full_scale": "200 deg/s", "dies": 3, "sample_rate": RATE, "duration": 0.02, "settle": 0.01, "seed": 0}
    both, alone = (RateTests.of("x", LOOP, mg.Spread(items), **settings, scenario=0.0) for items in (own + rates, own))
    ran = [bench.run(bench.at(1.0)).rate for bench in (both, alone)]
    assert np.array_equal(*ran)
    assert _rate_left_out(mg.Spread(own)) == ()
    assert "`scenario.rate.level`" in _rate_left_out(mg.Spread(own + rates))[0]


@pytest.mark.slow
def test_a_converter_has_no_dead_band_where_there_is_no_noise():
    """A rebalanced axis sat still within a step: 45 in place of 49.5 deg/s at rest, of a design that noise dithers."""
    control = mg.ClassicControl.force_rebalance(GYRO, READOUT, amplitude=1e-6, drive_bandwidth=400.0)
    loop = replace(LOOP, controller=control)
    coarse = replace(loop, readout=replace(READOUT, adc=mg.Adc(0.5, 15)))
    settings = {"full_scale": "200 deg/s", "dies": 3, "sample_rate": RATE, "duration": 0.2, "settle": 0.15}
    fine, rounded = (mg.datasheet(one, SPREAD, noise_duration=0.4, **settings) for one in (loop, coarse))
    for a, b in zip(fine.rows, rounded.rows, strict=True):
        if a.name in ("zero-rate output", "scale factor", "non-linearity", "bandwidth"):
            np.testing.assert_allclose(b.values, a.values, rtol=1e-9, atol=1e-12)
    assert any("without the steps of the converter" in note for note in rounded.notes)
    assert not any("converter" in note for note in fine.notes)


def test_a_device_without_temperature_is_told_what_its_datasheet_leaves_out(sheet):
    said = [note for note in sheet.notes if "thermomechanical" in note]
    assert len(said) == 1
    density = float(re.search(r"at 300 K it would be ([0-9.e-]+) deg/s/√Hz", said[0])[1])
    gyro = GYRO.at_temperature(300.0)
    warm = mg.noise_budget(replace(LOOP, device=gyro), sample_rate=RATE).of("Brownian force")
    assert density == pytest.approx(np.degrees(np.sqrt(2.0) * float(warm)), rel=5e-3)
    assert thermal_left_out(replace(LOOP, device=gyro)) == ""
    assert thermal_left_out(LOOP, least=100.0) == ""
