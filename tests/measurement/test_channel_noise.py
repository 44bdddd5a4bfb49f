"""Channels of unequal noise tell each its own, in every kind of record; channels that are alike tell one together."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import memsgyro_jax
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.measurement.case import assess, load_case
from memsgyro_jax.measurement.channel_noise import told_by_channels


@pytest.fixture(scope="module")
def demo():
    """The demonstration, whose records declare no noise."""
    case = load_case(Path(memsgyro_jax.__file__).parent / "demo")
    return replace(case, records=tuple(replace(few_rows(record), noise_std=None) for record in case.records))


def few_rows(record):
    return record.only(np.arange(300)) if record.name == "rate" else record


def louder(record, times):
    """A record with more noise in channel x."""
    rng, size = np.random.default_rng(3), np.sqrt(times**2 - 1.0) * record.noise_level
    more = size * rng.standard_normal(record.rows)
    name = "phasors" if hasattr(record, "phasors") else "signals"
    values = np.array(getattr(record, name))
    values[:, 0] += more + 1j * size * rng.standard_normal(record.rows) if np.iscomplexobj(values) else more
    return replace(record, **{name: values})


KINDS = ["sweep_x", "ringdown_x", "rate", "raw"]


@pytest.mark.parametrize("name", KINDS)
def test_alike_channels_tell_one_noise(demo, name):
    record = demo.record(name)
    level, freedom = record.noise_told_by(record.channels)
    assert record.told_noise == (level, freedom, ())
    assert record.noise_level == level
    assert record.noise_freedom == freedom
    np.testing.assert_array_equal(record.noise_of_rows, level)


@pytest.mark.parametrize("name", KINDS)
def test_unequal_channels_tell_each_its_own(demo, name):
    quiet, record = demo.record(name), louder(demo.record(name), 15.0)
    x, y = record.noise_levels
    assert x == pytest.approx(15.0 * quiet.noise_level, rel=0.2)
    assert y == pytest.approx(quiet.noise_level, rel=0.2)
    assert record.noise_level == pytest.approx(np.hypot(x, y) / np.sqrt(2.0))
    assert record.noise_freedom < quiet.noise_freedom
    np.testing.assert_array_equal(record.noise_of_rows, np.tile([x, y], (record.rows, 1)))
    assert np.ravel(replace(record, noise_std=1.0).noise_of_rows) == pytest.approx(1.0)


def test_check_tells_each_channel(demo):
    case = replace(demo, records=(louder(demo.record("sweep_x"), 15.0),))
    (quality,) = assess(case).records
    assert set(quality.noise_of_channels) == {"x", "y"}
    assert f"x {quality.noise_of_channels['x']:.2g} V, y {quality.noise_of_channels['y']:.2g} V" in str(assess(case))
    one = replace(case, records=(replace(case.records[0], noise_std=quality.noise_of_channels["x"]),))
    (warning,) = assess(one).warnings
    assert "in channel x and" in warning
    assert "`Vx_std` and `Vy_std`" in warning


def test_channels_are_apart_by_more_than_chance():
    def told(x, y, freedom):
        def by(channels):
            return (1.5, 2 * freedom) if len(channels) == 2 else ((x, y)[channels[0]], freedom)

        return told_by_channels(by, [0, 1])

    assert told(1.0, 2.0, 10.0) == (1.5, 20.0, ()), "so few rows tell no difference"
    assert told(1.0, 2.0, 100.0) == (pytest.approx(np.sqrt(2.5)), 100.0, (1.0, 2.0))
    assert told(1.0, 1.05, 1e6).levels == (), "no estimate is as good as that"
    assert told(0.0, 1.0, 100.0).levels == (), "a channel of one value alone tells no noise"


def test_unequal_noise_of_repeated_rows_is_no_jitter(demo):
    """Louder where the response is steep, as the driven channel is."""
    record = demo.record("sweep_x")
    twice, rng = record.only(np.tile(np.arange(record.rows), 2)), np.random.default_rng(5)
    white = rng.standard_normal((2, *twice.phasors.shape))
    twice = replace(twice, phasors=twice.phasors + np.array([1e-3, 1e-4]) * (white[0] + 1j * white[1]))
    assert twice.noise_levels == pytest.approx([1e-3, 1e-4], rel=0.1)
    np.testing.assert_array_equal(twice.noise_of_rows, np.tile(twice.noise_levels, (twice.rows, 1)))


def test_no_noise_at_all_is_refused(demo):
    record = demo.record("sweep_x")
    few = record.only(np.arange(5))
    np.testing.assert_array_equal(few.noise_levels, 0.0)
    with pytest.raises(InputError, match="must declare its `noise_std`"):
        _ = few.noise_of_rows
