"""The function of thesis 4.3 along real runs: its slope is what theory says, and the run follows it."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.loop.lyapunov_function import least_gain, lyapunov_function


READOUT = mg.DirectReadout.of_velocity(1.0)
DEVICES = {"one mass": mg.SingleMassGyro.chi2010(), "two masses": mg.DualMassGyro.chi2010()}
SAMPLE_RATE = 2e6


HASTE = mg.Annealing(excess=4.0, decay=0.5e-3)


def closed(gyro, gain=5.0) -> mg.ClosedLoop:
    """Coefficients are adapted by gains of their own, faster at first."""
    start, made = (1e-6, 1e-6, 0.0, 0.0), mg.LyapunovObserver.for_device
    observer = made(gyro, READOUT, gain=gain, start=0.8, motion=start, annealing=HASTE)
    gains = tuple(0.5 + 0.1 * i for i in range(len(observer.adaptation)))
    observer = eqx.tree_at(lambda o: o.adaptation, observer, tuple(map(jnp.asarray, gains)))
    return mg.ClosedLoop(gyro, READOUT, observer, mg.ReferenceModel((3000.0, 5000.0), mg.Tone(600.0, 50.0)), start)


@pytest.fixture(scope="module", params=DEVICES)
def trace(request):
    return mg.simulate(closed(DEVICES[request.param]), 1.0, sample_rate=SAMPLE_RATE, duration=1e-3, decimation=2)


def test_the_slope_is_that_of_theory_and_never_rises(trace):
    found = lyapunov_function(trace)
    size = np.max(np.abs(found.slope))
    np.testing.assert_allclose(found.slope, found.expected, rtol=1e-11, atol=1e-12 * np.max(found.value))
    assert size > 0.0
    assert np.max(found.slope) <= 1e-12 * size


def test_a_run_loses_what_the_slope_says(trace):
    """V falls by the integral of its slope, but for what the samples' length leaves: a gain of 5 closes 5 % in one."""
    found, observer = lyapunov_function(trace), trace.loop.observer
    time = trace.time * float(observer.frequency)
    lost = np.concatenate([[0.0], np.cumsum(np.diff(time) * 0.5 * (found.slope[1:] + found.slope[:-1]))])
    assert found.value[-1] < 0.9 * found.value[0]
    np.testing.assert_allclose(found.value - found.value[0], lost, atol=0.05 * (found.value[0] - found.value[-1]))


def test_two_masses_need_the_weights():
    trace = mg.simulate(closed(DEVICES["two masses"]), 1.0, sample_rate=SAMPLE_RATE, duration=1e-3, decimation=2)
    printed = lyapunov_function(trace, weighted=False)
    left_out = printed.slope - printed.expected
    assert np.max(left_out) > 1e-5 * np.max(np.abs(printed.slope)), "of either sign"
    assert np.min(left_out) < -1e-5 * np.max(np.abs(printed.slope))


def test_the_least_gain():
    assert least_gain(DEVICES["one mass"], 3.0) == pytest.approx(0.0, abs=1e-9)
    assert least_gain(DEVICES["two masses"], 1.0) == pytest.approx(1.096, abs=1e-3)
    assert least_gain(DEVICES["two masses"], -2.0) == pytest.approx(2.0 * 1.096, abs=2e-3)


@pytest.mark.slow
def test_what_has_no_such_function():
    gyro, readout = DEVICES["one mass"], mg.ChargeAmplifier.chi2010()
    loop = mg.ClosedLoop(gyro, readout, mg.ExtendedKalmanFilter.for_device(gyro, readout), mg.OpenLoop())
    other = mg.simulate(loop, 1.0, sample_rate=1e5, duration=1e-4)
    with pytest.raises(mg.InputError, match="must have a LyapunovObserver, but its observer is ExtendedKalmanFilter"):
        lyapunov_function(other)
    with pytest.raises(mg.InputError, match="must be a run that `simulate` returned, but is of type ClosedLoop"):
        lyapunov_function(loop)
