"""The noise of a device that is turned in steps, beside the transients that the steps leave."""

import numpy as np
import pytest

from memsgyro_jax.measurement.held_noise import noise_beside_steps
from memsgyro_jax.measurement.noise import freedom_over_time, noise_over_time


LEVELS = (0.0, 50.0, -50.0, 100.0, -100.0, 150.0, -150.0, 200.0, -200.0, 0.0, 30.0, 70.0)


def answer(rate, decays=(11.6, 5.6), beats=(0.003, 0.5), size=100.0):
    """(n, 2) of two modes that follow a rate, each with a decay [rows] and a beat with the drive [1/row]."""
    seen = np.zeros((len(rate), 2), complex)
    for decay, beat, share in zip(decays, beats, ([1.0, 0.3], [0.2, 1.0]), strict=True):
        pole, at = np.exp(-1 / decay + 2j * np.pi * beat), rate[0]
        for row, rate_now in enumerate(rate):
            at = rate_now + pole * (at - rate_now)
            seen[row] += size * at * np.array(share)
    return seen


def noise_of(shape, rng):
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


@pytest.mark.parametrize(("hold", "count", "draws"), [
    (20, 12, 200), (30, 10, 200), pytest.param(150, 6, 200, marks=pytest.mark.slow), (1000, 3, 20),
])  # fmt: skip
def test_transients_of_steps_are_not_taken_for_noise(hold, count, draws):
    """Two modes, one of which beats with the rows at half their rate, ten thousand times the noise: within 3 % of its
    square, which scatters as its degrees of freedom say, and no less than half of it.
    """
    rate, rng = np.repeat(LEVELS[:count], hold), np.random.default_rng(hold)
    clean, place = answer(rate), np.arange(hold * count)
    told = [noise_beside_steps(clean + noise_of(clean.shape, rng), rate, place) for _ in range(draws)]
    squares, said = np.array([level**2 for level, _ in told]), told[0][1]
    assert np.mean(squares) == pytest.approx(1.0, abs=0.03)
    if draws > 100:
        assert 0.8 * said < 2 * np.mean(squares) ** 2 / np.var(squares) < 2.0 * said


def test_it_was_the_steps_that_were_taken_for_noise():
    rate = np.repeat(LEVELS[:10], 30)
    assert noise_over_time(answer(rate) + noise_of((300, 2), np.random.default_rng(0))) > 4.0


@pytest.mark.parametrize("rate", [np.full(300, 50.0), np.linspace(-200, 200, 300), 200 * np.sin(np.arange(300) / 30)])
def test_without_a_rate_that_is_held_between_steps_the_estimate_over_time_stays(rate):
    seen = answer(rate) + noise_of((300, 2), np.random.default_rng(1))
    assert noise_beside_steps(seen, rate, np.arange(300)) == (noise_over_time(seen), freedom_over_time(seen))


def test_what_leaves_no_noise_at_all_is_no_error():
    rate = np.repeat(LEVELS[:10], 30)
    assert noise_beside_steps(np.ones((300, 1), complex), rate, np.arange(300))[0] < 1e-12


def test_lost_blocks_end_a_stretch():
    """A tenth of the blocks is lost in runs; one channel."""
    rate, rng = np.repeat(LEVELS[:10], 100), np.random.default_rng(2)
    kept = np.delete(np.arange(1000), np.concatenate([np.arange(k, k + 10) for k in range(60, 1000, 100)]))
    levels = [
        noise_beside_steps((answer(rate) + noise_of((1000, 2), rng))[kept, :1], rate[kept], kept)[0] for _ in "ab"
    ]
    assert np.mean(levels) == pytest.approx(1.0, abs=0.1)
