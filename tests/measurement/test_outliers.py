"""Rows that a fit leaves alone among others: named when wrong, and at the stated level when right."""

import numpy as np
import pytest
from scipy import stats

from memsgyro_jax.measurement.outliers import LEVEL, lone_residuals


def amplitude(rows):
    return np.repeat(1 / np.hypot(1, (np.arange(rows) - rows / 2) / 2)[:, None], 4, axis=1)


@pytest.mark.parametrize("rows", [40, 200])
@pytest.mark.parametrize("power", [0, 1, -1])
@pytest.mark.parametrize("draws", [100, pytest.param(5000, marks=pytest.mark.slow)])
def test_right_records_are_named_at_the_stated_level(rows, power, draws):
    """Noise the same in all rows, in proportion to the reading, and against it."""
    rng = np.random.default_rng(4)
    size = amplitude(rows)
    named = sum(
        bool(lone_residuals(rng.standard_normal((rows, 4)) * size**power, size ** (-power or 1))) for _ in range(draws)
    )
    assert stats.binomtest(named, draws, LEVEL, alternative="greater").pvalue > 1e-3


@pytest.mark.parametrize("row", [0, 1, 5, 100, 194, 199])
def test_a_wrong_row_is_named_wherever_it_stands(row):
    rng = np.random.default_rng(5)
    residual = rng.standard_normal((200, 4))
    residual[row, 2] += 40.0
    ((found, column, sigmas),) = lone_residuals(residual, amplitude(200) ** 0)
    assert (found, column) == (row, 2)
    assert 8 < sigmas < 60


@pytest.mark.parametrize(
    "shape", [lambda t: 50 * np.sin(t / 8), lambda t: 50 * (t > 100), lambda t: 1e-2 * (t - 90) ** 2]
)
def test_a_misfit_that_is_smooth_or_a_step_names_nobody(shape):
    rng = np.random.default_rng(6)
    residual = rng.standard_normal((200, 4)) + shape(np.arange(200.0))[:, None]
    assert lone_residuals(residual, amplitude(200) ** 0) == []


def test_few_rows_name_nobody():
    assert lone_residuals(np.r_[np.zeros((12, 4)), np.full((1, 4), 1e9)], np.ones((13, 4))) == []
