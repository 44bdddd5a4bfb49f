"""The spectrum of noise that is white and slow, told by rows."""

from types import SimpleNamespace

import numpy as np
import pytest
from lab.faults import Faults
from scipy.fft import dct

from memsgyro_jax.diagnosis.at_resonance import NEAR, concentrated, larger_at_resonance
from memsgyro_jax.diagnosis.score import Score, survival
from memsgyro_jax.diagnosis.slow_noise import EVIDENT, _comes_again, _spectra, slow_noise_of


RESPONSE = 1.0 / (1.0 + 2j * np.linspace(-6.0, 6.0, 121))  # to a drive, twelve widths of the resonance


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


def sweep(left, number=0, response=RESPONSE):
    """A frequency sweep and its deviations (n, 2)."""
    record = SimpleNamespace(kind="frequency_sweep", channels=(0,), stepped=True, sweeps=(slice(None),))
    return record, SimpleNamespace(number=number, white=left[:, None, :], predicted=response[:, None])


def test_a_record_of_white_noise_beside_slow_ones_is_not_called_slow():
    """It ended a diagnosis: its noise is slow over more than infinitely many rows."""
    slow, rng = Faults(corner=20.0), np.random.default_rng(3)
    rows = np.stack([slow.noise(121, None, rng) for _ in range(2)], axis=1)
    sound = next(white for _ in range(50) if slow_noise_of(white := rng.standard_normal((121, 2)))[1] == 0.0)
    assert list(_spectra(SimpleNamespace(deviations=[sweep(rows, 0), sweep(sound, 1)]))) == [0]


def test_slow_noise_is_seldom_larger_at_the_resonance():
    """Whitened by its own spectrum, at three corners; a hundredth of the probabilities may lie below a hundredth."""
    rng, found = np.random.default_rng(4), []
    for corner in (2.0, 20.0, 200.0):
        for _ in range(200):
            rows = np.stack([Faults(corner=corner).noise(121, None, rng) for _ in range(2)], axis=1)
            white = slow_noise_of(rows)[0].whitened(rows)
            near = np.repeat((np.abs(RESPONSE) ** 2 > NEAR)[:, None], 2, axis=1)
            found.append(larger_at_resonance([white], [near]))
    assert np.mean(np.array(found) <= 0.01) <= 0.02
    assert np.mean(np.array(found) <= 0.5) == pytest.approx(0.5, abs=0.12)


def test_what_a_resonance_is_wrong_by_is_no_slow_noise_of_five_sweeps():
    """A damping that is wrong by different amounts, beside white noise: spectra are slow, but what they whiten is
    larger near the resonance.
    """
    rng = np.random.default_rng(5)
    wrong, records = RESPONSE**2, []
    for number, size in enumerate((2.0, 6.0, -5.0, 4.0, -7.0)):
        rows = np.stack([(size * wrong).real, (size * wrong).imag], axis=1) + rng.standard_normal((121, 2))
        spectrum, gain = slow_noise_of(rows)
        assert gain > EVIDENT or number == 0
        records.append(sweep(spectrum.whitened(rows), number))
    assert concentrated(records)
    assert not concentrated([sweep(rng.standard_normal((121, 2))) for _ in range(5)])


def test_nothing_is_asked_where_a_sweep_has_no_resonance_or_nothing_else():
    white = 3.0 * np.random.default_rng(6).standard_normal((121, 2))
    assert not concentrated([sweep(white, response=np.ones(121))])
    assert larger_at_resonance([], []) == 1.0


def several(left, hertz):
    """A stand-in for the fit of sweeps over the same frequencies, of each of which rows (n, 2) are left."""
    pairs = [
        (
            SimpleNamespace(
                name=f"sweep_{k}", channels=[0], rows=len(rows), axis=0, frequency=2.0 * np.pi * hertz, setting=1.0
            ),
            SimpleNamespace(number=k, white=rows[:, None, :]),
        )
        for k, rows in enumerate(left)
    ]
    return SimpleNamespace(deviations=pairs)


def test_what_comes_again_in_every_sweep_is_no_slow_noise():
    """A phase that runs away with the frequency leaves the same of every drive, in proportion; slow noise does not."""
    rng, faults, hertz = np.random.default_rng(3), Faults(corner=8.0), np.linspace(49.5e3, 50.5e3, 201)
    shape = np.stack([np.sin(np.linspace(0, 7, 201)), np.cos(np.linspace(0, 5, 201))], axis=1)
    alike = [size * shape + rng.standard_normal((201, 2)) for size in (10.0, 3.0, 0.5)]
    assert _comes_again(several(alike, hertz), range(3))
    assert not _comes_again(several(alike[:1], hertz), range(1)), "of one sweep nobody knows"
    noisy = [[np.stack([faults.noise(201, None, rng) for _ in range(2)], axis=1) for _ in range(3)] for _ in range(200)]
    assert sum(_comes_again(several(one, hertz), range(3)) for one in noisy) <= 2
