"""One run kept sample by sample."""

import re
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest
from kept import kept

import memsgyro_jax as mg
from memsgyro_jax.app.report.run_summary import run_figures
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.montecarlo.parts import computation_of


mpl.use("agg")

TURN = mg.Step(at=5.003e-3, after=1.0)  # between the start of a sample and its middle


@pytest.fixture(scope="module")
def loop() -> mg.ClosedLoop:
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    known = ("kyy", "kxy", "dxx", "dyy", "dxy", "sigma")  # a smaller filter compiles faster
    observer = mg.ExtendedKalmanFilter.for_device(gyro, readout, annealing=mg.Annealing(), known=known)
    return mg.ClosedLoop(gyro, readout, observer, mg.DampingCompensation(mg.Tone(600.0, 53.95)))


@pytest.fixture(scope="module")
def trace(loop) -> mg.Trace:
    return mg.simulate(loop, TURN, sample_rate=100e3, duration=0.01, seed=3)


def test_a_trace_holds_the_whole_run(trace):
    assert trace.time[0] == pytest.approx(1e-5)
    assert trace.time[-1] == pytest.approx(0.01)
    assert len(trace.time) == 1000
    assert trace.lost_at is None
    assert "completed" in repr(trace)
    limited = mg.Saturated(trace.loop.controller, np.quantile(np.abs(trace.force), 0.9, axis=0))
    ended = replace(trace, loop=replace(trace.loop, controller=limited))
    assert re.search(r"completed, a force at its limit in 1\d(\.\d)? % of the samples", ended.status)
    middles = (np.arange(1000) + 0.5) * 1e-5
    np.testing.assert_array_equal(trace.rate_true, middles > 5.003e-3)
    assert np.max(np.abs(trace.motion[:, 0])) < 1.2e-6


def test_half_of_a_run_is_half_of_its_time_however_the_rows_stand(trace):
    """A run in blocks has most of its rows in the first blocks, whose start was told as the second half."""
    early = np.r_[np.arange(0, 400), np.arange(500, 1000, 50)]
    rows = replace(trace, **{
        name: getattr(trace, name)[early] for name in ("time", "rate_true", "rate_estimate", "rate_unfiltered", "nis")
    })  # fmt: skip
    late = np.degrees(trace.rate_error[500::50])
    assert f"mean {np.mean(late):.3g}, standard deviation {np.std(late):.3g}" in repr(rows)
    mean = np.average(trace.nis[early], weights=np.diff(trace.time[early], prepend=0.0))
    assert run_figures(rows, None)["nis_mean"] == pytest.approx(float(mean))


def test_a_device_from_a_file_runs_through_the_program_of_one_written_in_python(loop):
    read = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), loop)
    kinds = [[leaf.aval for leaf in jax.tree.leaves(made.sampled_at(100e3))] for made in (loop, read)]
    assert kinds[0] == kinds[1]


def test_a_step_that_never_comes_is_told(loop, caplog):
    mg.simulate(loop, mg.Step(at=0.6, after=1.0), sample_rate=100e3, duration=0.01, seed=3)
    assert "The step of `scenario.rate` at 0.6 s lies beyond the end of the run at 0.01 s" in caplog.text
    made = computation_of(
        loop, mg.Spread(), mg.Step(at=0.6, after=1.0), dies=2, sample_rate=100e3, duration=0.01, settle=None,
        tolerance=1.0, seed=0, chunk=None, bound_dies=0,
    )  # fmt: skip
    assert sum("never comes" in note for note in made.notes) == 1
    own = mg.Spread((mg.Vary("scenario.rate.at", mg.Uniform(low=1e-3, high=2e-3)),))
    made = computation_of(
        loop, own, mg.Step(at=0.6, after=1.0), dies=2, sample_rate=100e3, duration=0.01, settle=None, tolerance=1.0,
        seed=0, chunk=None, bound_dies=0,
    )  # fmt: skip
    assert not any("never comes" in note for note in made.notes), "every die has its own"


def test_decimation_keeps_every_nth_sample(loop, trace):
    thin = mg.simulate(loop, TURN, sample_rate=100e3, duration=0.01, seed=3, decimation=10)
    np.testing.assert_allclose(thin.rate_estimate, trace.rate_estimate[9::10], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(thin.volts, trace.volts[9::10], rtol=1e-12, atol=1e-15)


def test_noise_belongs_to_seed_and_die(loop, trace):
    again = mg.simulate(loop, TURN, sample_rate=100e3, duration=0.01, seed=3)
    assert again.volts.tobytes() == trace.volts.tobytes()
    for other in ({"seed": 4}, {"seed": 3, "die": 1}):
        volts = mg.simulate(loop, TURN, sample_rate=100e3, duration=0.01, **other).volts
        assert np.std(volts - trace.volts) > 1e-5


def test_the_voltage_is_the_motion_with_offset_and_noise(loop, trace):
    scale = np.array([float(s) for s in loop.readout.scale])
    noise = trace.volts - scale * trace.motion[:, :2] - trace.offset
    expected = float(loop.readout.noise_std(1e-5)[0])
    assert np.std(noise, axis=0) == pytest.approx([expected, expected], rel=0.08)


def test_a_trace_becomes_a_dataset_and_pictures(trace, tmp_path):
    data = kept(trace, tmp_path)
    assert data["volts"].attrs == {"units": "V", "long_name": "voltage of the read-out"}
    assert trace.to_pandas()["motion vy"].iloc[-1] == trace.motion[-1, 3]
    assert data["rate_estimate"].attrs["units"] == "rad/s"
    assert data.attrs["seed"] == 3
    for quantity in ("rate", "motion", "offset", "kxx"):
        assert trace.plot(quantity).get_xlabel() == "time [ms]"
    with pytest.raises(InputError, match="`nonsense`"):
        trace.plot("nonsense")
    mpl.pyplot.close("all")


def test_a_lost_die_says_when(loop):
    pushed = mg.simulate(
        mg.ClosedLoop(loop.device, loop.readout, loop.observer, mg.OpenLoop((mg.Tone(2893.0, 1e-3), ()))),
        0.0, sample_rate=100e3, duration=0.01,
    )  # fmt: skip
    assert pushed.lost_at is not None
    assert "lost" in pushed.status
    assert np.all(np.isfinite(pushed.motion))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"duration": 0.0}, "`duration`"),
        ({"duration": 1e-6}, "`duration`"),
        ({"sample_rate": 4e3}, "`sample_rate`"),
        ({"decimation": 0}, "`decimation`"),
    ],
)
def test_bad_settings_are_one_sentence(loop, arguments, words):
    with pytest.raises(InputError, match=words):
        mg.simulate(loop, 0.0, **{"sample_rate": 100e3, "duration": 0.01, **arguments})


@pytest.mark.slow
def test_a_drawn_lot_is_not_one_die(loop):
    lot = mg.Spread.relative("1 %").draw(loop, mg.Scenario(mg.Constant(1.0)), 0, np.arange(3)).loop
    with pytest.raises(InputError, match=r"one die, but holds 3 .* `sweep`, or map over that axis by `jax.vmap`"):
        mg.simulate(lot, 0.0, sample_rate=100e3, duration=0.01)


def test_float32_is_refused(loop):
    """As in a process that has not called `configure`."""
    with jax.enable_x64(False), pytest.raises(InputError, match=r"^simulate must run in float64, but .*float32"):
        mg.simulate(loop, 0.0, sample_rate=100e3, duration=1e-3)


def test_the_allan_deviation_of_a_trace(trace):
    """Of its output's error; white rates of 0.5 deg/√h in a trace's place read so, and a lost die is left out."""
    found = mg.allan(trace, start=5e-3)
    np.testing.assert_allclose(found.deviation[0, :2], mg.allan_deviation(trace.rate_error[500:], (1, 2)), rtol=1e-12)
    assert "1 s is not among" in found.terms[0]["arw_1s"].verdict
    noise = np.radians(0.5) / 60.0 * np.sqrt(100e3) * np.random.default_rng(1).standard_normal((2, 1000))
    several = eqx.tree_at(
        lambda t: (t.time, t.rate_true, t.rate_estimate, t.intact_until),
        trace,
        (np.stack([trace.time] * 2), np.zeros((2, 1000)), noise, np.array([np.inf, 2e-3])),
    )
    white = mg.allan(several)
    assert white.series == ("series 0",)
    assert "1 of 2 dies were lost" in white.notes[0]
    assert white.terms[0]["N"].low < 0.5 < white.terms[0]["N"].high
    assert white.terms[0]["N"].value == pytest.approx(0.5, rel=0.1)
