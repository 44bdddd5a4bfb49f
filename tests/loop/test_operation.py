"""Where neither sample rate nor duration is given, a run follows its device, whatever function makes it."""

import equinox as eqx
import jax
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.loop.operation import run_of
from memsgyro_jax.loop.settling import not_at_rest, settling_time_constant, swing_up_time


DEVICES = {
    "thesis": mg.SingleMassGyro.chi2010(),
    "two masses": mg.DualMassGyro.from_modes(3e-8, 2e-8, (9e3, 8.6e3), (900.0, 200.0)),
    "17 kHz": mg.SingleMassGyro.from_modes("15 ug", ("17.2 kHz", "17.65 kHz"), (6000, 1500)),
}


@pytest.mark.parametrize("name", DEVICES)
def test_a_run_follows_its_device(name):
    gyro = DEVICES[name]
    made = mg.Operation.of(gyro)
    assert run_of(made.loop(), None, None) == (made.sample_rate, made.duration)
    assert run_of(made.loop(), "30 kHz", None) == (30e3, made.duration)
    assert run_of(made.loop(), None, "2 ms") == (made.sample_rate, 2e-3)
    samples = made.sample_rate / float(np.max(mg.mode_frequencies(gyro)))
    assert 25.0 < samples < 28.0


def test_the_thesis_device_runs_as_it_always_did():
    assert run_of(mg.Operation.of(DEVICES["thesis"]).loop(), None, None) == (100e3, 0.1)


@pytest.mark.slow
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
    loop = mg.Operation.of(DEVICES["thesis"]).loop()

    def period(mass):
        traced = eqx.tree_at(lambda made: made.device.mass, loop, mass)
        return run_of(traced, None, 0.1)[0]

    with pytest.raises(mg.InputError, match="must be given for a device"):
        jax.grad(period)(1e-8)


def test_a_classic_loop_gets_the_time_it_takes_to_rest():
    gyro, readout = DEVICES["17 kHz"], mg.ChargeAmplifier.chi2010()
    usual = mg.Operation.of(gyro, readout).duration

    def loop(**widths):
        control = mg.ClassicControl.force_rebalance(gyro, readout, amplitude="1 um", **widths)
        return mg.ClosedLoop(gyro, readout, mg.NoObserver.for_device(gyro, readout), control, start=(0.0,) * 4)

    quick, slow = loop(), loop(demodulator_bandwidth="800 Hz")
    for each in (quick, slow):
        _, duration = run_of(each, None, None)
        enough = 2.0 * (swing_up_time(each) + 6.0 * settling_time_constant(each))
        assert min(enough, 20.0 * usual) <= duration <= 1.11 * min(enough, 20.0 * usual)
        assert duration > 3.0 * usual
        assert not_at_rest(each, 0.5 * duration, duration) == ()


def test_a_study_of_a_classic_loop_gets_that_time_too(tmp_path):
    (tmp_path / "study.toml").write_text(
        '[device]\nkind = "single_mass"\nmass = "15 ug"\nfrequency = ["17.2 kHz", "17.65 kHz"]\n'
        'quality_factor = [6000, 1500]\n[controller]\nkind = "classic"\nsense = "rebalanced"\n'
    )
    study = mg.load_study(tmp_path / "study.toml")
    assert (
        study.settings.duration == run_of(study.loop, None, None)[1] > 3.0 * mg.Operation.of(study.loop.device).duration
    )
    assert f"runs {study.settings.duration:.3g} s" in " ".join(study.notes)
