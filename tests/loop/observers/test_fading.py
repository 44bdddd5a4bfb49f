"""The factors of fading memory and annealing, by hand."""

import jax.numpy as jnp
import numpy as np
import pytest
from oracles.kalman import Xia

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import DualMassGyro, SingleMassGyro
from memsgyro_jax.loop.observers.fading import AdaptiveFading, FixedFading
from memsgyro_jax.loop.observers.settings import Annealing, Prior, ProcessNoise, design_prior


def factor_of(fading, period):
    return float(fading.factor((), (1.0, 1.0), (0.0, 0.0), (1.0, 1.0), period)[0])


def test_a_factor_per_sample_keeps_its_memory_at_another_rate():
    """The thesis' 1.00014 at 10 MHz is 1400/s; a hundred times fewer samples forget a hundred times more each."""
    fading = FixedFading.per_sample(1.00014, 10e6)
    assert float(fading.forgetting) == pytest.approx(1400.0, rel=1e-4)
    assert factor_of(fading, 1e-7) == pytest.approx(1.00014, rel=1e-12)
    assert factor_of(fading, 1e-5) == pytest.approx(1.00014**100, rel=1e-10)


def test_no_forgetting_is_the_plain_filter():
    assert factor_of(FixedFading(), 1e-5) == 1.0
    assert factor_of(FixedFading(0.0), 1e-3) == 1.0


def test_adaptive_factor_is_excess_over_expectation():
    """One sample: λ = (Σe² - Σr)/Σs, held between 1 and the ceiling."""
    fading, memory = AdaptiveFading(1e-3, 1.5), AdaptiveFading().init()
    for innovation, expected in (((1.0, 1.0), 1.0), ((2.0, 1.0), 1.2), ((3.0, 4.0), 1.5)):
        factor, _ = fading.factor(memory, (1.0, 1.5), innovation, (1.0, 1.0), 1e-5)
        assert float(factor) == pytest.approx(expected, rel=1e-12)


def test_adaptive_memory_is_an_exponential_average():
    fading, oracle = AdaptiveFading(5e-5, 3.0), Xia(5e-5, 3.0, 1e-5)
    memory, rng = fading.init(), np.random.default_rng(0)
    for innovation in 1.7 * rng.standard_normal((50, 2)):
        factor, memory = fading.factor(memory, (0.5, 0.5), tuple(innovation), (1.0, 1.0), 1e-5)
        assert float(factor) == pytest.approx(oracle([0.5, 0.5], innovation, [1.0, 1.0]), rel=1e-12)


def test_annealing_decays_to_one():
    annealing = Annealing(1000.0, 5e-4)
    assert float(annealing.factor(0.0)) == pytest.approx(1001.0)
    assert float(annealing.factor(5e-4)) == pytest.approx(1 + 1000 / np.e)
    assert float(annealing.factor(1.0)) == 1.0
    assert float(Annealing(0.0).factor(0.0)) == 1.0


def test_design_prior_has_the_stated_widths():
    prior = design_prior(SingleMassGyro.chi2010(), spread=0.1, rate_std=2.0, offset_std=1e-2, motion_error=0.02)
    theta = np.array(prior.theta)
    assert theta[0] == 0.0
    # A stiffness and a mass of 10 % each make a quotient of 14.1 %; 1/mass alone has the mass' own 10 %.
    relative = 0.1 * np.array([2**0.5] * 6 + [1.0])
    assert np.allclose(np.array(prior.theta_std), [2.0, *(relative * theta[1:])], rtol=1e-12)
    assert [float(o) for o in prior.offset_std] == [1e-2, 1e-2]
    w = np.sqrt(theta[1:3])
    assert np.allclose(np.array(prior.motion_std), 0.02e-6 * np.array([1, 1, *w]), rtol=1e-14)


def test_design_prior_shares_the_rate_between_two_masses():
    prior = design_prior(DualMassGyro.chi2010(), rate_std=2.6)
    assert np.allclose(np.array(prior.theta_std[:2]), [1.6, 2.6], rtol=1e-14)


def test_process_noise_takes_one_value_per_die():
    noise = ProcessNoise.of(SingleMassGyro.chi2010().model, rate=jnp.array([1.0, 2.0]))
    assert noise.theta[0].shape == (2,)


def prior_with(**change):
    design = design_prior(SingleMassGyro.chi2010())
    names = ("motion", "motion_std", "offset", "offset_std", "theta", "theta_std")
    return Prior(**{name: getattr(design, name) for name in names} | change)


BAD = [
    (lambda: FixedFading(-1.0), "`forgetting` must be finite and not negative, but -1"),
    (lambda: FixedFading.per_sample(0.99, 1e5), "`forgetting` must be finite and not negative"),
    (lambda: AdaptiveFading(0.0), "`window` must be positive and finite, but 0"),
    (lambda: AdaptiveFading(1e-3, 0.9), "`ceiling - 1` must be finite and not negative, but -0.1"),
    (lambda: Annealing(-1.0), "`excess` must be finite and not negative"),
    (lambda: Annealing(10.0, 0.0), "`decay` must be positive"),
    (lambda: ProcessNoise((0.0,) * 4, (0.0, -1.0), (0.0,) * 8), "`offset` must be finite and not negative, but -1"),
    (lambda: ProcessNoise((0.0,) * 3, (0.0,) * 2, (0.0,) * 8), "`motion` must have 4 entries, but 3"),
    (lambda: prior_with(theta_std=(1.0,) * 7), "`theta_std` must have 8 entries, but 7"),
    (lambda: prior_with(motion_std=(1.0, 1.0, -1.0, 1.0)), "`motion_std` must be finite and not negative, but -1"),
    (lambda: prior_with(offset_std=(1.0, float("nan"))), "`offset_std` must be finite and not negative, but nan"),
]


@pytest.mark.parametrize(("make", "words"), BAD, ids=[words for _, words in BAD])
def test_impossible_settings_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()
