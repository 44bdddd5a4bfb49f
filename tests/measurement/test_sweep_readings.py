"""A thermometer that scatters from row to row, beside a temperature that moves."""

import numpy as np
import pytest

from memsgyro_jax.measurement.experiments.sweep_readings import scattered, steadied


ROWS = 60
SWEEPS = (slice(0, ROWS), slice(ROWS, 2 * ROWS))


def read(course, noise, seed):
    return np.tile(course, 2) + noise * np.random.default_rng(seed).standard_normal(2 * ROWS)


@pytest.mark.parametrize("course", [np.zeros(ROWS), np.linspace(-1, 1, ROWS), np.linspace(-1, 1, ROWS) ** 2])
def test_what_scatters_is_taken_off_and_what_moves_stays(course):
    true, sizes = np.tile(course, 2), []
    for seed in range(20):
        found, size = steadied(300.0 + read(course, 0.3, seed), SWEEPS)
        assert np.sqrt(np.mean((found - 300.0 - true) ** 2)) < 0.3 * np.sqrt(8.0 / ROWS)
        sizes.append(size)
    assert np.mean(sizes) == pytest.approx(0.3, rel=0.05)


@pytest.mark.parametrize(
    "values",
    [
        np.full(2 * ROWS, 300.0),
        np.tile(300.0 + np.cumsum(np.random.default_rng(2).standard_normal(ROWS)), 2),  # it walks
        np.tile(300.0 + np.sin(np.linspace(0.0, 9.0, ROWS)), 2),
    ],
)
def test_what_runs_smoothly_stays_as_it_is(values):
    found, size = steadied(values, SWEEPS)
    np.testing.assert_array_equal(found, values)
    assert size == 0.0


def test_it_is_said():
    (said,) = scattered("oven.csv", 0.3)
    assert said.startswith("oven.csv: column `T` scatters by 0.3 K from row to row")
    assert scattered("oven.csv", 0.0) == []
