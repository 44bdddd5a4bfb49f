"""A rate that moves: the filter that finds its slope, sample by sample and in blocks, within which it moves too."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sine_response import told_and_seen

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.loop.blocks.length import Blocks
from memsgyro_jax.loop.blocks.run import prepared


GYRO, READOUT, DUAL = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010(), mg.DualMassGyro.chi2010()
KNOWN = ("kxx", "kyy", "kxy", "dxx", "dyy", "dxy", "sigma")
STEEP = 100.0  # rad/s²
SLOPED = mg.RateSlopeFilter.for_device(
    GYRO, READOUT, annealing=mg.Annealing(), slope_std=f"{STEEP} rad/s^2", known=KNOWN
)
LOOP = mg.ClosedLoop(GYRO, READOUT, SLOPED, mg.DampingCompensation(tones=mg.Tone(600.0, 53.95)))
RAMP = mg.Ramp(at=0.0, slope=STEEP)
RUN = {"sample_rate": 100e3, "duration": 0.0512, "seed": 3, "decimation": 512}


def traces(loop: mg.ClosedLoop, scenario, **settings):
    """Sample by sample, and in blocks under the same noise."""
    both = (loop, replace(loop, blocks=Blocks(512, projected=True)))
    return [mg.simulate(one, scenario, **RUN | settings) for one in both]


def error(trace) -> float:
    return float(trace.rate_estimate[-1] - trace.rate_true[-1])


def test_a_ramp_is_followed_without_being_late():
    """In a slope as steep as it may be a filter of a constant rate lags by the half of what the rate has moved."""
    constant = replace(LOOP, observer=mg.ExtendedKalmanFilter.for_device(GYRO, READOUT, known=KNOWN))
    by_samples, by_blocks = traces(LOOP, RAMP)
    late = mg.simulate(constant, RAMP, **RUN)
    assert error(late) < -20.0 * late.rate_std[-1]
    for trace in (by_samples, by_blocks):
        assert abs(error(trace)) < 4.0 * trace.rate_std[-1]
    assert abs(error(by_blocks) - error(by_samples)) < 0.02 * by_samples.rate_std[-1]
    assert by_blocks.rate_std[-1] == pytest.approx(by_samples.rate_std[-1], rel=0.01)


def test_in_blocks_the_true_rate_moves_within_each():
    """The mass at the ends of blocks is where it is sample by sample, not where a rate in steps would have it."""
    by_samples, by_blocks = traces(LOOP, RAMP)
    assert by_blocks.time == pytest.approx(by_samples.time[-len(by_blocks.time) :])
    apart = by_blocks.motion - by_samples.motion[-len(by_blocks.time) :]
    swing = np.max(np.abs(by_samples.motion), axis=0)
    assert np.max(np.abs(apart[-20:]) / swing) < 3e-5  # 1.2e-5; a rate in steps leaves 9e-5


def test_what_it_claims_holds_of_all_that_it_says():
    found = mg.sweep(LOOP.in_blocks(), mg.Spread.relative(0.0), RAMP, dies=64, duration=0.04, bound_dies=0).data
    count = len(LOOP.observer.states)
    assert count == 7
    mean = float(found["nees_end"].mean())
    assert abs(mean - count) < 4.0 * np.sqrt(2.0 * count / 64)


def test_the_slope_is_told():
    """By the filter itself over recorded volts of a ramp."""
    period, noise = 1e-5, jnp.sqrt(jnp.stack(SLOPED.variance(mg.Clock(1.0, 1, 1e-5))))

    def one(carry, given):
        (state, motion), (sample, normal) = carry, given
        dynamics = GYRO.dynamics(mg.Scenario(rate=RAMP).at((sample - 0.5) * period).inertial)
        step = SLOPED.discretisation.transition(dynamics.stiffness, dynamics.velocity, period)
        motion = jnp.asarray(step.full) @ motion
        volts = jnp.stack(READOUT.clean(tuple(motion), (0.0, 0.0))) + noise * normal
        clock = mg.Clock(sample * period, sample, period)
        return (SLOPED.update(state, tuple(volts), (0.0, 0.0), clock), motion), None

    start = jax.tree.map(jnp.asarray, SLOPED.init()), jnp.array([1e-6, 0.0, 0.0, 0.0])
    given = jnp.arange(1, 6001), np.random.default_rng(0).normal(size=(6000, 2))
    (state, _), _ = jax.jit(lambda: jax.lax.scan(one, start, given))()
    told = SLOPED.further(state)
    assert abs(float(told.value) - STEEP) < 4.0 * float(told.std) < 0.5 * STEEP


def test_two_masses_share_the_slope():
    observer = mg.RateSlopeFilter.for_device(DUAL, READOUT, slope_std=1.0)
    shares = dict(zip(DUAL.model.names, map(float, observer.shares), strict=True))
    unit = dict(zip(DUAL.model.names, map(float, DUAL.coefficients(1.0)), strict=True))
    assert {name: share for name, share in shares.items() if share} == {n: unit[n] for n in ("rate_x", "rate")}
    moves = np.asarray(observer.moves())
    assert moves.shape == (13, 13)
    assert moves[:, :-1].any() == np.False_
    assert moves[2:4, -1] == pytest.approx([unit["rate_x"], 1.0])
    assert "rate_slope" not in observer.states


def test_nothing_is_said_to_be_held_constant():
    assert prepared(LOOP.in_blocks())[1] == ()
    with pytest.raises(InputError, match="must estimate the rate, but `known` holds it"):
        mg.RateSlopeFilter.for_device(GYRO, READOUT, slope_std=1.0, known=("rate",))


@pytest.mark.slow
@pytest.mark.parametrize("blocks", [None, Blocks(512)], ids=["samples", "512"])
def test_a_trace_tells_how_the_rate_is_followed(blocks):
    """What a sine adds to the estimate, beside the same noise without it."""
    observer = mg.RateSlopeFilter.for_device(
        GYRO, READOUT, annealing=mg.Annealing(), known=KNOWN, slope_std=STEEP, slope_walk=1e6
    )
    loop = replace(LOOP, observer=observer, blocks=blocks)
    for frequency in (1.0, 10.0, 30.0):
        told, seen = told_and_seen(loop, frequency)
        assert abs(told - seen) < 0.05, (frequency, told, seen)
