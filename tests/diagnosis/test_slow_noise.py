"""The spectrum of noise that is white and slow, told by rows."""

import numpy as np
import pytest
from lab.faults import Faults
from scipy.fft import dct

from memsgyro_jax.diagnosis.score import Score, survival
from memsgyro_jax.diagnosis.slow_noise import EVIDENT, slow_noise_of


@pytest.mark.parametrize("rows", [40, 400])
def test_white_noise_is_seldom_called_slow(rows):
    rng = np.random.default_rng(rows)
    found = [slow_noise_of(2.0 * rng.standard_normal((rows, 2))) for _ in range(300)]
    assert sum(gain > EVIDENT for _, gain in found) <= 3
    assert np.mean([one.level for one, _ in found]) == pytest.approx(2.0, rel=0.07)


@pytest.mark.parametrize("corner", [2.0, 8.0])
def test_flicker_is_told_and_taken_away(corner):
    """A laboratory's noise at twenty rows a second: white again, of the size of its white part, and so is every other
    row of it.
    """
    rng, faults = np.random.default_rng(0), Faults(corner=corner)
    levels, left = [], []
    for _ in range(40):
        rows = np.stack([faults.noise(300, None, rng) for _ in range(2)], axis=1)
        found, gain = slow_noise_of(rows)
        assert gain > EVIDENT
        levels.append(found.level)
        for white in (found.whitened(rows), found.whitened(rows[::2])):
            assert np.mean(white**2) == pytest.approx(1.0, abs=0.3)
            left.append(np.mean(white[1:] * white[:-1]))
    assert np.mean(levels) == pytest.approx(1.0, abs=0.1)
    assert np.mean(left) == pytest.approx(0.0, abs=0.03)


def test_what_few_rows_tell_of_slow_noise_is_allowed_for():
    """Of a slow cosine a spectrum from 28 rows foretells the size, as well as its degrees of freedom say."""
    rng, faults, cosine = np.random.default_rng(1), Faults(corner=200.0), np.eye(28)[:, 1]
    told, known = [], []
    for _ in range(400):
        rows, other = (np.stack([faults.noise(28, None, rng) for _ in range(2)], axis=1) for _ in range(2))
        found, _ = slow_noise_of(rows)
        drawn = dct(other[:, 0], norm="ortho") @ cosine / found.std(28)[1]
        one = Score(float(drawn**2), 1, 0.0, 0.0, 1.0, np.ones((1, 1)), 1.0)
        told.append(survival(one, 1.0 / found.doubt(np.stack([cosine, 0.0 * cosine], axis=1))))
        known.append(survival(one))
    assert np.mean(np.array(told) <= 0.02) <= 0.03
    assert np.mean(np.array(known) <= 0.005) >= 0.01, "were the spectrum known"
