"""The output filter is part of the loop: its output is what a run, a sweep and a command call the rate."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.app.commands.simulate import simulate_command
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.transforms import Free, Log, fixed, from_vector, mark, to_vector
from memsgyro_jax.loop import noise
from memsgyro_jax.loop.observers import Clock
from memsgyro_jax.loop.scenario import as_scenario


GYRO, READOUT = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
RUN = {"sample_rate": 100e3, "duration": 0.004, "seed": 3}
BAND = mg.Bandpass(200.0, 3000.0, 2)


def closed(filter_=None) -> mg.ClosedLoop:
    prior = mg.design_prior(GYRO)
    prior = eqx.tree_at(lambda p: p.theta[0], prior, jnp.asarray(0.5))  # a filter that starts at zero would show
    known = tuple(name for name in GYRO.model.names if name != "rate")  # a smaller filter compiles faster
    observer = mg.ExtendedKalmanFilter.for_device(GYRO, READOUT, prior=prior, annealing=mg.Annealing(), known=known)
    return mg.ClosedLoop(GYRO, READOUT, observer, mg.DampingCompensation(mg.Tone(600.0, 53.95)), filter=filter_)


@pytest.fixture(scope="module")
def plain() -> mg.Trace:
    return mg.simulate(closed(), 1.0, **RUN)


@pytest.mark.parametrize(
    "filter_", [mg.Lowpass(400.0), pytest.param(BAND, marks=pytest.mark.slow)], ids=["lowpass", "bandpass"]
)
def test_the_output_is_the_filtered_estimate_and_nothing_feeds_back(plain, filter_):
    trace = mg.simulate(closed(filter_), 1.0, **RUN)
    want = np.asarray(filter_.apply(trace.rate_unfiltered, 100e3, start=0.5))
    np.testing.assert_allclose(trace.rate_estimate, want, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(trace.rate_unfiltered, plain.rate_unfiltered, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(trace.volts, plain.volts, rtol=0.0, atol=1e-12)
    assert trace.filtered
    assert not np.allclose(trace.rate_estimate, trace.rate_unfiltered, atol=1e-3)
    assert trace.rate_error[-1] == trace.rate_estimate[-1] - 1.0


def test_without_a_filter_the_output_is_the_estimate_itself(plain):
    loop = closed()

    def step():
        state, sample = loop.step(loop.init(), as_scenario(0.0).at(0.0), (0.0, 0.0), Clock(0.0, 0, 1e-5))
        assert state.output is None
        assert sample.rate is sample.estimate.theta[0], "not even copied"
        return sample.rate

    jax.eval_shape(step)
    assert not plain.filtered
    np.testing.assert_array_equal(plain.rate_estimate, plain.rate_unfiltered)


def test_a_trace_shows_output_and_estimate():
    trace = mg.simulate(closed(mg.Lowpass(400.0)), 1.0, **RUN)
    assert set(trace.to_xarray()) >= {"rate_estimate", "rate_unfiltered"}
    ax = trace.plot("rate")
    assert {"output", "estimate before the filter", "true"} <= set(ax.get_legend_handles_labels()[1])
    ax.figure.clear()


@pytest.mark.slow
def test_each_die_of_a_sweep_has_its_own_bandwidth():
    """Errors, windows and convergence are those of the output of each die, as a run of that die alone gives them."""
    settings = {"sample_rate": 100e3, "duration": 0.004, "seed": 3}
    spread = mg.Spread((mg.Vary("filter.bandwidth", mg.Uniform(low=100.0, high=1000.0)),))
    lot = mg.sweep(closed(mg.Lowpass(400.0)), spread, 1.0, dies=3, bound_dies=0, tolerance=0.4, **settings)
    data = lot.to_xarray()
    bandwidth = data["drawn"].values[:, 0]
    assert np.ptp(bandwidth) > 100.0
    for die in range(3):
        trace = mg.simulate(closed(mg.Lowpass(bandwidth[die])), 1.0, die=die, **settings)
        assert data["rate_error_end"].values[die] == pytest.approx(trace.rate_error[-1], rel=1e-6)
        windows = trace.rate_estimate.reshape(data.sizes["window"], -1).mean(axis=1)
        np.testing.assert_allclose(data["rate_estimate"].values[die], windows, rtol=1e-6)
        outside = trace.time[np.abs(trace.rate_error) > 0.4]
        late = np.nan if outside[-1] == trace.time[-1] else outside[-1]
        assert data["convergence_time"].values[die] == pytest.approx(late, nan_ok=True)
        assert data["rate_std_end"].values[die] == pytest.approx(trace.rate_std[-1], rel=1e-6)
        assert data["nis_mean"].values[die] == pytest.approx(np.mean(trace.nis[200:]), rel=1e-6)


@pytest.mark.parametrize("filter_", [mg.Lowpass(50e3), mg.Bandpass(10.0, 60e3)])
def test_a_filter_above_half_the_sample_rate_is_refused(filter_):
    with pytest.raises(InputError, match="`sample_rate` must be more than twice the filter's"):
        mg.simulate(closed(filter_), 1.0, **RUN)


def test_a_die_whose_filter_lies_above_half_the_sample_rate_is_refused():
    spread = mg.Spread((mg.Vary("filter.bandwidth", mg.Uniform(low=40e3, high=90e3)),))
    with pytest.raises(InputError, match="`sample_rate` must be more than twice the filter's"):
        mg.sweep(closed(mg.Lowpass(400.0)), spread, dies=8, sample_rate=100e3, duration=0.001, bound_dies=0)


def test_a_die_of_negative_bandwidth_is_drawn_again_and_refused_where_all_would_be():
    spread = mg.Spread((mg.Vary("filter.bandwidth", mg.Normal(std=400.0)),))
    drawn = spread.draw(closed(mg.Lowpass(400.0)), as_scenario(1.0), 0, np.arange(32))
    assert np.all(drawn.loop.filter.bandwidth > 0.0)
    assert np.any(drawn.redrawn > 0)
    below = mg.Spread((mg.Vary("filter.bandwidth", mg.Normal(std=1.0, mean=-400.0)),))
    with pytest.raises(InputError, match=r"impossible however often it is drawn.*`bandwidth` must be positive"):
        below.draw(closed(mg.Lowpass(400.0)), as_scenario(1.0), 0, np.arange(4))


def test_a_loop_without_filter_has_no_bandwidth():
    spread = mg.Spread((mg.Vary("filter.bandwidth", mg.Normal(relative=0.1)),))
    with pytest.raises(InputError, match=r"`filter.bandwidth` has no `bandwidth`"):
        spread.draw(closed(), as_scenario(1.0), 0, np.arange(2))


def test_something_else_in_place_of_a_filter_is_refused():
    with pytest.raises(InputError, match=r"`filter` must be a filter, .* but is float"):
        closed(10.0)


def test_the_gradient_by_the_bandwidth_is_that_of_finite_differences():
    """Through the loop, by the coordinate that a free tree gives."""
    loop, words = closed(mg.Lowpass(400)).sampled_at(100e3), noise.die_words(jax.random.key(1), jnp.asarray(3))
    spec = mark(fixed(loop), lambda tree: tree.filter.bandwidth, Free(Log()))

    def squared(vector):
        made = from_vector(vector, loop, spec)

        def sample(state, i):
            clock = Clock(i * 1e-5, i, 1e-5)
            state = made.step(state, as_scenario(1.0).at(clock.time), noise.normal_pair(words, i, 0), clock)[0]
            return state, (made.rate(state) - 1.0) ** 2

        return jnp.mean(jax.lax.scan(sample, made.init(), jnp.arange(200))[1])

    both = jax.jit(lambda v: jax.jvp(squared, (v,), (jnp.ones(1),)))
    at = to_vector(loop, spec)
    slope = float(both(at)[1])
    step = 1e-4
    finite = float(both(at + step)[0] - both(at - step)[0]) / (2.0 * step)
    assert abs(slope) > 1e-4
    assert slope == pytest.approx(finite, rel=1e-5)


@pytest.mark.slow
def test_the_command_prints_the_error_before_and_behind_the_filter(tmp_path, capsys):
    study = tmp_path / "study.toml"
    study.write_text('[filter]\nkind = "lowpass"\nbandwidth = "400 Hz"\n\n[sweep]\nduration = "4 ms"\nseed = 3\n')
    simulate_command(study, json=tmp_path / "run.json")
    said = capsys.readouterr().out
    assert "rate error at the end before the filter" in said
    assert "claimed" in said.splitlines()[3]
    assert "rate_error_before_filter_dps" in (tmp_path / "run.json").read_text()
