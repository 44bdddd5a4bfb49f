"""The filter of recorded voltages in blocks beside the one that takes every sample."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.inertial import Inertial
from memsgyro_jax.loop.record_filter import readings_after_settling, told_by_record


GYRO, READOUT = mg.SingleMassGyro.chi2010(), mg.DirectReadout((1e5, 1e5), noise_density=1e-6)
PERIOD, START, LENGTH, TURNING = 1e-5, 256, 256, 1.0
SAMPLES, MOTION = START + 3 * LENGTH, (1e-6, 0.5e-6, 0.0, 0.0)
PLAIN = mg.ExtendedKalmanFilter.for_device(
    GYRO, READOUT, known=("kyy", "kxy", "dxx", "dxy"), with_offsets=False,
    prior=eqx.tree_at(lambda p: p.motion, mg.design_prior(GYRO), tuple(map(jnp.asarray, MOTION))),
)  # fmt: skip
BLOCKS = mg.BlockFilter(PLAIN, (600.0,), LENGTH, START)


@pytest.fixture(scope="module")
def record():
    """Volts and forces of the design at 1 rad/s, shaken by a tone and by forces that no frequency of a block holds."""
    rng = np.random.default_rng(4)
    force = 1e-5 * np.sin(2 * np.pi * 600.0 * PERIOD * np.arange(SAMPLES))[:, None] + rng.normal(0, 3e-6, (SAMPLES, 2))
    given = GYRO.dynamics(Inertial(TURNING))
    rows = np.hstack([-np.array(given.stiffness), -np.array(given.velocity), np.diag(given.gain)])
    unit = np.hstack([np.zeros((2, 2)), np.eye(2), np.zeros((2, 2))])
    sample = expm(np.vstack([unit, rows, np.zeros((2, 6))]) * PERIOD)
    motion, path = np.array(MOTION), []
    for held in force:
        motion = sample[:4] @ np.concatenate([motion, held])
        path.append(motion[:2])
    std = 1e-6 * np.sqrt(0.5 / PERIOD)
    return 1e5 * np.array(path) + rng.normal(0.0, std, (SAMPLES, 2)), force


@pytest.fixture(scope="module")
def found(record):
    return mg.filter_record(BLOCKS, *record, sample_rate="100 kHz")


def test_blocks_tell_what_their_samples_tell(record, found):
    plain = mg.filter_record(PLAIN, *record, sample_rate="100 kHz", every=LENGTH)
    np.testing.assert_allclose(found.time, plain.time, rtol=1e-12)
    assert found.time[-1] == pytest.approx(SAMPLES * PERIOD)
    std, claimed = (np.sqrt(np.asarray(f.estimate.rate_variance)) for f in (plain, found))
    np.testing.assert_allclose(claimed, std, rtol=0.02)
    assert np.all(np.abs(found.estimate.rate - plain.estimate.rate) < 0.2 * std), "the same noise, nearly the same rate"
    assert abs(float(found.estimate.rate[-1]) - TURNING) < 4.0 * std[-1] < 2.0
    away = jnp.stack(found.estimate.motion)[:, -1] - jnp.stack(plain.estimate.motion)[:, -1]
    assert np.all(np.abs(away) < 1e-4 * np.array([1e-6, 1e-6, 2e-2, 2e-2]))
    assert np.all(np.asarray(found.estimate.nis)[1:] < 6.0)


def test_pieces_of_a_record_hold_its_last_readings(record, found):
    """Blocks here; with the first block settled, two pieces of one block are left."""
    assert readings_after_settling(BLOCKS, SAMPLES) == (3, 7)
    assert [readings_after_settling(BLOCKS, SAMPLES, START + settled)[0] for settled in (0, 1, LENGTH, 9 * LENGTH)] == [
        3,
        2,
        2,
        0,
    ]
    volts, force = map(jnp.asarray, record)
    told = told_by_record(BLOCKS, volts, force, PERIOD, 2, 1)
    innovation = found.estimate.innovation
    np.testing.assert_allclose(told, np.stack([innovation.nats, *innovation.squared], 1)[2:], rtol=1e-9)


@pytest.mark.slow
def test_a_running_filter_is_that_of_the_record(record, found):
    def sample(state, row):
        number, measured, held = row
        return BLOCKS.update(state, tuple(measured), tuple(held), mg.Clock(number * PERIOD, number, PERIOD)), None

    begun = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), BLOCKS.init())
    rows = (jnp.arange(1, SAMPLES + 1), *map(jnp.asarray, record))
    state = jax.jit(lambda: jax.lax.scan(sample, begun, rows)[0])()
    last = jax.tree.map(lambda leaf: leaf[-1], found.estimate)
    for one, other in zip(jax.tree.leaves(BLOCKS.estimate(state)), jax.tree.leaves(last), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"length": 300}, "power of two"),
        ({"start": 0}, "at least 1"),
        ({"tones": (-600.0,)}, "tones"),
        ({"iterations": 2}, "iterates"),
        ({"fading": mg.FixedFading(100.0)}, "fading"),
    ],
)
def test_what_a_block_cannot_hold_is_refused(settings, says):
    with pytest.raises(InputError, match=says):
        mg.BlockFilter.for_device(GYRO, READOUT, **settings)


def test_a_record_that_is_none_is_refused(record):
    volts, force = record
    with pytest.raises(InputError, match="256 samples"):
        mg.filter_record(BLOCKS, volts[:100], force[:100], sample_rate=1e5)
    with pytest.raises(InputError, match="shape"):
        mg.filter_record(BLOCKS, volts, force[:-1], sample_rate=1e5)
    with pytest.raises(InputError, match="row 3"):
        mg.filter_record(BLOCKS, np.where(np.arange(SAMPLES)[:, None] == 3, np.nan, volts), force, sample_rate=1e5)


def test_two_masses_start_later():
    assert mg.BlockFilter.for_device(mg.DualMassGyro.chi2010()).start > mg.BlockFilter.for_device(GYRO).start
