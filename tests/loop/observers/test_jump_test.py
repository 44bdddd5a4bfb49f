"""The jump test alarms as often as stated, leaves a filter alone until then, and finds damping that has jumped."""

import equinox as eqx
import jax
import numpy as np
import pytest
from harness import observe, record
from scipy.signal import lfilter
from scipy.stats import norm

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.loop.observers.jump_test import window_excess
from memsgyro_jax.tuning.tunable import resolved


GYRO, RATE = mg.SingleMassGyro.chi2010(), 100e3
READOUT = mg.DirectReadout.of_velocity(1.0, mg.snr_density(1000.0, 2 * np.pi * 3000.0 * 1e-6, 1.0, 1e6))
FILTER = mg.ExtendedKalmanFilter.for_device(
    GYRO, READOUT, with_offsets=False, process_noise=mg.ProcessNoise.of(GYRO.model, rate=50.0)
)


@pytest.mark.parametrize("samples", [20, 100])
def test_level_is_that_of_a_normal_variable(samples):
    """Windows of χ² draws, none of them independent of the next: the share of time beyond the level."""
    keep = np.exp(-1 / samples)
    nis = np.random.default_rng(0).chisquare(2, (2000, 25 * samples))
    means = lfilter([1 - keep], [1, -keep], nis, axis=1)[:, 10 * samples :]
    found = np.asarray(window_excess(means, (1 + keep) / (1 - keep)))
    for level, room in ((1.5, 0.05), (3.0, 0.25)):
        assert np.mean(found > level) == pytest.approx(norm.sf(level), rel=room)


@pytest.mark.slow
def test_it_is_the_filter_until_something_jumps():
    """Its level out of reach: the same estimates, covariance and gradient."""
    rng = np.random.default_rng(2)
    volts, force = 0.02 * rng.standard_normal((200, 2)), 1e-6 * rng.standard_normal((200, 2))
    watched = mg.JumpTest.of_damping(FILTER, 10.0, level=1e9)
    plain, tested = observe(FILTER, volts, force, 1 / RATE), observe(watched, volts, force, 1 / RATE)
    for one, other in zip(jax.tree.leaves(plain), jax.tree.leaves(tested.inner), strict=True):
        assert np.asarray(other) == pytest.approx(np.asarray(one), rel=1e-9, abs=1e-30)
    assert watched.states == FILTER.states
    assert np.array_equal(watched.covariance(watched.init()), FILTER.covariance(FILTER.init()))


@pytest.mark.slow
def test_damping_that_jumps_is_found_again():
    """+50, +40 and +400 % at 15 ms; three dies, one of which does not jump and keeps what it knows."""
    change = tuple(mg.Step(0.015, np.array([v, v, 0.0])) for v in (0.5, 0.4, 4.0))
    loop = mg.ClosedLoop(
        GYRO, READOUT, mg.JumpTest.of_damping(FILTER, 10.0), mg.WholeAngle(3500.0, rocking=mg.Tone(120.0, 1.2024))
    ).sampled_at(RATE)
    scenario = mg.Scenario(rate=mg.Constant(1.0), damping_change=change)
    done, rows = record(loop, scenario, blocks=300, block=10, dies=np.arange(3), design=loop)
    assert np.all(done.alive)
    damping = rows[:, 12 + 4 : 12 + 7]  # of theta: rate, three stiffnesses, then these
    before, after = damping[149], damping[-1]
    opened = np.asarray(done.state.observer.opened)
    assert np.all((opened[:2] > 0.015) & (opened[:2] < 0.02))
    assert opened[2] < 0.015
    assert np.max(np.abs(before - [[20.0], [25.0], [2.0]])) < 1.0
    assert np.max(np.abs(after[:, :2] - [[30.0], [35.0], [10.0]])) < 1.0
    assert np.max(np.abs(after[:, 2] - [20.0, 25.0, 2.0])) < 0.5


def test_what_cannot_be_is_refused():
    with pytest.raises(InputError, match="`reopened` must have one entry for each of rate, kxx"):
        mg.JumpTest(FILTER, (1.0, 2.0))
    with pytest.raises(InputError, match="`reopened`"):
        mg.JumpTest.of_damping(FILTER, -1.0)
    with pytest.raises(InputError, match="`window` must be positive"):
        mg.JumpTest.of_damping(FILTER, 1.0, window=0.0)


def test_it_is_tuned_as_the_filter_is():
    watched = mg.JumpTest.of_damping(FILTER, 10.0)
    assert watched.bounds("inner.process_noise.theta.0", 0.1) == FILTER.bounds("process_noise.theta.0", 0.1)
    assert watched.claims_innovation
    loop = mg.ClosedLoop(GYRO, READOUT, watched, mg.OpenLoop())
    labels = resolved(loop, mg.free(observer=watched.usually_tuned), RATE, 0.1).labels
    assert "observer.inner.process_noise.theta.0" in labels or "observer.inner.process_noise.rate" in labels
    assert eqx.tree_equal(watched.prior, FILTER.prior)
