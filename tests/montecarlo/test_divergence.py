"""Which dies count as diverged, and what is said of a run before it begins."""

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.loop.expectation import expectations, folding
from memsgyro_jax.montecarlo.batch import Plan, nees
from memsgyro_jax.montecarlo.divergence import _short_swing, divergence_of, impossible


STATES = 14
PLAN = Plan(period=1e-5, blocks=100, block=20, settle=0.01, tolerance=0.35)  # 1000 settled samples


def lot_of(dies: int, seed: int = 0) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Rows of dies whose filters are right: correlated normal errors of the size that is claimed, NIS by chi-square."""
    rng = np.random.default_rng(seed)
    mix = rng.standard_normal((STATES, STATES)) + 2.0 * np.eye(STATES)
    covariance = mix @ mix.T
    std = np.sqrt(np.diag(covariance))
    errors = rng.standard_normal((dies, STATES)) @ mix.T / std
    correlation = np.broadcast_to(covariance / np.outer(std, std), (dies, STATES, STATES))
    rows = {
        "nees_end": nees(errors, correlation),
        "nis_mean": rng.chisquare(2 * 1000, dies) / 1000,
        "rate_error_end": 0.1 * errors[:, 6],
        "rate_std_end": np.full(dies, 0.1),
    }
    return rows, errors


def test_no_right_filter_of_twenty_thousand_is_flagged():
    rows, errors = lot_of(20_000)
    assert np.mean(rows["nees_end"]) == pytest.approx(STATES, abs=4.0 * np.sqrt(2 * STATES / 20_000))
    assert not impossible(rows, errors, PLAN, filtered=False).any()
    assert not impossible({**rows, "nees_end": np.full(20_000, np.nan)}, errors, PLAN, filtered=False).any()


@pytest.mark.parametrize(("name", "value"), [("nis_mean", 2.6), ("nees_end", 120.0), ("rate_error_end", 0.75)])
def test_each_impossible_figure_flags_its_die_and_no_other(name, value):
    rows, errors = lot_of(50)
    rows[name][7] = value
    assert np.flatnonzero(impossible(rows, errors, PLAN, filtered=False)).tolist() == [7]
    within = impossible(rows, errors, PLAN, filtered=True)  # an output behind a filter is not what is claimed
    assert within[7] == (name != "rate_error_end")


def test_where_the_covariance_is_singular_each_error_is_judged_by_itself():
    rows, errors = lot_of(50)
    rows["nees_end"][:] = np.nan
    errors[3, 2], errors[4, 5], errors[5, 1] = 9.0, np.nan, np.inf
    assert np.flatnonzero(impossible(rows, errors, PLAN, filtered=True)).tolist() == [3, 5]


def test_only_what_matters_is_blamed(loop):
    """Of three numbers taken as known 5 % of a damping leads the filter astray; 1e-6 of a stiffness, which the noise of
    20 ms hides to 8e-7, and 1e-4 of a cross damping that is told to 0.5 %, do not. Alone, 1e-4 of the stiffness does.
    """
    known = ("kyy", "dxx", "dxy")
    sure = replace(loop, observer=mg.ExtendedKalmanFilter.for_device(loop.device, loop.readout, known=known))
    plan, names = Plan(1e-5, 100, 20, 0.01, 0.35), loop.device.model.names
    theta = np.tile([float(value) for value in loop.observer.prior.theta], (3, 1))
    blamed = []
    for dxx, kyy, dxy in ((0.05, 1e-6, 1e-4), (0.05, 1e-5, 1e-4), (1e-5, 1e-4, 1e-4)):
        dies = theta * [1.0 + {"dxx": dxx, "kyy": kyy, "dxy": dxy}.get(name, 0.0) for name in names]
        blamed += divergence_of(np.arange(3), dies, sure, mg.Scenario(mg.Constant(1.0)), plan).causes
    told = "3 of them (0, 1, 2) differ in what the filter takes as known exactly:"
    assert blamed == [f"{told} dxx", f"{told} dxx", f"{told} kyy"]


def test_of_many_dies_none_is_far_from_the_prior_by_chance(loop):
    """A prior draw of 4096 dies holds numbers beyond 4 standard deviations; 20 of them are beyond any chance."""
    mean, std = (
        np.array([float(v) for v in part]) for part in (loop.observer.prior.theta, loop.observer.prior.theta_std)
    )
    normal = np.random.default_rng(0).standard_normal((4096, len(mean)))
    assert np.max(np.abs(normal)) > 4.0
    plan, scenario = Plan(1e-5, 100, 20, 0.01, 0.35), mg.Scenario(mg.Step(at=0.01, after=1.0))
    normal[7, 1] = 20.0
    first, second = divergence_of(np.arange(4096), mean + std * normal, loop, scenario, plan).causes
    assert first.startswith("1 of them (7) lie farther than 5.1 standard deviations from the filter's prior")
    assert first.endswith(": kxx")
    assert second.startswith("all dies: the rate moves")


def test_dies_whose_swing_rings_down_early_are_told_what_keeps_them(loop):
    """2/d of the axis with more damping: 80 ms of the thesis' device, 13 ms of one with 6.3 times its damping."""
    damped = mg.SingleMassGyro(1.8e-7, 63.96, 95.92, 12.78, 6.3 * 3.6e-6, 6.3 * 4.5e-6, 6.3 * 3.6e-7)
    plan = Plan(1e-5, 100, 100, 0.05, 0.35)
    assert _short_swing(loop, plan) == ""
    told = _short_swing(replace(loop, device=damped), plan)
    assert told.startswith("the design rings down in 13 ms: start it with a larger swing")
    assert "annealing=mg.Annealing(1e4, 0.004)" in told


# ---- before the run


@pytest.fixture(scope="module")
def loop() -> mg.ClosedLoop:
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    observer = mg.ExtendedKalmanFilter.for_device(gyro, readout, annealing=mg.Annealing())
    return mg.ClosedLoop(gyro, readout, observer, mg.DampingCompensation(mg.Tone(600.0, 53.95)))


@pytest.mark.slow
def test_no_filter_of_twenty_thousand_default_dies_is_called_diverged(loop):
    lot = mg.sweep(loop, mg.Spread.relative(0.15), dies=20_000, duration=0.02, bound_dies=0)
    assert lot.summary.divergence.dies == ()
    assert lot.summary.failed == 0


def said(loop: mg.ClosedLoop, scenario: object, sample_rate: float = 100e3) -> tuple[str, ...]:
    whole = scenario if isinstance(scenario, mg.Scenario) else mg.Scenario(rate=scenario)
    return expectations(loop, whole, sample_rate, 0.1)


def test_a_rate_that_moves_under_a_filter_that_holds_it_is_told(loop):
    (sentence,) = said(loop, mg.Step(at=0.05, after=1.0))
    assert "moves by 57.3 deg/s" in sentence
    assert "holds it constant" in sentence
    assert said(loop, mg.Step(at=0.2, after=1.0)) == ()  # after the run
    assert said(loop, mg.Constant(1.0)) == ()
    walking = mg.ExtendedKalmanFilter.for_device(
        loop.device, loop.readout, process_noise=mg.ProcessNoise.of(loop.device.model, rate=300.0)
    )
    fading = mg.ExtendedKalmanFilter.for_device(loop.device, loop.readout, fading=mg.FixedFading(100.0))
    for observer in (walking, fading):
        assert said(replace(loop, observer=observer), mg.Step(at=0.05, after=1.0)) == ()


def test_a_rate_far_outside_the_prior_is_told(loop):
    (sentence,) = said(loop, mg.Constant(np.radians(1000.0)))
    assert "0 ± 172 deg/s" in sentence
    assert "1000 deg/s is 5.8 standard deviations" in sentence
    assert said(loop, mg.Constant(3.0 * 3.8)) == ()
    known = mg.ExtendedKalmanFilter.for_device(
        loop.device, loop.readout, prior=mg.design_prior(loop.device, rate_std=0.0)
    )
    (sentence,) = said(replace(loop, observer=known), mg.Constant(1.0))
    assert "takes the rate as known, 0 deg/s, but it is 57.3 deg/s" in sentence


def test_a_filter_that_follows_more_slowly_than_the_run_shows_is_told(loop):
    """By the gain of a scalar filter: the root of the walk of the rate over the noise of the rate."""
    still = float(mg.noise_budget(loop, sample_rate=100e3).total)
    for bandwidth, told in ((2.0, 1), (20.0, 0)):
        walk = mg.ProcessNoise.of(loop.device.model, rate=(2.0 * np.pi * bandwidth * still) ** 2)
        made = mg.ExtendedKalmanFilter.for_device(loop.device, loop.readout, process_noise=walk)
        found = said(replace(loop, observer=made), mg.Constant(1.0))
        assert [sentence[:53] for sentence in found] == ["the filter follows the rate up to about 2 Hz, slower "] * told


def test_an_offset_that_the_filter_denies_is_told(loop):
    assert said(loop, mg.Constant(1.0)) == ()
    denied = mg.ExtendedKalmanFilter.for_device(loop.device, loop.readout, with_offsets=False)
    x, y = said(replace(loop, observer=denied), mg.Constant(1.0))
    assert "along x, which the filter takes as known, 0 V, is 0.015 V; estimate it" in x
    assert "along y" in y
    direct = mg.DirectReadout(loop.readout.scale, offset=(0.0, 0.1), noise_density=loop.readout.noise_density)
    (sentence,) = said(replace(loop, readout=direct), mg.Constant(1.0))
    assert "along y, which the filter expects at 0 ± 0.02 V, is 0.1 V" in sentence
    assert said(replace(loop, observer=denied, readout=replace(direct, offset=0.0)), mg.Constant(1.0)) == ()


def test_rates_drawn_from_the_prior_are_told_as_rarely_as_said(loop):
    """One lot of 256 dies in 10 000; in 100 lots none, or one by bad luck (1 %)."""
    rng = np.random.default_rng(0)
    prior = mg.Scenario()
    drawn = [mg.Constant(3.0 * rng.standard_normal(256)) for _ in range(100)]
    told = sum(bool(expectations(loop, prior, 100e3, 0.1, (loop.device, rate))) for rate in drawn)
    assert told <= 1
    assert expectations(loop, prior, 100e3, 0.1, (loop.device, mg.Constant(np.linspace(-17.45, 17.45, 256))))


def test_dies_whose_modes_fold_are_told(loop):
    assert not folding(np.array([4300.0]), 10e3).any()
    assert folding(np.array([4400.0, 5100.0]), 10e3).all()
    stiff = mg.SingleMassGyro.chi2010()
    dies = eqx.tree_at(lambda made: made.mass, stiff, stiff.mass / np.array([1.0, 1.1, 1.8]))
    (sentence,) = expectations(loop, mg.Scenario(), 10e3, 0.1, (dies, mg.Constant(np.ones(3))))
    assert sentence.startswith("1 of the first 3 dies have a mode of up to 5")
    assert expectations(loop, mg.Scenario(), 20e3, 0.1, (dies, mg.Constant(np.ones(3)))) == ()
