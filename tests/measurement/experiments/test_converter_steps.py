"""A decay ends where the steps of a converter hide it, and nowhere where noise carries it across them."""

import numpy as np
import pytest

from memsgyro_jax.measurement.experiments.converter_steps import lost_in_steps, step_of


TIME = np.arange(20_000)


def decayed(step, noise, decimals=9):
    draw = noise * np.random.default_rng(1).standard_normal(TIME.size)
    values = 2.0 * np.exp(-TIME / 2000) * np.cos(0.33 * TIME) + draw
    return np.round(np.round(values / step) * step, decimals)


@pytest.mark.parametrize("noise", [0.0, 0.25])
@pytest.mark.parametrize(("step", "decimals"), [(2.0**-6, 9), (2.0**-7, 5)])
def test_a_decay_ends_at_four_steps(step, noise, decimals):
    end, found = lost_in_steps(decayed(step, noise * step, decimals))
    assert found == pytest.approx(step, rel=1e-2)
    assert end == pytest.approx(2000 * np.log(2.0 / (4.0 * step)), abs=300)


def test_what_noise_carries_across_the_steps_goes_on():
    assert lost_in_steps(decayed(2.0**-7, 2.0**-7))[0] == TIME.size
    assert lost_in_steps(decayed(2.0**-7, 2.0**-7)[:5000])[0] == 5000
    assert step_of(decayed(1e-9, 1e-3)) == 0.0
    assert lost_in_steps(np.zeros(1000))[0] == 1000
