"""Lines of interference in records of what dies out: found where they are, and nowhere else."""

import numpy as np
import pytest

from memsgyro_jax.measurement.standing_line import standing_lines


TURN = 2 * np.pi
TIME = 0.5 + np.arange(600) * 5e-3
DECAY, BESIDE = 1.5, TURN * 0.3
NOISE = 3e-4


def noisy(seed, signal, real=False):
    noise = NOISE * np.random.default_rng(seed).standard_normal((2, *signal.shape))
    return (signal.real + noise[0] if real else signal + noise[0] + 1j * noise[1])[:, None]


def ringing(omega=BESIDE, decay=DECAY, stiff=0.0):
    """Phasors of a vibration whose frequency falls with the square of its amplitude."""
    phase = omega * TIME + stiff * (1 - np.exp(-2 * decay * TIME)) / (2 * decay)
    return 0.3 * np.exp(1j * phase - decay * TIME)


def line(hertz, size):
    return size * np.exp(1j * (TURN * hertz * TIME + 0.7))


def found(signals, omega=(BESIDE,), decay=DECAY):
    return standing_lines(TIME, signals, np.array(omega), decay)


@pytest.mark.parametrize("hertz", [37.0, -21.3, 93.1])
@pytest.mark.parametrize("times", [1.0, 10.0])
def test_a_line_is_found_with_its_frequency_and_size(hertz, times):
    (one,) = found(noisy(1, ringing() + line(hertz, times * NOISE)))
    assert one.omega / TURN == pytest.approx(hertz, abs=0.02 / times)
    assert one.amplitude[0] == pytest.approx(times * NOISE, rel=0.25 / times)


def test_the_mains_and_its_harmonic_are_found_in_a_waveform():
    wave = ringing(TURN * 23.0) + line(50.0, 3e-3) + line(75.0, 1e-3)
    one, two = found(noisy(2, wave, real=True), (TURN * 23.0,))
    assert [one.omega / TURN, two.omega / TURN] == pytest.approx([50.0, 75.0], abs=0.01)
    assert [one.amplitude[0], two.amplitude[0]] == pytest.approx([3e-3, 1e-3], rel=0.1)


@pytest.mark.parametrize("stamps", [0.0, 7.0])
def test_harmonics_of_the_mains_over_a_few_periods(stamps):
    """Five bins apart, each stands among those that tell what is beside the others."""
    time = np.arange(9000) * 2e-5  # nine periods
    rng = np.random.default_rng(4)
    sizes = {50.0: 3e-3, 100.0: 8e-4, 150.0: 1.5e-3, 250.0: 5e-4, 350.0: 3e-4}
    wave = 0.4 * np.exp(-14.0 * time) * np.cos(TURN * 9000.0 * time)
    wave += sum(size * np.cos(TURN * hertz * time + hertz) for hertz, size in sizes.items())
    wave += NOISE * rng.standard_normal(time.size)
    told = standing_lines(stamps + time, wave[:, None], np.array([TURN * 9000.0]), 14.0)
    assert [line.omega / TURN for line in told] == pytest.approx([50.0, 150.0, 100.0, 250.0, 350.0], abs=0.15)
    assert [line.amplitude[0] for line in told] == pytest.approx(sorted(sizes.values())[::-1], abs=4e-5)


def test_what_rings_for_long_hides_lines_near_it_alone():
    time = np.arange(12000) * 2e-5
    wave = 0.3 * np.cos(TURN * 9000.0 * time) + 0.1 * np.cos(TURN * 7000.0 * time) + 2e-3 * np.cos(TURN * 50.0 * time)
    noise = NOISE * np.random.default_rng(5).standard_normal(time.size)
    (one,) = standing_lines(time, (wave + noise)[:, None], np.array([TURN * 9000.0]), 0.5)
    assert one.omega / TURN == pytest.approx(50.0, abs=0.05)


@pytest.mark.parametrize("power", [1, 2, 3])
def test_what_a_drive_may_make_is_no_line(power):
    """A device answers to a drive at its frequencies, bent by its laws at those of its powers."""
    drive = np.cos(TURN * 14.3 * TIME) + 0.5 * np.cos(TURN * 17.9 * TIME)
    wave = noisy(6, ringing(TURN * 33.0) + 0.02 * drive**power + line(70.7, 3e-3), real=True)
    assert len(found(wave, (TURN * 33.0,))) > 1
    (one,) = standing_lines(TIME, wave, np.array([TURN * 33.0]), DECAY, drive[:, None])
    assert one.omega / TURN == pytest.approx(70.7, abs=0.02)


@pytest.mark.parametrize("stiff", [0.0, 60.0])
@pytest.mark.parametrize("real", [False, True])
def test_nothing_is_found_where_nothing_stands(stiff, real):
    """Nor a second mode that dies out, nor what a stiff spring sweeps over."""
    omega = TURN * 23.0 if real else BESIDE
    alone = ringing(omega, stiff=stiff) + 0.2 * ringing(omega + TURN * 40.0, 1.2 * DECAY)
    assert not any(found(noisy(seed, alone, real), (omega,)) for seed in range(40))


def test_where_the_vibration_does_not_die_out_nothing_is_said():
    assert found(noisy(3, ringing(decay=0.05) + line(37.0, 3e-3)), decay=0.05) == ()
    assert standing_lines(TIME[:50], noisy(3, ringing())[:50], np.array([BESIDE]), 9.0) == ()


def test_noise_alone_holds_no_line():
    """Of 150 records eleven held one, of 3.6 to 6.9 standard deviations, where few bins told the noise beside."""
    time = np.arange(40_000) / 25e3
    for seed in range(5, 20):
        noise = np.random.default_rng(seed).standard_normal((time.size, 1))
        assert standing_lines(time, noise, np.zeros(0), np.inf) == ()
