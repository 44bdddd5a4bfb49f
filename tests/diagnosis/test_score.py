"""Score tests: exact where the problem is linear, and with the stated rate of false alarms."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, stats

from memsgyro_jax.diagnosis import search
from memsgyro_jax.diagnosis.score import (
    Score,
    basis,
    family_p_values,
    gain,
    overlap,
    score,
    separation,
    survival,
    within_bounds,
)


@st.composite
def linear_problems(draw):
    """A residual and the sensitivities of what is free (with columns of very different size) and of a candidate."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rows, free, new = draw(st.integers(12, 40)), draw(st.integers(0, 5)), draw(st.integers(1, 4))
    jacobian = rng.standard_normal((rows, free)) * 10.0 ** rng.uniform(-8, 8, free)
    candidate = rng.standard_normal((rows, new)) * 10.0 ** rng.uniform(-8, 8)
    return rng.standard_normal(rows) * 3.0, jacobian, candidate


def misfit(residual, columns):
    """Sum of squares that a regression on these columns leaves."""
    unit = columns / np.linalg.norm(columns, axis=0)
    rest = residual - unit @ np.linalg.lstsq(unit, residual, rcond=None)[0]
    return rest @ rest


@given(linear_problems())
def test_the_score_is_the_fall_of_chi_square_in_a_regression(problem):
    """In a linear problem the score, the likelihood ratio and the Wald test are one: what the refit will gain."""
    residual, free, candidate = problem
    found = score(residual, basis(free), candidate)
    gain = misfit(residual, free) - misfit(residual, np.hstack([free, candidate]))
    assert found.size == candidate.shape[1]
    assert found.statistic == pytest.approx(gain, rel=1e-8, abs=1e-8)
    assert found.p_value == pytest.approx(stats.chi2.sf(gain, found.size), rel=1e-6, abs=1e-12)


@given(linear_problems())
def test_the_score_is_wald_s_statistic_of_the_refit(problem):
    residual, free, candidate = problem
    both = np.hstack([free, candidate[:, :1]])
    size = np.linalg.norm(both, axis=0)
    covariance = np.linalg.inv((both / size).T @ (both / size)) / np.outer(size, size)
    estimate = covariance @ (both.T @ residual)
    found = score(residual, basis(free), candidate[:, :1])
    assert found.statistic == pytest.approx(estimate[-1] ** 2 / covariance[-1, -1], rel=1e-7, abs=1e-10)
    assert found.visible(1.0) == pytest.approx(np.sqrt(covariance[-1, -1]), rel=1e-7)


@given(linear_problems(), st.floats(1e-6, 1e6))
def test_units_change_no_score(problem, factor):
    residual, free, candidate = problem
    one, other = (score(residual, basis(f), c) for f, c in ((free, candidate), (free / factor, factor * candidate)))
    assert one.statistic == pytest.approx(other.statistic, rel=1e-9)
    assert one.kept == pytest.approx(other.kept, rel=1e-9)
    assert one.information * factor == pytest.approx(other.information, rel=1e-9)
    assert overlap(one, other) == pytest.approx(1.0)


@given(linear_problems(), st.floats(-2.0, 0.0), st.floats(0.0, 2.0))
def test_bounds_leave_of_a_score_what_the_strength_can_still_gain(problem, below, above):
    """Exactly the fall of χ² in a regression whose strength ends at the bound; none where the sign is impossible."""
    residual, free, candidate = problem
    candidate = candidate[:, :1]
    q, whole = basis(free), score(residual, basis(free), candidate)
    best = -float(candidate[:, 0] @ (residual - q @ (q.T @ residual))) / whole.information**2
    low, high = np.array([below * abs(best)]), np.array([above * abs(best)])
    found = within_bounds(whole, residual, candidate, low, high)
    end = np.clip(best, low[0], high[0])
    gain = misfit(residual, free) - misfit(residual + end * candidate[:, 0], free) if free.size else (
        residual @ residual - (residual + end * candidate[:, 0]) @ (residual + end * candidate[:, 0])
    )  # fmt: skip
    assert found.statistic == pytest.approx(gain, rel=1e-6, abs=1e-6 * max(1.0, whole.statistic))
    assert found.p_value <= stats.chi2.sf(found.statistic, 1) * (1 + 1e-9) or found.statistic == 0.0


BOUNDS = ((-np.inf, np.inf), (0.0, np.inf), (-np.inf, 0.0), (-0.7, 1.5), (0.0, 1.2))


@pytest.mark.parametrize(("bounds", "freedom"), [*((b, np.inf) for b in BOUNDS), *((b, 12.0) for b in BOUNDS[:3])])
def test_within_any_bounds_noise_passes_as_often_as_stated(bounds, freedom):
    """A known sign halves what noise can do, an estimated noise widens it: 20 000 draws, 4.5 standard deviations."""
    rng, draws = np.random.default_rng(6), 20_000
    column = rng.standard_normal((8, 1))
    one = score(np.zeros(8), np.zeros((8, 0)), column)
    one = within_bounds(one, np.zeros(8), column, *(np.array([bound / one.information]) for bound in bounds))
    believed = 1.0 if np.isinf(freedom) else np.sqrt(rng.chisquare(freedom, draws) / freedom)
    statistic = gain(rng.standard_normal(draws) / believed, one.low, one.high)
    for level in (0.2, 0.05, 0.01):
        limit = optimize.brentq(lambda t, level=level: survival(replace(one, statistic=t), freedom) - level, 1e-9, 200)
        spread = 4.5 * np.sqrt(level * (1 - level) / draws)
        assert np.mean(statistic >= limit) == pytest.approx(level, abs=spread)


def test_what_is_free_already_is_no_news():
    rng = np.random.default_rng(0)
    free = rng.standard_normal((30, 3))
    found = score(rng.standard_normal(30), basis(free), free @ [[1.0], [-2.0], [3.0]])
    assert found.size == 0
    assert found.p_value == 1.0
    assert found.kept < 1e-20
    assert found.visible(4.3) == np.inf


def test_what_shows_nowhere_has_no_score():
    found = score(np.ones(10), basis(np.ones((10, 1))), np.zeros((10, 1)))
    assert (found.size, found.statistic, found.p_value, found.kept) == (0, 0.0, 1.0, 0.0)


def test_a_basis_drops_directions_that_the_data_do_not_hold():
    rng = np.random.default_rng(1)
    held = rng.standard_normal((30, 3))
    jacobian = np.hstack([held, held[:, :1] - held[:, 1:2], np.zeros((30, 1))])
    q = basis(jacobian)
    assert q.shape == (30, 3)
    np.testing.assert_allclose(q.T @ q, np.eye(3), atol=1e-13)
    np.testing.assert_allclose(q @ (q.T @ held), held, atol=1e-12)


def test_the_share_is_what_the_candidate_takes_of_the_excess():
    rng = np.random.default_rng(2)
    column = rng.standard_normal((200, 1))
    residual = rng.standard_normal(200) + 5.0 * column[:, 0]
    found = score(residual, np.zeros((200, 0)), column)
    assert found.share == pytest.approx(found.statistic / (residual @ residual - 200))
    assert score(rng.standard_normal(200) * 0.1, np.zeros((200, 0)), column).share == 0.0


# ---- families of candidates


def family(rng, rows=60, free=4):
    """Candidates as a catalogue has them: single ones, twins, a triple, one of four numbers, one that shows nowhere."""
    q = basis(rng.standard_normal((rows, free)))
    single = [rng.standard_normal((rows, 1)) for _ in range(4)]
    twins = [single[0] + 1e-6 * rng.standard_normal((rows, 1)), -3.0 * single[1]]
    near = single[2] + 0.3 * rng.standard_normal((rows, 1))
    return q, [*single, *twins, near, rng.standard_normal((rows, 4)), np.zeros((rows, 1))]


def test_a_family_of_known_signs_alarms_as_often_as_stated():
    """Eight candidates of which six may only grow: at the p-value alone that makes 5 % of the family, 5 % of draws."""
    rng, draws = np.random.default_rng(9), 20_000
    columns = rng.standard_normal((40, 8)) + 0.8 * rng.standard_normal((40, 1))
    low = np.where(np.arange(8) < 6, 0.0, -np.inf)
    empty, none = np.zeros((40, 0)), np.zeros(40)
    scores = [
        within_bounds(score(none, empty, c), none, c, low[k : k + 1], np.array([np.inf]))
        for k, c in enumerate(np.split(columns, 8, axis=1))
    ]
    tried = np.geomspace(0.05 / 10, 0.05 / 3, 8)
    family = family_p_values([replace(s, p_value=p) for s, p in zip(scores, tried, strict=True)], seed=1)
    alone = float(np.interp(0.05, family, tried))
    noise = rng.standard_normal((draws, 40)) @ np.concatenate([s.directions for s in scores], axis=1)
    limits = [stats.norm.isf(alone if s.low == 0.0 else alone / 2) for s in scores]
    passed = np.where(low == 0.0, noise, np.abs(noise)) >= limits
    assert np.mean(passed.any(axis=1)) == pytest.approx(0.05, abs=0.007)


@pytest.mark.slow
def test_false_alarms_of_a_family_come_as_often_as_stated():
    """The best of nine candidates, some of them twins, on white noise: 5 % alarm at the 5 % level."""
    rng, draws = np.random.default_rng(3), 600
    q, candidates = family(rng)
    p = [
        family_p_values([score(r - q @ (q.T @ r), q, c) for c in candidates], draws=2000).min()
        for r in rng.standard_normal((draws, 60))
    ]
    alarms = np.mean(np.array(p) <= 0.05)
    assert 0.03 <= alarms <= 0.07, alarms
    # The 1 % point of Kolmogorov's distribution, and the rounding of 2000 simulated families.
    assert stats.kstest(p, "uniform").statistic < 1.63 / np.sqrt(draws) + 0.02


def test_twins_do_not_count_twice():
    rng = np.random.default_rng(4)
    column, r = rng.standard_normal((50, 1)), rng.standard_normal(50)
    q = np.zeros((50, 0))
    once = family_p_values([score(r, q, column)])
    five = family_p_values([score(r, q, k * column) for k in range(1, 6)])
    np.testing.assert_allclose(five, once[0], atol=0.01)
    assert once[0] == pytest.approx(score(r, q, column).p_value, abs=0.01)


def test_beyond_the_simulation_bonferroni_stands():
    rng = np.random.default_rng(5)
    columns = [rng.standard_normal((50, 1)) for _ in range(7)]
    r = 10.0 * columns[0][:, 0]
    scores = [score(r, np.zeros((50, 0)), c) for c in columns]
    assert family_p_values(scores)[0] == pytest.approx(7 * scores[0].p_value, rel=1e-12)
    assert scores[0].p_value < 1e-50


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_a_family_never_makes_a_candidate_more_significant(seed):
    rng = np.random.default_rng(seed)
    q, candidates = family(rng, rows=30, free=2)
    scores = [score(2.0 * rng.standard_normal(30), q, c) for c in candidates]
    alone, together = np.array([s.p_value for s in scores]), family_p_values(scores, draws=2000)
    assert np.all(together >= alone - 4 * np.sqrt(np.maximum(alone, 1e-3) / 2000))
    assert np.all(together <= 1.0)
    order = np.argsort(alone)
    assert np.all(np.diff(together[order]) >= 0)
    assert together[-1] == 1.0, "what shows nowhere cannot alarm"


def test_a_family_that_shows_nowhere_alarms_never():
    blind = score(np.ones(5), np.zeros((5, 0)), np.zeros((5, 1)))
    np.testing.assert_array_equal(family_p_values([blind, blind]), 1.0)


# ---- telling apart


def seen(columns, residual=None):
    residual = np.zeros(len(columns)) if residual is None else residual
    return score(residual, np.zeros((len(columns), 0)), columns)


@given(st.floats(0.0, np.pi / 2), st.floats(-1e3, 1e3).filter(lambda v: abs(v) > 1e-3))
def test_the_overlap_of_two_directions_is_the_square_of_their_cosine(angle, size):
    one, other = np.array([[1.0], [0.0], [0.0]]), size * np.array([[np.cos(angle)], [np.sin(angle)], [0.0]])
    assert overlap(seen(one), seen(other)) == pytest.approx(np.cos(angle) ** 2, abs=1e-12)


def test_a_larger_effect_can_take_the_place_of_a_smaller_but_not_the_reverse():
    line, plane = np.eye(4)[:, :1], np.eye(4)[:, :2]
    assert overlap(seen(line), seen(plane)) == pytest.approx(1.0)
    assert overlap(seen(plane), seen(line)) == 0.0
    assert overlap(seen(line), seen(np.zeros((4, 1)))) == 0.0
    assert overlap(seen(plane), seen(np.eye(4)[:, 1:3])) == pytest.approx(0.0), "half a plane is not a plane"


@given(st.integers(0, 2**32 - 1))
def test_separation_is_what_the_wrong_twin_leaves_of_chi_square(seed):
    rng = np.random.default_rng(seed)
    free, mine, theirs = rng.standard_normal((25, 3)), rng.standard_normal((25, 1)), rng.standard_normal((25, 1))
    theirs = theirs + 3.0 * mine
    shown, q = 4.0 * mine[:, 0], basis(free)
    first: Score = score(shown, q, mine)
    gap = misfit(shown, np.hstack([free, theirs])) - misfit(shown, np.hstack([free, mine]))
    assert separation(first.statistic, first, score(shown, q, theirs)) == pytest.approx(gap, rel=1e-8, abs=1e-9)


@pytest.mark.parametrize(("worse", "kept"), [(30.0, [0]), (0.5, []), (-0.5, [])])
def test_an_effect_that_a_refit_does_not_miss_is_dropped(monkeypatch, worse, kept):
    """Wald's test proposes; the likelihood of the refit without it decides, also where that refit ended lower."""
    monkeypatch.setattr(search, "beside_case", lambda *_: None)
    begun = SimpleNamespace(
        level=0.05, accepted=[0], optimum=SimpleNamespace(chi2=100.0), steps=[], tell=lambda _: None, case=None,
        joint=SimpleNamespace(model=SimpleNamespace(effects=(SimpleNamespace(label="one"),))),
        own_score=lambda _: SimpleNamespace(p_value=0.5, size=1), without=lambda _: None,
        refit=lambda left, start, beat: SimpleNamespace(chi2=100.0 + worse),
    )  # fmt: skip
    told = []
    begun.keep, begun.drop = told.append, lambda label: search.Search.drop(begun, label)
    search.Search.prune(begun)
    assert begun.accepted == kept
    assert told == [begun] * (not kept)
