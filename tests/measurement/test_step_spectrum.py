"""The response over frequency behind the answer to a step, of systems whose response is known."""

import re
import time

import numpy as np
import pytest

from memsgyro_jax.measurement.step_spectrum import first_half_power, flat_up_to, resonance_in_band, spectrum_of


PERIOD = 1e-4  # s
EDGES = PERIOD * np.arange(4001)


def means(integral):
    """What means over windows are of an answer whose integral is known at their edges."""
    return np.diff(integral(EDGES)) / PERIOD


def second_order(natural, ratio):
    """The answer of 1/(1 + 2ζs/ω + s²/ω²) to a step."""
    omega, decay = 2 * np.pi * natural, 2 * np.pi * natural * ratio
    pole = -decay + 1j * omega * np.sqrt(1 - ratio**2)
    share = 1.0 / (1.0 - pole / np.conj(pole))  # of e^{pole·t}, beside its conjugate

    def integral(t):
        return t - 2.0 * np.real(share * (np.exp(pole * t) - 1.0) / pole)

    return means(integral)


def test_a_low_pass_is_flat_up_to_where_it_falls():
    rate = 2 * np.pi * 40.0
    answer = means(lambda t: t + np.expm1(-rate * t) / rate)
    assert first_half_power(answer[None], PERIOD)[0] == pytest.approx(40.0, rel=0.02)
    assert resonance_in_band(answer[None], PERIOD) == ""


def test_a_resonance_before_the_fall_is_told():
    """An open sense axis: 3 dB up at 0.54 of the split, 3 dB down at 1.55 of it."""
    answer = second_order(100.0, 0.1)
    assert first_half_power(answer[None], PERIOD)[0] == pytest.approx(154.0, rel=0.02)
    said = resonance_in_band(np.stack([answer, answer, np.full_like(answer, np.nan)]), PERIOD)
    numbers = [float(number) for number in re.findall(r"([\d.]+) (?:times|Hz)", said)]
    assert numbers == pytest.approx([5.03, 99.0, 54.9], rel=0.02)
    assert resonance_in_band(np.full((2, 50), np.nan), PERIOD) == ""


def test_many_answers_cost_little_more_than_one():
    """24 dies of 20 000 windows took 40 s of a datasheet: the same sines were made for each of them, twice."""
    many = np.stack([second_order(100.0 + k, 0.1) for k in range(24)])
    began = time.perf_counter()
    alone = [first_half_power(one[None], PERIOD)[0] for one in many[:6]]
    between = time.perf_counter()
    together = first_half_power(many, PERIOD)
    assert time.perf_counter() - between < 0.8 * (between - began)
    np.testing.assert_allclose(together[:6], alone, rtol=1e-9)
    assert np.all(np.diff(together) > 0.0)


@pytest.mark.parametrize("split", [97.0, 98.0, 99.0, 100.0])
def test_a_resonance_narrower_than_the_grid_is_told_in_full(split):
    """But for 1.5 % of its ringing, which the record does not see."""
    answer = second_order(split, 1.0 / 60.0)
    (gain, at, _) = (float(n) for n in re.findall(r"([\d.]+) (?:times|Hz)", resonance_in_band(answer[None], PERIOD)))
    assert (gain, at) == pytest.approx((30.0, split), rel=0.03)


@pytest.mark.parametrize(("corner", "low", "high"), [(np.inf, 100.0, 100.0), (30.0, 12.0, 60.0), (4.0, 1.5, 8.0)])
def test_noise_is_flat_up_to_where_it_rises(corner, low, high):
    """White noise, and white noise whose power grows with the square of the frequency beyond a corner."""
    rng, times = np.random.default_rng(5), PERIOD * np.arange(80_000)
    white = rng.standard_normal((3, len(times))) / np.sqrt(2.0 * PERIOD)
    grown = np.fft.irfft(np.fft.rfft(white) * (1.0 + 1j * np.fft.rfftfreq(len(times), PERIOD) / corner), len(times))
    frequencies, power = spectrum_of(grown, PERIOD)
    top = flat_up_to(frequencies, power, 100.0)
    assert low <= top <= high
    below = (frequencies > 0.0) & (frequencies <= top)
    assert np.mean(power[:, below]) == pytest.approx(1.0, rel=0.6), "in place of up to 200"
    assert flat_up_to(frequencies[:3], power[:, :3], 100.0) == 100.0, "too few lines to tell"


def test_noise_that_is_flat_is_rarely_taken_to_rise():
    frequencies = np.arange(41.0)
    lots = np.random.default_rng(1).exponential(size=(2000, 4, 41))
    assert np.mean([flat_up_to(frequencies, lot, 40.0) < 40.0 for lot in lots]) < 0.005
