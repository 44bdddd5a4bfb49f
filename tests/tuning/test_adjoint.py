"""Derivatives backwards through a run: those of forward mode, whatever becomes of other dies, in little memory."""

from dataclasses import replace

import numpy as np
import pytest
from tuning_study import STUDY

import memsgyro_jax as mg
from memsgyro_jax import losses
from memsgyro_jax.loop.blocks.run import prepared
from memsgyro_jax.tuning import objective
from memsgyro_jax.tuning.objective import Objective
from memsgyro_jax.tuning.tunable import resolved
from memsgyro_jax.tuning.tune import timing_of


GYRO, SETTLE = mg.SingleMassGyro.chi2010(), 5e-4


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    path = tmp_path_factory.mktemp("study") / "small.toml"
    path.write_text(STUDY)
    return mg.load_study(path)


@pytest.fixture
def backwards(monkeypatch):
    """Derivatives of this many numbers go backwards."""
    return lambda many: monkeypatch.setattr(objective, "_MANY", 1 if many else 1000)


def lot(loop, scenario, spread, free, loss, sample_rate=1e6, duration=2e-3, dies=5):
    loop = loop.sampled_at(sample_rate)
    tunables = resolved(loop, free, sample_rate, duration)
    return Objective.of(loop, scenario, spread, tunables, loss, dies=np.arange(dies),
                        timing=timing_of(sample_rate, duration, 0.0), seed=0, lanes=4)  # fmt: skip


def small(study, loss, **changes):
    given = study.tune_arguments
    free = (*given["free"], *mg.free({"start.0": (1e-8, 1e-4)}))  # the spread varies it: its dies move along
    spread = mg.Spread((mg.Vary("start.0", mg.Normal(relative=0.2)),))
    return lot(replace(given["loop"], **changes), given["scenario"], spread, free, loss)


def kalman():
    readout = mg.ChargeAmplifier.chi2010()
    noise = mg.ProcessNoise.of(GYRO.model, rate=100.0)
    observer = mg.ExtendedKalmanFilter.for_device(GYRO, readout, annealing=mg.Annealing(), process_noise=noise)
    loop = mg.ClosedLoop(GYRO, readout, observer, mg.DampingCompensation(tones=mg.Tone(600.0, 53.95)))
    free = mg.free(observer=("noise_density", "process_noise.rate", "process_noise.kxx", "prior.theta_std.rate"))
    return lot(loop, mg.Scenario(rate=mg.Constant(1.0)), mg.Spread.relative(0.15), free,
               losses.InnovationLikelihood(SETTLE), sample_rate=100e3)  # fmt: skip


def lyapunov():
    readout, motion = mg.DirectReadout.of_velocity(1.0, 1e-6), (1e-6, 1e-6, 0.0, 0.0)
    observer = mg.LyapunovObserver.for_device(GYRO, readout, gain=10.0, known=("sigma",), start=0.8, motion=motion)
    loop = mg.ClosedLoop(GYRO, readout, observer, mg.ReferenceModel((3000.0, 5000.0)), start=motion,
                         filter=mg.Lowpass(1e3, 3))  # fmt: skip
    free = mg.free(observer=("gain", *(f"adaptation.{n}" for n in range(7))), filter={"bandwidth": (10.0, 1e4)})
    return lot(loop, mg.Scenario(rate=mg.Sine(1.0, 300.0)), mg.Spread.relative(0.1), free,
               losses.SquaredRateError(SETTLE), sample_rate=100e3)  # fmt: skip


@pytest.mark.slow
def test_backwards_through_blocks_is_the_slope():
    """One number along at a time, by central differences."""
    readout = mg.ChargeAmplifier.chi2010()
    observer = mg.ExtendedKalmanFilter.for_device(GYRO, readout, annealing=mg.Annealing())
    loop = mg.ClosedLoop(GYRO, readout, observer, mg.DampingCompensation(tones=mg.Tone(600.0, 53.95)))
    loop, _ = prepared(loop.sampled_at(100e3).in_blocks())
    tunables = resolved(loop, mg.free(observer=("noise_density",)), 100e3, 0.03)
    made = Objective.of(loop, mg.Scenario(rate=mg.Constant(1.0)), mg.Spread.relative(0.15), tunables,
                        losses.SquaredRateError(0.015), dies=np.arange(4),
                        timing=timing_of(100e3, 0.03, 0.015), seed=0, lanes=4)  # fmt: skip
    at = tunables.values
    slopes = made.slopes(at).slopes
    for place in range(len(at)):
        step = 1e-5 * at[place] * np.eye(len(at))[place]
        difference = (made.values(at + step).loss - made.values(at - step).loss) / (2.0 * step[place])
        np.testing.assert_allclose(slopes[place], difference, rtol=2e-3, atol=1e-3 * np.abs(difference).max())


@pytest.mark.slow
@pytest.mark.parametrize(
    "made",
    [
        lambda study: small(study, losses.SquaredRateError(SETTLE)),
        pytest.param(lambda study: lyapunov(), marks=pytest.mark.slow),
        pytest.param(lambda study: kalman(), marks=pytest.mark.slow),
    ],
    ids=["small", "lyapunov", "kalman"],
)
def test_backwards_is_forwards(study, backwards, made):
    made = made(study)
    ways = []
    for many in (True, False):
        backwards(many)
        ways.append(made.slopes(made.tunables.values))
    back, forth = ways
    assert back.alive.all()
    assert forth.alive.all()
    np.testing.assert_allclose(back.loss, forth.loss, rtol=1e-9)
    steepest = np.max(np.abs(forth.slopes), axis=1, keepdims=True)
    assert np.all(steepest > 0.0)
    np.testing.assert_allclose(back.slopes / steepest, forth.slopes / steepest, rtol=0.0, atol=1e-7)


@pytest.mark.slow
def test_a_lost_die_changes_no_other(study, backwards):
    backwards(True)
    loss = losses.SquaredRateError(SETTLE)
    all_of_them = small(study, loss)
    amplitude = np.abs(all_of_them.loop.start[0])
    some = small(study, loss, travel=float(np.median(amplitude)))
    whole, part = (made.slopes(made.tunables.values) for made in (all_of_them, some))
    assert 0 < np.sum(part.alive) < 5
    np.testing.assert_array_equal(part.loss[part.alive], whole.loss[part.alive])
    np.testing.assert_array_equal(part.slopes[:, part.alive], whole.slopes[:, part.alive])
    assert np.all(part.slopes[:, ~part.alive] == 0.0)
    values = some.values(some.tunables.values)
    np.testing.assert_array_equal(values.alive, part.alive)
    np.testing.assert_array_equal(values.loss[part.alive], part.loss[part.alive])


@pytest.mark.slow
def test_memory_grows_as_the_root_of_the_time(study, backwards):
    backwards(True)
    given = study.tune_arguments
    short, long = (
        lot(given["loop"], given["scenario"], given["spread"], given["free"], losses.SquaredRateError(SETTLE),
            duration=duration).memory(derivative=True)
        for duration in (1e-3, 16e-3)
    )  # fmt: skip
    assert long < 6.0 * short
