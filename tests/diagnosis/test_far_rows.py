"""Wrong rows beside one another, and beside a bent resonance, are named; nothing that a device does is."""

from types import SimpleNamespace

import numpy as np
import pytest
from bench_case import RESONATOR
from lab.die import Hidden
from long_sweep import case_of

import memsgyro_jax as mg
from memsgyro_jax.diagnosis.far_rows import far_rows, near_rows
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.outlying import _to_leave_out, fit_without, search_beside_outlying


BENT = Hidden(cubic_stiffness_x=3.9 * RESONATOR.kxx)
WRONG = (11, 40, 41, 100, 103, 105, 150)


def fitted(case):
    return fit_case(case, [mg.effects.CubicStiffness("x")])


@pytest.mark.parametrize("hidden", [Hidden(), BENT])
def test_rows_that_hide_each_other_are_named(hidden):
    """Two beside each other, or a few rows apart, were none: neither left noise without the other."""
    fit = fitted(case_of(3, hidden, WRONG, sigmas=150.0))
    found = _to_leave_out(fit)
    assert found == {0: WRONG}
    clean, again = fitted(case_of(3, hidden)), fit_without(fit, found)
    assert again.chi2_per_dof < 1.2
    free = again.optimum.free
    moved = np.abs(again.optimum.vector[free] - clean.optimum.vector[free]) / clean.optimum.std
    assert np.all(moved < 1.5)


def test_three_rows_that_follow_each_other_are_a_part_of_the_curve():
    fit = fitted(case_of(3, rows=(40, 41, 42, 120), sigmas=40.0))
    assert far_rows(fit) == {0: (120,)}
    assert _to_leave_out(fit) == {}


def test_what_repeats_at_one_frequency_is_the_device():
    """The two sweeps of the record pass the same 90 frequencies: row 30 of one stands where row 120 does."""
    assert far_rows(fitted(case_of(3, rows=(30,), sigmas=40.0))) == {0: (30,)}
    assert far_rows(fitted(case_of(3, rows=(30, 120), sigmas=40.0))) == {}


def test_a_row_that_the_end_explains_is_taken_in_again():
    """Of rows left out on the way, beside a poor fit, those that the found model comes near."""
    case = case_of(3, rows=(40,), sigmas=150.0)
    left_out = {0: (40, 70)}
    fit = fit_case(case, left_out=left_out)
    near = near_rows(fit, fit_case(case).joint.readings, left_out)
    assert near == {0: (70,)}
    begun: list = []

    def begin(rows):
        begun.append(rows)
        return SimpleNamespace(done=bool(rows), base=fit, steps=[SimpleNamespace(fit=fit)], joint=whole, rows=rows)

    def searched(search):
        yield search, None, "", None

    whole = fit_case(case).joint
    end, rows = search_beside_outlying(begin, searched, lambda one: one.done, lambda: left_out)
    assert rows == {0: (40,)}
    assert end[0].rows == rows


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_bent_resonance_is_found_beside_wrong_rows(seed):
    rng = np.random.default_rng(seed)
    rows = tuple(sorted(rng.choice(180, 5, replace=False).tolist()))
    case = case_of(seed, BENT, rows, sigmas=150.0)
    found = mg.diagnose(None, case)
    assert found.verdict == "found"
    (effect,) = found.accepted
    assert effect.label == "cubic_stiffness x"
    assert abs(effect.estimate[0] - BENT.cubic_stiffness_x) < 3.5 * effect.std[0]
    assert found.outlying == {"sweep": rows}
