"""Tuning an observer on recorded voltages and commands, without a truth."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from tuning_study import small_study

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError


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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"volts": np.zeros((5, 3))}, "Argument `volts` must have one row per sample and two columns"),
        ({"force": np.full((4000, 2), np.nan)}, "Argument `force` must hold finite numbers only, but row 0"),
        ({"settle": 1.0}, "must lie within the record of 0.004 s"),
        ({"free": mg.free("filter.bandwidth")}, "`filter.bandwidth` is none"),
    ],
)
def test_records_that_cannot_be_used(study, change, message):
    nothing = np.zeros((4000, 2))
    given = {"volts": nothing, "force": nothing, "free": FREE, "sample_rate": 1e6, **change}
    with pytest.raises(InputError, match=message):
        mg.tune_on_record(study.loop.observer, **given)


def test_an_observer_that_loses_the_record_is_told(record):
    observer, volts, force = record
    broken = eqx.tree_at(lambda o: o.prior.theta[1], observer, jnp.asarray(np.inf))
    with pytest.raises(InputError, match="must follow the record at the start"):
        mg.tune_on_record(broken, volts, force, free=FREE, sample_rate=1e6)
