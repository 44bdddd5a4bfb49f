"""`jax.grad`, `jax.jvp` and `jax.vmap` from outside, over what a user calls."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg


RUN = {"sample_rate": 100e3, "duration": 2e-3, "seed": 1}
GYRO, READOUT = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
KNOWN = tuple(name for name in GYRO.model.names if name != "rate")  # a small filter compiles faster
OBSERVER = mg.ExtendedKalmanFilter.for_device(GYRO, READOUT, known=KNOWN, with_offsets=False, annealing=mg.Annealing())
LOOP = mg.ClosedLoop(GYRO, READOUT, OBSERVER, mg.DampingCompensation(mg.Tone(600.0, 53.95)))
VELOCITY = mg.DirectReadout.of_velocity(5.0, 1e-6)
SWINGING = mg.ClosedLoop(GYRO, VELOCITY, mg.LyapunovObserver.for_device(GYRO, VELOCITY), mg.OpenLoop())


def stiffened(kxx, loop=LOOP) -> mg.ClosedLoop:
    return eqx.tree_at(lambda made: made.device.kxx, loop, jnp.asarray(kxx, float))


@pytest.mark.slow
def test_a_trace_is_differentiated_and_keeps_its_settings():
    seen = []

    def last(kxx):
        trace = mg.simulate(stiffened(kxx, SWINGING), 1.0, **RUN)
        seen.append(trace.settings)
        return trace.rate_estimate[-1]

    value, slope = jax.value_and_grad(last)(63.96)
    step = 1e-3
    difference = (last(63.96 + step) - last(63.96 - step)) / (2.0 * step)
    assert value == pytest.approx(last(63.96), rel=1e-9)
    assert slope == pytest.approx(difference, rel=1e-6)
    assert seen[0] == seen[-1] != seen[1]


@pytest.mark.slow
def test_a_trace_of_many_devices_equals_theirs():
    stiffness = np.array([62.0, 63.96, 66.0])
    many = jax.vmap(lambda kxx: mg.simulate(stiffened(kxx), 1.0, **RUN))(stiffness)
    assert many.rate_estimate.shape == (3, 200)
    with pytest.raises(mg.InputError, match="holds several runs"):
        many.to_pandas()
    assert "(3, 200)" in repr(many)
    for row, kxx in enumerate(stiffness):
        one = mg.simulate(stiffened(kxx), 1.0, **RUN)
        for name in ("rate_estimate", "motion", "volts", "nis"):
            np.testing.assert_allclose(getattr(many, name)[row], getattr(one, name), rtol=1e-6, atol=1e-12)


def _classic() -> mg.ClosedLoop:
    control = mg.ClassicControl.force_rebalance(GYRO, READOUT, amplitude=1e-6)
    return mg.ClosedLoop(GYRO, READOUT, mg.NoObserver.for_device(GYRO, READOUT), control)


def _filtered() -> mg.ClosedLoop:
    return eqx.tree_at(lambda loop: loop.filter, SWINGING, mg.Lowpass("100 Hz"), is_leaf=lambda leaf: leaf is None)


@pytest.mark.parametrize("made", [_filtered, _classic])
def test_a_compiled_function_closes_over_a_loop(made):
    """Of a filter and of classic control, which are looked at before a run: their numbers are known all the same."""
    loop = made()
    shapes = jax.eval_shape(jax.jit(lambda rate: mg.simulate(loop, rate, **RUN).rate_estimate), 1.0)
    assert shapes.shape == (200,)


@pytest.mark.slow
def test_a_trace_comes_out_of_a_compiled_function():
    trace = jax.jit(lambda kxx: mg.simulate(stiffened(kxx), 1.0, **RUN))(63.96)
    plain = mg.simulate(LOOP, 1.0, **RUN)
    np.testing.assert_allclose(trace.volts, plain.volts, rtol=1e-9)
    assert (trace.lost_at, trace.settings.fingerprint) == (None, "")
    assert plain.settings.fingerprint


def test_mode_frequencies_follow_every_number_of_the_device():
    lower = lambda gyro: mg.mode_frequencies(gyro)[0]  # noqa: E731
    slopes = jax.grad(lower)(GYRO)
    for name in ("mass", "kxx", "kxy"):
        value = float(getattr(GYRO, name))
        by = lambda new, name=name: lower(eqx.tree_at(lambda g: getattr(g, name), GYRO, jnp.asarray(new)))  # noqa: E731
        difference = (by(value * (1 + 1e-6)) - by(value * (1 - 1e-6))) / (2e-6 * value)
        assert getattr(slopes, name) == pytest.approx(difference, rel=1e-7)
    assert slopes.dxx == 0.0
    many = jax.vmap(lambda kxx: mg.mode_frequencies(stiffened(kxx).device))(jnp.array([60.0, 63.96]))
    np.testing.assert_allclose(many[1], mg.mode_frequencies(GYRO), rtol=1e-14)


def bound_of(kxx, **options) -> mg.InformationBound:
    loop = eqx.tree_at(lambda loop: loop.device.kxx, SWINGING, jnp.asarray(kxx, float))
    return mg.information_bound(loop, 1.0, sample_rate=100e3, duration=4e-3, windows=1, **options)


@pytest.mark.slow
def test_the_bound_is_differentiated():
    end = lambda kxx: bound_of(kxx, prior=LOOP.observer.prior).rate_std[-1]  # noqa: E731
    value, slope = jax.value_and_grad(end)(63.96)
    assert value == pytest.approx(float(end(63.96)), rel=1e-9)
    assert float(slope) == pytest.approx((end(63.96 + 1e-3) - end(63.96 - 1e-3)) / 2e-3, rel=1e-5)


@pytest.mark.slow
def test_a_bound_without_prior_has_slopes_where_it_is_finite_and_is_mapped():
    """The rate cannot be told from unequal cross damping; what can be told has its derivative still."""
    bound = lambda kxx: bound_of(kxx, also=(mg.CROSS_DAMPING_ASYMMETRY,))  # noqa: E731
    end = lambda kxx: bound(kxx).of("kyy")[-1]  # noqa: E731
    assert np.isinf(bound(63.96).rate_std[-1])
    _, slope = jax.jvp(end, (63.96,), (1.0,))
    assert float(slope) == pytest.approx((end(63.96 + 1e-3) - end(63.96 - 1e-3)) / 2e-3, rel=1e-5)
    many = jax.vmap(bound)(jnp.array([60.0, 63.96]))
    np.testing.assert_allclose(many.std[1], bound(63.96).std, rtol=1e-7)


def test_what_no_transformation_goes_through_is_said():
    """The number of samples is structure, and a sweep keeps a table of its dies."""
    with pytest.raises(mg.InputError, match=r"`duration` decides how many samples .* cannot go through jax.grad"):
        jax.grad(lambda duration: mg.simulate(SWINGING, 1.0, **RUN | {"duration": duration}).rate_estimate[-1])(2e-3)
    with pytest.raises(mg.InputError, match="`sample_rate` decides how many samples"):
        jax.vmap(lambda rate: mg.information_bound(SWINGING, 1.0, sample_rate=rate).rate_std)(jnp.array([1e5, 2e5]))
    spread = mg.Spread.relative(0.1)
    for function, word in (
        (lambda loop: mg.datasheet(loop, spread, dies=4, sample_rate=1e5, duration=1e-3), "`datasheet` makes tables"),
        (lambda loop: mg.tornado(loop, spread, sample_rate=1e5, duration=1e-3), "A sensitivity is a table"),
        (lambda loop: mg.tune(loop, free=mg.free(["device.kxx"]), sample_rate=1e5, duration=1e-3), "`tune` decides by"),
        (lambda loop: mg.gain_phase_margins(loop), "or take `loop_margins`"),
        (lambda loop: mg.observability(loop, sample_rate=1e5, duration=1e-3), "or take `information_bound`"),
        (lambda loop: mg.design_motion(loop.device), "`design_motion` searches"),
    ):
        with pytest.raises(mg.InputError, match=word):
            jax.eval_shape(lambda kxx, function=function: function(stiffened(kxx)), 63.96)
    sweep = lambda kxx: mg.sweep(stiffened(kxx), mg.Spread.relative(0.1), dies=2, sample_rate=1e5, duration=1e-3)  # noqa: E731
    with pytest.raises(mg.InputError, match=r"A sweep keeps a table of its dies .*`Spread.draw`"):
        jax.jvp(lambda kxx: sweep(kxx).rate_error, (63.96,), (1.0,))
