"""Tuning an observer on recorded voltages and commands, without a truth."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from tuning_study import small_study

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.loop.record_filter import told_by_record
from memsgyro_jax.tuning.caveats import of_record
from memsgyro_jax.tuning.result import TunedNumber


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return small_study(tmp_path_factory.mktemp("study"))


@pytest.fixture(scope="module")
def record(study):
    run = mg.simulate(study.loop, study.scenario, sample_rate=1e6, duration=0.004, seed=5)
    return study.loop.observer, np.asarray(run.volts), np.asarray(run.force)


FREE = mg.free(observer={"noise_density": (1e-9, 1e-6), "process_noise.rate": (1.0, 1e9)})


@pytest.mark.slow
def test_the_noise_of_a_record_is_found_without_a_truth(record):
    observer, volts, force = record
    found = mg.tune_on_record(observer, volts, force, free=FREE, sample_rate=1e6, settle=2e-4)
    for density in found.observer.noise_density:
        assert float(density) == pytest.approx(20e-9, rel=0.1)
    assert found.likelihood[1] < found.likelihood[0] - 0.5
    assert found.inconsistency[1] < 0.2 < found.inconsistency[0]
    assert "moved x 0.3" in repr(found)


@pytest.fixture(scope="module")
def two_filters():
    """One that takes samples and one that takes blocks, three times too shy, and a record of 60 ms."""
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    known = ("kxy", "dxx", "dyy", "dxy", "sigma")
    plain = mg.ExtendedKalmanFilter.for_device(gyro, readout, known=known, annealing=mg.Annealing())
    loop = mg.ClosedLoop(gyro, readout, plain, mg.DampingCompensation(tones=mg.Tone(600.0, 53.95)))
    run = mg.simulate(loop, 1.0, sample_rate=100e3, duration=0.06, seed=5, decimation=1)
    shy = eqx.tree_at(lambda o: o.noise_density, plain, tuple(3.0 * density for density in plain.noise_density))
    return plain, shy, mg.BlockFilter(shy, (600.0,), 128, 512), np.asarray(run.volts), np.asarray(run.force)


@pytest.mark.slow
def test_a_filter_in_blocks_finds_what_one_of_samples_finds(two_filters):
    truth, *shy, volts, force = two_filters
    given = {"sample_rate": 1e5, "settle": 0.008}
    plain, blocks = (
        mg.tune_on_record(observer, volts, force, free=mg.free(observer=path), **given)
        for observer, path in zip(shy, ("noise_density", "filter.noise_density"), strict=True)
    )
    assert len(blocks.numbers) == 2
    for true, one, other in zip(truth.noise_density, plain.observer.noise_density, blocks.observer.filter.noise_density,
                                strict=True):  # fmt: skip
        assert float(one) == pytest.approx(float(true), rel=0.04)  # of 3840 samples; 1 standard deviation is 0.011
        assert float(other) == pytest.approx(float(true), rel=0.2)  # of 210 statistics; 0.05
    assert blocks.likelihood[1] < blocks.likelihood[0] - 0.5
    assert blocks.inconsistency[1] < 0.5 < blocks.inconsistency[0]


@pytest.mark.slow
def test_the_pieces_of_a_record_are_its_last_samples(record):
    observer, *rows = record
    volts, force = (jnp.asarray(part[:23]) for part in rows)
    told = told_by_record(observer, volts, force, 1e-6, 4, 5)
    each = mg.filter_record(observer, volts, force, sample_rate=1e6, every=1).estimate.innovation
    expected = np.stack([each.nats, *each.squared], axis=1)[3:].reshape(4, 5, 3).mean(axis=1)
    np.testing.assert_allclose(told, expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"volts": np.zeros((5, 3))}, "Argument `volts` must have one row per sample and two columns"),
        ({"force": np.full((4000, 2), np.nan)}, "Argument `force` must hold finite numbers only, but row 0"),
        ({"settle": 1.0}, "must lie within the record of 0.004 s"),
        ({"settle": 0.00399}, "must have 16 readings of the observer behind `settle`"),
        ({"free": mg.free("filter.bandwidth")}, "`filter.bandwidth` is none"),
    ],
)
def test_records_that_cannot_be_used(study, change, message):
    nothing = np.zeros((4000, 2))
    given = {"volts": nothing, "force": nothing, "free": FREE, "sample_rate": 1e6, **change}
    with pytest.raises(InputError, match=message):
        mg.tune_on_record(study.loop.observer, **given)


@pytest.mark.slow
def test_an_observer_that_loses_the_record_is_told(record):
    observer, volts, force = record
    broken = eqx.tree_at(lambda o: o.prior.theta[1], observer, jnp.asarray(np.inf))
    with pytest.raises(InputError, match="must follow the record at the start"):
        mg.tune_on_record(broken, volts, force, free=FREE, sample_rate=1e6)


NUMBER = TunedNumber(
    "observer.noise_density", "observer.noise_density", 1e-8, 1e-3, 1e-12, 1e-3, "", "moved x 1e+05, at its upper bound"
)


@pytest.mark.parametrize(
    ("nis", "readings", "words"),
    [
        ((1.05, 0.96), 2000, None),
        ((1.3, 1.0), 100, None),  # as few of a right filter may be
        ((1.3, 1.0), 2000, "is 1.3, 1 instead of 1 (0.9 to 1.1) (`observer.noise_density` at its upper bound): the ga"),
        ((0.5, 1.0), 2000, "is 0.5, 1 instead of 1 (0.9 to 1.1) (`observer.noise_density` at its upper bound): the fi"),
    ],
)
def test_claims_that_do_not_hold_on_a_record_are_warned_of(nis, readings, words):
    said = of_record(nis, readings, (NUMBER,))
    assert len(said) == (words is not None)
    assert all(words in sentence for sentence in said)


@pytest.mark.slow
def test_gains_that_absorb_a_wrong_model_are_told():
    """A displacement in quadrature with what the filter takes for the frequency; said with the result."""
    gyro = mg.SingleMassGyro.from_modes("15 ug", ("3.2 kHz", "3.26 kHz"), (400, 350))
    wrong = mg.SingleMassGyro(gyro.mass, 1.01 * gyro.kxx, gyro.kyy, gyro.kxy, gyro.dxx, gyro.dyy, gyro.dxy)
    told = mg.DirectReadout(1e5, noise_density=1e-7)
    known = ("kxx", "kyy", "kxy", "dxx", "dyy", "dxy", "sigma")
    observer = mg.ExtendedKalmanFilter.for_device(wrong, told, known=known, with_offsets=False)
    time = np.arange(1600) / 80e3
    volts = 0.1 * np.cos(2 * np.pi * 3200.0 * time)[:, None] * (1.0, 0.1)
    found = mg.tune_on_record(observer, volts, 0.0 * volts, free=mg.free({"observer.noise_density": (1e-9, 2e-7)}),
                              sample_rate=80e3, evaluations=3)  # fmt: skip
    assert found.inconsistency[1] > 1.0
    assert len(found.warnings) == 1
    assert "WARNING: after tuning NIS of what was held out" in repr(found)
