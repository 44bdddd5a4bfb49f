"""How far kicks are from effects that act at every moment: told without integrating, and where a record shows it."""

import equinox as eqx
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.loop.kicks import _replayed, kick_error


RATE, STEPS = 140e3, 1400


@pytest.fixture(scope="module")
def loop():
    gyro = mg.SingleMassGyro.from_modes("1 mg", ("5 kHz", "5.2 kHz"), (500, 700), quadrature="10 deg/s")
    readout = mg.DirectReadout(1e5, noise_density=1e-7)
    force = float(gyro.kxx) * 5e-6 / 150
    device = gyro.with_effect(mg.effects.CubicStiffness("x", 0.02 * float(gyro.kxx) / (5e-6) ** 2))
    drive = mg.OpenLoop(((mg.Tone(5000.0, force), mg.Tone(5080.0, force)), (mg.Tone(5200.0, force / 2),)))
    observer = mg.ExtendedKalmanFilter.for_device(gyro, readout)
    return mg.ClosedLoop(device, readout, observer, drive, start=(1e-6, 0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def trace(loop):
    return mg.simulate(loop, np.radians(200.0), sample_rate=RATE, duration=STEPS / RATE, seed=4)


def test_it_is_the_difference_to_an_integration(loop, trace):
    told = kick_error(loop, trace.force, trace.rate_true, 1.0 / RATE)
    exact = eqx.tree_at(lambda made: made.discretisation, loop, mg.Integrated())
    given = trace.force, trace.rate_true, 1.0 / RATE, 1
    seen = np.asarray(_replayed(loop.sampled_at(RATE), *given)) - np.asarray(_replayed(exact, *given))
    assert np.max(np.abs(seen)) > 1e-11
    np.testing.assert_allclose(told, seen, atol=0.02 * np.max(np.abs(seen)))
    np.testing.assert_allclose(trace.motion[:, :2], _replayed(loop.sampled_at(RATE), *given), atol=1e-15)


def test_a_loop_without_kicks_has_none(loop, trace):
    plain = eqx.tree_at(lambda made: made.device, loop, loop.device.with_only([]))
    exact = eqx.tree_at(lambda made: made.discretisation, loop, mg.Integrated())
    for other in (plain, exact):
        assert not np.any(kick_error(other, trace.force, trace.rate_true, 1.0 / RATE))


def test_a_record_that_shows_them_is_told_of(trace):
    with pytest.warns(UserWarning, match=r"moves the record by up to .* standard deviations .*mg\.Integrated\(\)"):
        mg.case_of_trace(trace)
