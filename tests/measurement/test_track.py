"""How far a vibration turns, told beside noise."""

import numpy as np
import pytest

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
