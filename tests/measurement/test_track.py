"""How far a vibration turns, and what a free decay tells of a device that is linear: as much as there is to tell."""

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.measurement.tracking import tracked


HERTZ, QUALITY, RATE, NOISE = 8e3, 1500.0, 64e3, 1 / 300


def decay(rows, seed, turn=0.0):
    """A vibration whose frequency is higher by turn·a² rad/s at amplitude a."""
    time, slow = np.arange(rows) / RATE, np.pi * HERTZ / QUALITY
    phase = 2 * np.pi * HERTZ * time + 0.3 + turn * (1.0 - np.exp(-2.0 * slow * time)) / (2.0 * slow)
    return time, np.exp(-slow * time) * np.cos(phase) + NOISE * np.random.default_rng(seed).standard_normal(rows)


@pytest.mark.parametrize(("turn", "span"), [(0.0, 0.1), (100.0, 0.1), (100.0, 0.02), (1000.0, 0.003)])
def test_a_phase_that_turns_is_told_beside_noise(turn, span):
    time, volts = decay(12800, 1, turn)
    track = tracked(time, volts, (2 * np.pi * 7e3, 2 * np.pi * 9e3)).seen
    whole = turn * span * (1.0 - np.exp(-2.0 * np.pi * HERTZ / QUALITY * track.time[-1]))
    assert track.turned(span) == pytest.approx(whole, rel=0.25, abs=0.3)


@pytest.mark.parametrize("seed", range(3))
def test_a_linear_decay_tells_all_there_is(tmp_path, seed):
    """Standard deviations are the bound of Cramér and Rao for amplitude, phase, frequency and decay of the rows
    that are fitted: pieces of a few hundred rows lost 6 to 300 times that.
    """
    time, volts = decay(6400, seed)
    table = np.column_stack([time, volts])
    np.savetxt(tmp_path / "decay.csv", table, fmt="%.10g", delimiter=",", header="t [s],y [V]", comments="")
    (tmp_path / "case.toml").write_text(f"""
schema = "memsgyro-case/1"
name = "decay"
device = "resonator"
[design]
resonance = {{ value = 8100, tolerance = 0.05, unit = "Hz" }}
quality_factor = {{ low = 200, high = 9000, unit = "1" }}
static_gain = {{ value = 1, tolerance = 0, unit = "1" }}
[readout]
scale = {{ value = 1, unit = "V/V" }}
[[experiment]]
name = "decay"
kind = "free_decay"
file = "decay.csv"
noise_std = {{ value = {NOISE}, unit = "V" }}
""")
    found = mg.compare(None, mg.load_case(tmp_path))
    half = time[:3200]

    def seen(number):
        amplitude, phase, hertz, quality = number
        return amplitude * np.exp(-np.pi * hertz / quality * half) * np.cos(2 * np.pi * hertz * half + phase)

    at, steps = np.array([1.0, 0.3, HERTZ, QUALITY]), np.array([1e-6, 1e-6, 1e-4, 1e-2])
    slopes = np.stack([(seen(at + step) - seen(at - step)) / 2 / max(step) for step in np.diag(steps)], axis=1)
    bound = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))[2:] * NOISE
    hertz, quality = found.fit.modes
    np.testing.assert_allclose([hertz.std, quality.std], bound, rtol=0.1)
    assert found.explained
    assert np.all(np.abs([hertz.value - HERTZ, quality.value - QUALITY]) < 4 * bound)
