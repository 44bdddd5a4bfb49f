"""Where a decay begins, told to a few periods of its vibration."""

import numpy as np
import pytest

from memsgyro_jax.measurement.begin_of_decay import begin_of_decay, part_of_decay


BEGIN, RATE, HERTZ, BEFORE = 0.1373, 25e3, 1247.83, {"plucked": 0.0, "kept up": 1.0, "rising": 0.5}
HUM = {50.0: 1.0, 150.0: 0.33, 250.0: 0.15}  # of which frequencies [Hz] how much


def record(before, *, noise=1.5e-3, hum=0.0, rate=10.0, bent=5.0, lasts=3.2, seed=0):
    """0.85 V, whose size falls by rate·a + bent·a² from BEGIN on, behind rest, a drive, or one that began at rest."""
    time = np.arange(int(lasts * RATE)) / RATE
    fallen, rise = np.exp(-rate * np.maximum(time - BEGIN, 0.0)), -np.expm1(-10.0 * time) / -np.expm1(-10.0 * BEGIN)
    size = 0.85 * fallen / (1.0 + bent / rate * 0.85 * (1.0 - fallen))
    size = size * np.where(time < BEGIN, {"plucked": 0.0, "kept up": 1.0, "rising": rise}[before], 1.0)
    volts = size * np.sin(2 * np.pi * HERTZ * (time - BEGIN))
    volts = volts + hum * sum(part * np.sin(2 * np.pi * f * time + f) for f, part in HUM.items()) + 0.03
    return volts + noise * np.random.default_rng(seed).standard_normal(time.size)


@pytest.mark.parametrize("before", BEFORE)
@pytest.mark.parametrize("hum", [0.0, 0.012, 0.096])
def test_a_decay_begins_within_a_few_periods_and_not_before(before, hum):
    """It began 43 ms late in 3.2 s, at 0.59 of 0.85 V."""
    for seed in range(2):
        late = begin_of_decay(record(before, hum=hum, seed=seed)) - BEGIN * RATE
        assert -0.5 <= late < 6 * RATE / HERTZ


@pytest.mark.parametrize("before", BEFORE)
@pytest.mark.parametrize(("noise", "rate"), [(0.02, 10.0), (0.1, 10.0), (1.5e-3, 1.0), (0.02, 1.0), (0.1, 1.0)])
def test_beside_noise_nothing_of_a_drive_is_caught(before, noise, rate):
    for seed in range(3):
        late = begin_of_decay(record(before, noise=noise, rate=rate, seed=seed)) - BEGIN * RATE
        assert -0.5 <= late < 0.15 / rate * RATE + 0.02 * 80_000


def test_louder_rows_that_are_left_out_are_said():
    volts = record("kept up")
    volts[100] = 1.5
    part = part_of_decay(volts, "V", 16)
    assert part.why.endswith("louder rows before it, up to 1.47 V beside 0.834 V, are left out")
    assert "louder" not in part_of_decay(record("plucked", rate=200.0, lasts=0.6)[3432:], "V", 16).why


def test_noise_before_a_decay_does_not_fall_from_the_start():
    """Of forty, five told the first row: noise made that a few per cent louder than the last, and the halves alike."""
    begins = [begin_of_decay(record("plucked", noise=0.01, rate=30.0, lasts=0.4, seed=seed)) for seed in range(40)]
    assert min(begins) >= BEGIN * RATE
