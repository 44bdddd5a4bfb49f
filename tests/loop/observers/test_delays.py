"""A Kalman filter that finds the delays of its read-out: one update against dense matrices."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError


EXPECTED, READOUT = mg.UncertainGyro(mg.SingleMassGyro.chi2010()), mg.ChargeAmplifier.chi2010()


def prior() -> mg.Prior:
    usual = mg.design_prior(EXPECTED.gyro)
    full, known = EXPECTED.prior(usual, mg.ModelErrors(delay=1e-5), ("sigma",))
    assert known == (), "a known mass is hidden by the mean error of the gains"
    late = eqx.tree_at(lambda made: made.theta[-2:], full, (jnp.asarray(2e-5), jnp.asarray(-1e-5)))
    return eqx.tree_at(lambda made: made.motion, late, tuple(map(jnp.asarray, (8e-7, -5e-7, 1.2e-2, 9e-3))))


@pytest.mark.slow
def test_an_update_is_that_of_dense_matrices():
    observer = mg.ExtendedKalmanFilter.for_device(EXPECTED, READOUT, prior=prior())
    deaf = dataclasses.replace(observer, noise_density=tuple(1e9 * d for d in observer.noise_density))
    clock, force = mg.Clock(1e-5, 1, 1e-5), (jnp.asarray(1e-6), jnp.asarray(-2e-6))
    measured = jnp.asarray([-0.0789, 0.0514])
    predicted = deaf.update(observer.init(), tuple(measured), force, clock)
    done = observer.update(observer.init(), tuple(measured), force, clock)
    before, after = (np.concatenate([np.asarray(s.motion), s.constants]) for s in (predicted, done))
    covariance = np.asarray(observer.covariance(predicted))
    scale = jnp.asarray([float(s) for s in READOUT.scale])
    volts = lambda state: scale * (state[:2] - state[-2:] * state[2:4]) + state[4:6]  # noqa: E731
    rows = np.asarray(jax.jacfwd(volts)(jnp.asarray(before)))
    noise = np.diag(np.asarray([float(d) for d in observer.noise_density]) ** 2 * 0.5e5)
    gain = covariance @ rows.T @ np.linalg.inv(rows @ covariance @ rows.T + noise)
    std = np.sqrt(np.diag(covariance))
    want = before + gain @ np.asarray(measured - volts(jnp.asarray(before)))
    np.testing.assert_allclose(after / std, want / std, rtol=1e-6, atol=1e-6)
    left = covariance - gain @ rows @ covariance
    np.testing.assert_allclose(
        np.asarray(observer.covariance(done)) / std / std[:, None], left / std / std[:, None], atol=1e-6
    )
    assert left[-1, -1] < 0.9 * covariance[-1, -1], "a sample tells something of the delay"


@pytest.mark.parametrize("settings", [{"iterations": 2}, {"fading": mg.FixedFading(100.0)}])
def test_what_does_not_go_with_delays_is_refused(settings):
    with pytest.raises(
        InputError, match="estimates delays must have a displacement read-out, one iteration and no fad"
    ):
        mg.ExtendedKalmanFilter.for_device(EXPECTED, READOUT, prior=prior(), **settings)


def test_a_velocity_readout_has_no_delays():
    with pytest.raises(InputError, match="estimates delays must have a displacement read-out"):
        mg.ExtendedKalmanFilter.for_device(EXPECTED, mg.DirectReadout.of_velocity(1.0, 1e-9), prior=prior())


def test_a_late_readout_shows_where_the_mass_was():
    late = mg.Delayed(READOUT, (1e-6, 0.0))
    motion, silent = (1e-6, 2e-6, 0.02, 0.03), (0.0, 0.0)
    got = late.measure(motion, silent, silent, 1e-5)
    want = READOUT.measure((1e-6 - 0.02e-6, 2e-6, 0.02, 0.03), silent, silent, 1e-5)
    assert np.allclose(got, want, rtol=1e-12)
    assert late.noise_std(1e-5) == READOUT.noise_std(1e-5)
