"""Where neither sample rate nor duration is given, a run follows its device, whatever function makes it."""

import jax
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.loop.operation import run_of


DEVICES = {
    "thesis": mg.SingleMassGyro.chi2010(),
    "two masses": mg.DualMassGyro.from_modes(3e-8, 2e-8, (9e3, 8.6e3), (900.0, 200.0)),
    "17 kHz": mg.SingleMassGyro.from_modes("15 ug", ("17.2 kHz", "17.65 kHz"), (6000, 1500)),
}


@pytest.mark.parametrize("name", DEVICES)
def test_a_run_follows_its_device(name):
    gyro = DEVICES[name]
    made = mg.Operation.of(gyro)
    assert run_of(gyro, None, None) == (made.sample_rate, made.duration)
    assert run_of(gyro, "30 kHz", None) == (30e3, made.duration)
    assert run_of(gyro, None, "2 ms") == (made.sample_rate, 2e-3)
    samples = made.sample_rate / float(np.max(mg.mode_frequencies(gyro)))
    assert 25.0 < samples < 28.0


def test_the_thesis_device_runs_as_it_always_did():
    assert run_of(DEVICES["thesis"], None, None) == (100e3, 0.1)


def test_every_function_that_runs_a_loop_follows_the_device():
    made = mg.Operation.of(DEVICES["17 kHz"])
    loop, run = made.loop(), {"sample_rate": made.sample_rate, "duration": 2e-4}
    trace = mg.simulate(loop, 1.0, duration=2e-4, seed=3)
    np.testing.assert_array_equal(trace.rate_estimate, mg.simulate(loop, 1.0, seed=3, **run).rate_estimate)
    lot = mg.sweep(loop, mg.Spread.relative("5 %"), dies=4, duration=2e-4, bound_dies=0)
    assert lot.data.attrs["sample_rate"] == made.sample_rate
    bounds = [mg.information_bound(loop, **kind) for kind in ({"duration": 2e-4}, run)]
    np.testing.assert_array_equal(bounds[0].std, bounds[1].std)


def test_a_traced_device_is_asked_for_both():
    with pytest.raises(mg.InputError, match="must be given for a device"):
        jax.grad(lambda scale: run_of(mg.SingleMassGyro(1e-8, scale, 40.0, 0.0, 1e-7, 1e-7, 0.0), None, 0.1)[0])(39.0)
