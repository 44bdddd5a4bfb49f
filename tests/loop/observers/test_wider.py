"""Filters with a number beside the device's coefficients: the ratio of the read-out's scales, unequal cross damping."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError


GYRO, PERIOD = mg.SingleMassGyro.chi2010(), 1e-5
START = (8e-7, -5e-7, 1.2e-2, 9e-3)
REST = ("kxx", "kyy", "kxy", "dxx", "dyy", "sigma")


def readout(ratio=0.0, density=1e-9):
    return mg.DirectReadout((1e5, 1e5 * (1.0 + ratio)), offset=(1e-3, -2e-3), noise_density=density)


def moving(observer):
    prior = lambda made: made.filter.prior.motion  # noqa: E731
    return eqx.tree_at(prior, observer, tuple(map(jnp.asarray, START)))


@pytest.mark.slow
def test_an_update_of_the_ratio_is_that_of_dense_matrices():
    observer = moving(mg.ScaleRatioFilter.for_device(GYRO, readout(), ratio_std=0.2))
    observer = eqx.tree_at(lambda made: made.filter.prior.theta[-1], observer, jnp.asarray(0.05))
    density = lambda made: made.filter.noise_density  # noqa: E731
    deaf = eqx.tree_at(density, observer, tuple(1e9 * d for d in density(observer)))
    clock, force = mg.Clock(PERIOD, 1, PERIOD), (jnp.asarray(1e-6), jnp.asarray(-2e-6))
    measured = jnp.asarray([0.0789, -0.0514])
    predicted = deaf.update(observer.init(), tuple(measured), force, clock)
    done = observer.update(observer.init(), tuple(measured), force, clock)
    before, after = (np.concatenate([np.asarray(s.motion), s.constants]) for s in (predicted, done))
    inner = observer.filter
    covariance = np.asarray(inner.covariance(predicted))
    volts = lambda s: 1e5 * s[:2] * jnp.stack([jnp.asarray(1.0), 1.0 + s[-1]]) + s[4:6]  # noqa: E731
    rows = np.asarray(jax.jacfwd(volts)(jnp.asarray(before)))
    noise = np.diag(np.asarray([float(d) for d in density(observer)]) ** 2 * 0.5 / PERIOD)
    gain = covariance @ rows.T @ np.linalg.inv(rows @ covariance @ rows.T + noise)
    std = np.sqrt(np.diag(covariance))
    want = before + gain @ np.asarray(measured - volts(jnp.asarray(before)))
    np.testing.assert_allclose(after / std, want / std, rtol=1e-6, atol=1e-6)
    left = (covariance - gain @ rows @ covariance) / std / std[:, None]
    np.testing.assert_allclose(np.asarray(inner.covariance(done)) / std / std[:, None], left, atol=1e-6)
    assert float(observer.further(done).std) < 0.2, "a sample tells something of the ratio"
    np.testing.assert_array_equal(observer.covariance(done), inner.covariance(done)[:-1, :-1])
    assert observer.states == inner.states[:-1]
    assert "scale_ratio" not in observer.model.names


@pytest.mark.slow
def test_a_mismatch_that_is_found_costs_no_rate():
    """5 % between the channels, nothing drawn: the ratio comes out, and the rate is right."""
    observer = mg.ScaleRatioFilter.for_device(GYRO, readout(), known=("dxx", "dyy", "dxy", "sigma"), with_offsets=False)
    tones = ((mg.Tone(600.0, 53.95),), (mg.Tone(450.0, 53.95),))
    quiet = mg.DirectReadout((1e5, 1.05e5), noise_density=1e-12)
    start = (1e-6, 1e-6, 0.0, 0.0)
    observer = eqx.tree_at(lambda o: o.filter.prior.motion, observer, tuple(map(jnp.asarray, start)))
    loop = mg.ClosedLoop(GYRO, quiet, observer, mg.OpenLoop(tuple((t,) for t in _forces(tones))), start=start)
    state, scenario = loop.init(), mg.Scenario(mg.Constant(1.0))

    @jax.jit
    def run(state):
        def sample(state, i):
            clock = mg.Clock(i * PERIOD, i, PERIOD)
            return loop.step(state, scenario.at(clock.time), (0.0, 0.0), clock)[0], None

        return jax.lax.scan(sample, state, jnp.arange(1000))[0]

    state = run(jax.tree.map(lambda value: jnp.asarray(value, float), state))
    found = observer.further(state.observer)
    assert abs(float(found.value) - 0.05) < 1e-4
    assert abs(float(loop.estimate(state).rate) - 1.0) < 0.02


def _forces(tones):
    return [mg.Tone(tone.frequency, 1.8e-7 * tone.amplitude) for (tone,) in tones]


def test_a_known_rate_opens_when_its_phase_ends():
    """Known at once and after; then the claim of the rate holds the asymmetry's uncertainty, a quarter of it."""
    settings = {"known": REST, "with_offsets": False, "prior": mg.design_prior(GYRO, rate_std=2.0)}
    observer = mg.KnownRateFilter.for_device(
        GYRO, readout(density=1e-3), until=2.5 * PERIOD, rate=mg.Ramp(0.0, 1e4, 0.5), asymmetry=0.1, **settings
    )
    state = moving(observer).init()
    stds = []
    for number in range(5):
        clock = mg.Clock(number * PERIOD, number, PERIOD)
        state = observer.update(state, (0.05, -0.05), (0.0, 0.0), clock)
        found = observer.estimate(state)
        stds.append(float(jnp.sqrt(found.rate_variance)))
        if number < 3:
            assert float(found.rate) == pytest.approx(0.5 + 1e4 * max(0.0, (number - 0.5) * PERIOD), abs=1e-12)
    np.testing.assert_allclose(stds[:3], 0.0, atol=1e-12)
    np.testing.assert_allclose(stds[3:], 2.0, rtol=1e-2)
    assert float(observer.further(state).std) == pytest.approx(0.1 * float(GYRO.dxy / GYRO.mass), rel=1e-2)


def test_asymmetry_and_rate_share_what_turns_the_vibration():
    """A quarter of (dyx - dxy)/m: many samples tell the sum, at the known rate the asymmetry alone."""
    observer = mg.KnownRateFilter.for_device(GYRO, readout(), until=1.0)
    rate, asymmetry = (observer.filter.model.coefficients[i] for i in (0, -1))
    for a, b in zip(rate.terms, asymmetry.terms, strict=True):
        assert (a.axis, a.signal) == (b.axis, b.signal)
        assert a.factor == 4.0 * b.factor


@pytest.mark.parametrize("kind", [mg.ScaleRatioFilter, mg.KnownRateFilter])
def test_what_cannot_be_told_is_refused(kind):
    further = {"until": 0.1} if kind is mg.KnownRateFilter else {}
    with pytest.raises(InputError, match="must watch a `SingleMassGyro`"):
        kind.for_device(mg.DualMassGyro.chi2010(), readout(), **further)
    with pytest.raises(InputError, match="must have one iteration and no fading"):
        kind.for_device(GYRO, readout(), iterations=2, **further)


def test_a_known_phase_needs_a_rate_to_open():
    with pytest.raises(InputError, match="must estimate the rate, but `known` holds it"):
        mg.KnownRateFilter.for_device(GYRO, readout(), until=0.1, known=("rate",))


@pytest.mark.slow
def test_the_common_scale_goes_with_the_mass():
    """Both scales unknown: one null direction, in which motion, mass and scales move and the rate does not."""
    tones = ((mg.Tone(600.0, 53.95),), (mg.Tone(450.0, 53.95),))
    observer = mg.ExtendedKalmanFilter.for_device(GYRO, readout())
    noisy = readout(density=float(mg.ChargeAmplifier.chi2010().noise_density[0]))
    loop = mg.ClosedLoop(GYRO, noisy, observer, mg.DampingCompensation(tones), start=(1e-6, 1e-6, 0.0, 0.0))
    found = mg.observability(loop, duration=0.005, also=mg.READOUT_SCALES)
    assert found.rank.max() == len(found.names) - 1
    (null,) = found.null
    assert set(null) == {"x", "y", "sigma", "scale_x", "scale_y"}
    assert null["scale_x"] == pytest.approx(null["scale_y"], rel=1e-9)
    assert null["sigma"] / float(1.0 / GYRO.mass) == pytest.approx(-null["scale_x"], rel=1e-6)
    told = mg.information_bound(loop, 1.0, duration=0.1, also=mg.READOUT_SCALES[1:], windows=1)
    assert 1e-5 < float(told.of("scale_y")[-1]) < 7e-5
