"""A waveform that ends at a value that it cannot exceed is told, and none that merely turns there."""

import numpy as np
import pytest

from memsgyro_jax.measurement.experiments.clipping import clipped, clipped_rows


def sine(rows=2000, a_period=10.3, amplitude=1.0, phase=0.3, noise=0.0):
    draw = np.random.default_rng(1).normal(size=rows)
    return amplitude * np.cos(2 * np.pi * np.arange(rows) / a_period + phase) + noise * draw


@pytest.mark.parametrize("step", [0.0, 2.0**-10])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_flat_top_is_told_at_both_ends(step, noise):
    values = np.clip(sine(noise=noise), -0.8, 0.8)
    values = np.round(values / step) * step if step else values
    high, low = clipped("chirp.csv", "channel x", values, " V")
    assert high.startswith(f"chirp.csv: channel x has its largest value, {np.max(values):.4g} V, in ")
    assert f"smallest value, {np.min(values):.4g} V" in low
    assert len(clipped("chirp.csv", "channel x", np.clip(sine(noise=noise), -2.0, 0.8), " V")) == 1


@pytest.mark.parametrize("a_period", [2, 3, 4, 5, 6, 8, 12, 100, 10.3, 250.0])
@pytest.mark.parametrize("phase", [0.0, np.pi / 8, np.pi / 4, 0.3])
@pytest.mark.parametrize("step", [0.0, 2.0**-4, 2.0**-9])
def test_a_clean_sine_of_few_rows_or_steps_is_not(a_period, phase, step):
    for amplitude in (1.0, 0.973):
        values = sine(a_period=a_period, phase=phase, amplitude=amplitude)
        assert clipped("a.csv", "channel x", np.round(values / step) * step if step else values, "") == []


def test_neither_silence_nor_a_decay_nor_noise_is():
    time = np.arange(4000)
    for values in (np.zeros(50), sine(4000) * np.exp(-time / 300), np.random.default_rng(2).normal(size=4000)):
        for step in (1e-9, 2.0**-6):
            assert clipped("a.csv", "channel x", np.round(values / step) * step, "") == []


def test_a_decay_that_is_clipped_at_its_begin_is_told_whatever_follows():
    """A ring-down on an oscilloscope: nine tenths of its rows lie at zero."""
    time = np.arange(20_000)
    for noise in (0.0, 2e-3):
        values = 2.4 * sine(20_000, a_period=19.1, noise=noise) * np.exp(-time / 1000)
        steps = np.round(np.clip(values, -1.0, 1.0 - 2.0**-7) * 2.0**7) / 2.0**7
        assert len(clipped("scope.csv", "channel x", steps, " V")) == 2
        assert np.isclose(clipped_rows(steps)[-1], 1000 * np.log(2.4), atol=20)


def test_a_vibration_that_was_kept_up_before_it_died_out_is_not():
    time = np.arange(8000)
    for a_period in (4, 5, 6, 12, 100, 19.1):
        values = sine(8000, a_period=a_period, phase=0.0) * np.exp(-np.maximum(time - 6000, 0) / 300)
        for step in (2.0**-4, 2.0**-9):
            assert clipped_rows(np.round(values / step) * step).size == 0
