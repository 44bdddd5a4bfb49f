"""Further resonances in the sweep of a device of one axis, as a hammer finds them."""

import numpy as np
import pytest

from memsgyro_jax.measurement.experiments.base import Phasors
from memsgyro_jax.measurement.further_peaks import further_peaks


OMEGA = 2 * np.pi * np.arange(2.0, 190.0)


def hit(modes, seed, noise=1e-3, axes=1):
    """Responses of modes (frequency [Hz], quality factor, height) to 2 N."""
    rng, motion = np.random.default_rng(seed), np.zeros(OMEGA.size, complex)
    for frequency, quality, height in modes:
        natural = 2 * np.pi * frequency
        motion += height * natural**2 / quality / (natural**2 - OMEGA**2 + 1j * OMEGA * natural / quality)
    motion += noise * (rng.standard_normal(OMEGA.size) + 1j * rng.standard_normal(OMEGA.size))
    return Phasors(
        OMEGA,
        2.0 * np.outer(motion, np.ones(axes)),
        np.full((OMEGA.size, axes), 2.0 + 0j),
        np.full(OMEGA.size, 0.5 / noise),
    )


@pytest.mark.parametrize("height", [0.2, 3.0])
def test_a_second_mode_is_told(height):
    for seed in range(5):
        found = further_peaks(
            [hit([(51.4, 60.0, 1.0), (142.3, 90.0, height)], seed)], 2 * np.pi * 51.4, 2 * np.pi * 0.86
        )
        ((place, high),) = found
        assert place == pytest.approx(142.0, abs=1.0)
        assert high == pytest.approx(height, rel=0.5)


def test_one_mode_in_noise_has_no_other():
    for seed in range(200):
        assert further_peaks([hit([(51.4, 60.0, 1.0)], seed, 0.03)], 2 * np.pi * 51.4, 2 * np.pi * 0.86) == []
    sharp = hit([(51.4, 4000.0, 1.0)], 1)  # of which the nearest row is half a row off
    assert further_peaks([sharp], 2 * np.pi * 51.4, 2 * np.pi * 0.013) == []


def test_two_axes_and_a_mode_that_is_not_there_tell_none():
    both = [(51.4, 60.0, 1.0), (142.3, 90.0, 1.0)]
    assert further_peaks([hit(both, 1, axes=2)], 2 * np.pi * 51.4, 5.4) == []
    assert further_peaks([hit(both, 1)], 2 * np.pi * 900.0, 5.4) == []
