"""Devices behind what comes late by many periods, of readings made by other code."""

import numpy as np
import pytest

from memsgyro_jax.measurement.experiments.base import Phasors
from memsgyro_jax.measurement.one_resonance import lateness
from memsgyro_jax.measurement.phasor_fit import device_of_phasors


F0, Q, ROWS, NOISE = 7.86e9, 2300.0, 91, 0.004
OMEGA = 2 * np.pi * (F0 + 3.0 * F0 / Q * np.linspace(-1.0, 1.0, ROWS))
SPAN = np.ptp(OMEGA)


def read(delay, seed, leak=0.0, bend=0.0):
    """Phasors of a device whose largest is one, late by a delay beside the middle of the band."""
    natural, rng = 2 * np.pi * F0, np.random.default_rng(seed)
    place = (OMEGA - natural) / (0.5 * natural / Q)
    size = np.zeros(ROWS)
    for _ in range(200):  # a resonance that bends over by few of its widths
        size = 0.5 * (size + 1.0 / (1.0 + (place - bend * size) ** 2))
    seen = leak + 1.0 / (1.0 + 1j * (place - bend * size))
    seen = seen * np.exp(0.7j - 1j * (OMEGA - np.median(OMEGA)) * delay)
    seen = seen + NOISE * (rng.standard_normal(ROWS) + 1j * rng.standard_normal(ROWS))
    way = np.arange(ROWS)[:: 1 if seed % 4 else -1]  # up or down
    return OMEGA[way], seen[way], np.ones(ROWS, complex), np.full(ROWS, 1.0 / NOISE)


@pytest.mark.parametrize("leak", [0.0, -1.6 + 0.5j])
@pytest.mark.parametrize("turns", [-40.0, 3.0, 8.0, 100.0])
def test_a_delay_of_many_periods_is_told(turns, leak):
    """In rad over the band, of 91 rows: at the last a row turns by 1.1. A background holds two of them."""
    for seed in (2, 4):
        seen = lateness(*read(turns / SPAN, seed, leak))
        assert seen is not None
        assert seen.delay * SPAN == pytest.approx(turns, abs=2.0)
        stiffness, damping, _ = seen.device
        assert np.sqrt(stiffness[0]) / damping[0] == pytest.approx(Q, rel=0.05)
        assert np.sqrt(stiffness[0]) / (2 * np.pi) == pytest.approx(F0, rel=0.02 / Q)


@pytest.mark.parametrize(("leak", "bend"), [(0.0, 0.0), (-1.6 + 0.5j, 0.0), (0.0, 1.2), (0.3, -1.2)])
def test_what_is_not_late_is_not_told_to_be(leak, bend):
    for seed in (2, 4):
        assert lateness(*read(0.0, seed, leak, bend=bend)) is None


def test_noise_and_a_band_without_a_drive_tell_nothing():
    omega, seen, force, weight = read(8.0 / SPAN, 2)
    assert lateness(omega, seen, 0.0 * force, weight) is None
    assert lateness(np.full(ROWS, omega[0]), seen, force, weight) is None
    noise = np.random.default_rng(3).standard_normal((2, ROWS))
    assert lateness(omega, NOISE * (noise[0] + 1j * noise[1]), force, weight) is None


def test_the_device_of_late_phasors_is_that_without_the_delay():
    """50 ns of cable had it begin far from its resonance."""
    omega, seen, force, weight = read(8.0 / SPAN, 2, -1.6 + 0.5j)
    device = device_of_phasors([Phasors(omega, seen[:, None], force[:, None], weight)])
    assert np.sqrt(device.stiffness[0]) / device.damping[0] == pytest.approx(Q, rel=0.05)
