"""Flicker of the read-out: a stationary sum of Gauss-Markov states, the bias instability it makes, and its absence."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.loop import noise
from memsgyro_jax.loop.blocks.run import hindrances
from memsgyro_jax.measurement.lot_outputs import lot_outputs


RATE = 100e3
GYRO = mg.SingleMassGyro.from_modes(2e-9, (10e3, 10.3e3), (1000.0, 200.0), quadrature=np.radians(50.0))
PLAIN = mg.DirectReadout(1e6)


def classic(kind, readout=PLAIN):
    control = getattr(mg.ClassicControl, kind)(GYRO, PLAIN, amplitude=1e-6)
    return mg.ClosedLoop(GYRO, readout, mg.NoObserver.for_device(GYRO, PLAIN), control, start=(0.0,) * 4)


def flickering(delay, **band):
    return dataclasses.replace(PLAIN, flicker=mg.Flicker(delay, **band))


def delays(flicker, period, samples, lanes):
    """Delays of y (lanes, samples) from the loop's own draws."""
    words = noise.die_words(jax.random.key(3), jnp.arange(lanes))

    def step(held, index):
        draws = tuple(noise.normal_pair(words, index, 16 + k) for k in range(len(flicker.corners)))
        held, late = flicker.step(held, draws, index, period)
        return held, late[1]

    start = jax.tree.map(lambda value: jnp.zeros(lanes), flicker.init())
    return np.asarray(jax.jit(lambda: jax.lax.scan(step, start, jnp.arange(samples))[1])()).T


def test_states_are_stationary_and_exact_at_any_period():
    """Covariance over 20 000 realisations, from the first sample on, against Σ σ² exp(-2π f |t|)."""
    flicker, lanes = mg.Flicker((0.0, 2.0), 0.5, 2), 20_000
    for period in (1e-3, 8e-2):
        rows = delays(flicker, period, 12, lanes)
        found = rows.T @ rows / lanes
        lag = np.abs(np.subtract.outer(np.arange(12), np.arange(12))) * period
        share = np.log(10.0) / np.pi * 4.0
        expected = share * sum(np.exp(-2.0 * np.pi * f * lag) for f in (0.5, 5.0, 50.0))
        np.testing.assert_allclose(found, expected, atol=4.5 * np.sqrt(2.0 / lanes) * 3.0 * share)


def test_the_allan_deviation_is_flat_at_its_coefficient():
    """0.664·B within 5 % over two decades inside the band."""
    rows = delays(mg.Flicker((0.0, 1.0), 1e-2, 5), 2e-4, 2**14, 256)
    factors = np.array([25, 80, 250, 800, 2500])  # 5 ms to 0.5 s, of corners at 10 mHz to 1 kHz
    found = np.sqrt(np.mean(np.asarray(mg.allan_deviation(rows, factors)) ** 2, axis=0))
    np.testing.assert_allclose(found, np.sqrt(2.0 * np.log(2.0) / np.pi), rtol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["open_loop", "force_rebalance"])
def test_the_budget_knows_what_a_delay_makes_of_the_quadrature(kind):
    """A constant delay, simulated: what flicker of that size would make of the rate."""
    late, rest = 2e-8, None
    for delay in ((0.0, 0.0), (late, 0.0), (0.0, late)):
        loop = classic(kind, mg.Delayed(PLAIN, delay)).sampled_at(RATE)
        run = mg.simulate(loop, 0.0, sample_rate=RATE, duration=0.12, decimation=100)
        rate = float(np.mean(run.rate_estimate[-20:]))
        rest = rate if rest is None else rest
        budget = mg.noise_budget(classic(kind, flickering(delay)))
        nulled = kind == "force_rebalance" and delay[1] > 0.0
        assert float(budget.instability) == pytest.approx(
            abs(rate - rest), rel=0.03, abs=0.01 * np.radians(50.0) * late * 6e4
        )
        assert (float(budget.instability) > 0.0) == (max(delay) > 0.0 and not nulled)
        assert ("bias instability" in str(budget)) == (float(budget.instability) > 0.0)


@pytest.mark.slow
def test_no_flicker_is_none_to_the_last_bit():
    settings = {"sample_rate": RATE, "duration": 2e-3}
    plain, still = (
        mg.simulate(classic("open_loop", readout), 1.0, **settings) for readout in (PLAIN, flickering((0.0, 0.0)))
    )
    np.testing.assert_array_equal(plain.volts, still.volts)
    np.testing.assert_array_equal(plain.rate_estimate, still.rate_estimate)
    moved = mg.simulate(classic("open_loop", flickering((0.0, 1e-7))), 1.0, **settings)
    assert not np.array_equal(moved.volts[:, 1], plain.volts[:, 1])
    np.testing.assert_array_equal(moved.volts[:, 0], plain.volts[:, 0])


def test_what_is_refused():
    assert any("flickers" in words for words in hindrances(classic("open_loop", flickering((0.0, 1e-9)))))
    with pytest.raises(InputError, match="must measure displacement"):
        dataclasses.replace(mg.DirectReadout.of_velocity(1.0), flicker=mg.Flicker((0.0, 1e-9)))
    with pytest.raises(InputError, match="`decades` must lie between 1 and 12"):
        mg.Flicker((0.0, 1e-9), decades=0)
    with pytest.raises(InputError, match="`delay` must be a pair"):
        mg.Flicker((1e-9,))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["open_loop", "force_rebalance"])
def test_the_bias_instability_of_simulated_runs(kind):
    """Within 5 %: Allan deviation of 64 dies over 3 s, at 150 to 600 ms, beside that of the budget."""
    loop = classic(kind, flickering((3e-9, 5e-9), lowest=3e-2, decades=5)).sampled_at(RATE, duration=3.0)
    window = 500
    run = lot_outputs(
        loop, mg.Spread(), mg.Scenario(), dies=64, seed=1, sample_rate=RATE, windows=620, window=window
    )  # fmt: skip
    rows = run.rate[:, 20:]
    found = np.sqrt(np.mean(np.asarray(mg.allan_deviation(rows, np.array([30, 60, 120]))) ** 2))
    expected = np.sqrt(2.0 * np.log(2.0) / np.pi) * float(mg.noise_budget(loop).instability)
    assert found == pytest.approx(expected, rel=0.05)
