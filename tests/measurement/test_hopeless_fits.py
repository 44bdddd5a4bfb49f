"""A fit that will not get where it would be of use is given up; one that will is not."""

import numpy as np
import pytest

from memsgyro_jax.measurement.least_squares import AT_LEAST, least_squares


COLD = {"damping": 1e-12, "tolerance": 1e-6, "evaluations": 60}


def course(floor: float):
    """Rosenbrock's curved valley, of which the least sum of squares is `floor`²."""

    def linearise(place):
        x, y = place
        residual = np.array([1.0 - (x - 1.2), 10.0 * ((y + 1.0) - (x - 1.2) ** 2), floor])
        slope = np.array([[-1.0, 0.0], [-20.0 * (x - 1.2), 10.0], [0.0, 0.0]])
        return residual, slope

    calls = []

    def counted(place):
        calls.append(place)
        return linearise(place)

    return counted, linearise(np.zeros(2)), calls


@pytest.mark.parametrize("beat", [9.5, 9.01])
def test_a_fit_that_cannot_win_ends_early_and_says_that_it_did_not_settle(beat):
    linearise, first, calls = course(10.0)
    end = least_squares(linearise, first, beat=beat, **COLD)
    assert end.evaluations == AT_LEAST == len(calls) + 1
    assert end.chi2 > beat


@pytest.mark.parametrize("above", [1e-3, 1.0, 100.0])
def test_a_fit_that_can_win_ends_where_it_would_have_ended(above):
    plain = least_squares(*course(3.0)[:2], **COLD)
    told = least_squares(*course(3.0)[:2], beat=9.0 + above, **COLD)
    np.testing.assert_array_equal(told.place, plain.place)
    assert told.evaluations == plain.evaluations
    assert plain.chi2 == pytest.approx(9.0)
