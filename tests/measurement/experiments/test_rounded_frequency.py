"""Frequencies that a file holds with too few digits."""

import numpy as np
import pytest

from memsgyro_jax.measurement.experiments.rounded_frequency import last_digit, rounded_frequencies


EVEN = np.linspace(13996.0, 14004.0, 12)
DENSE = np.concatenate([np.arange(13990.0, 13999.0, 0.5), np.arange(13999.0, 14001.0, 0.05)])
WHOLE = (slice(None),)


@pytest.mark.parametrize(
    ("hertz", "step"),
    [
        (np.round(EVEN, 2), 0.01),
        (np.round(EVEN, 1), 0.1),
        (EVEN, 0.0),
        (np.arange(13996.0, 14004.0, 0.5), 0.0),  # set so, and exact
        (np.round(DENSE, 2), 0.0),
        (np.round(np.geomspace(13000.0, 15000.0, 60), 6), 0.0),
    ],
)
def test_the_last_digit_is_told_where_an_even_grid_is_rounded_to_it(hertz, step):
    assert last_digit(hertz, WHOLE) == pytest.approx(step)
    assert last_digit(2 * np.pi * hertz / (2 * np.pi), WHOLE) == pytest.approx(step)


@pytest.mark.parametrize(("digits", "noise", "told"), [(2, 3e-4, True), (2, 0.1, False), (5, 3e-4, False)])
def test_rounding_is_told_where_it_matters_beside_the_noise(digits, noise, told):
    hertz = np.round(EVEN, digits)
    seen = 0.18 / (1 - (EVEN / 13999.7) ** 2 + 1e-4j) * 1e-4
    found = rounded_frequencies("a.csv", hertz, seen[:, None], WHOLE, noise, "V")
    assert bool(found) == told
    assert not told or "rounded to 10 mHz" in found[0]
