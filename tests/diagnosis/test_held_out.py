"""Leave-out predictions from one linearisation against refits, and what they say of right and wrong effects."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from memsgyro_jax.diagnosis.acceptance import excess, hopeless
from memsgyro_jax.diagnosis.held_out import Support, left_out, record_folds, row_folds, support
from memsgyro_jax.diagnosis.optimum import Optimum


def solved(residual, jacobian):
    """The optimum of a linear problem."""
    step = -np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    places = np.arange(jacobian.shape[1])
    return Optimum(step, places, residual + jacobian @ step, jacobian, np.zeros((0, places.size)), True, 1)


def bench(*rows):
    """Readings of one channel, one experiment per record."""
    return [
        SimpleNamespace(record=np.full(count, number), row=np.arange(count), size=count)
        for number, count in enumerate(rows)
    ]


@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(2, 5))
def test_a_fold_left_out_is_predicted_as_a_refit_without_it_would(seed, size, folds):
    rng = np.random.default_rng(seed)
    residual, jacobian = (
        rng.standard_normal(60) * 3.0,
        rng.standard_normal((60, size)) * 10.0 ** rng.uniform(-6, 6, size),
    )
    fold = rng.integers(0, folds, 60)
    end = solved(residual, jacobian)
    found = left_out(end.residual, end.jacobian, fold)
    for number in np.unique(fold):
        mine = fold == number
        unit = jacobian / np.linalg.norm(jacobian, axis=0)
        own = np.linalg.eigvalsh(np.linalg.qr(unit)[0][mine].T @ np.linalg.qr(unit)[0][mine])
        if own.max(initial=0.0) < 0.9:
            step = -np.linalg.lstsq(unit[~mine], residual[~mine], rcond=None)[0]
            np.testing.assert_allclose(found[mine], (residual + unit @ step)[mine], rtol=1e-6, atol=1e-6)


def test_what_one_fold_holds_alone_is_left_as_fitted():
    """A parameter that moves one record only cannot be predicted from others: its record is left as it was fitted."""
    rng = np.random.default_rng(1)
    fold = np.repeat([0, 1], 20)
    alone = np.where(fold == 0, rng.standard_normal(40), 0.0)[:, None]
    end = solved(rng.standard_normal(40), alone)
    np.testing.assert_allclose(left_out(end.residual, alone, fold), end.residual, atol=1e-12)


def drawn(seed, agree):
    """Four records that show one effect: of one strength, or of strengths that disagree."""
    rng, readings = np.random.default_rng(seed), bench(40, 40, 40, 40)
    shape, base = rng.standard_normal((2, 160))
    size = np.repeat([1.0, 1.0, 1.0, 1.0] if agree else [4.0, -2.0, 2.5, -3.0], 40)
    residual = rng.standard_normal(160) + size * shape
    before = solved(residual, base[:, None])
    return support(before, solved(residual, np.stack([base, shape], axis=1)), readings)


@pytest.mark.parametrize("seed", range(20))
def test_an_effect_of_one_strength_is_supported_by_every_record(seed):
    found = drawn(seed, agree=True)
    assert found.enough
    assert found.records > 0.8 * found.fitted


@pytest.mark.parametrize("seed", range(20))
def test_records_that_want_different_strengths_support_none(seed):
    found = drawn(seed, agree=False)
    assert found.fitted > 0
    assert not found.enough


def test_noise_alone_seldom_supports_an_effect_that_was_not_chosen():
    """Of one candidate, unselected: what was left out gets worse as often as better, and the gain is a χ² or less."""
    rng, readings = np.random.default_rng(0), bench(60, 60, 60)
    kept = 0
    for _ in range(300):
        residual, columns = rng.standard_normal(180), rng.standard_normal((180, 3))
        found = support(solved(residual, columns[:, :2]), solved(residual, columns), readings)
        kept += found.enough and found.fitted > 3.84
    assert kept < 300 * 0.06


def test_a_fall_of_nothing_is_no_support():
    assert not Support(0.0, 0.0, 0.0).enough
    assert not Support(-1.0, 5.0, 5.0).enough


@settings(max_examples=20)
@given(st.lists(st.integers(1, 200), min_size=1, max_size=4))
def test_folds_are_runs_of_neighbours_and_of_about_one_size(rows):
    readings = bench(*rows)
    fold = row_folds(readings)
    assert fold.size == sum(rows) == record_folds(readings).size
    for number, count in enumerate(rows):
        mine = fold[record_folds(readings) == number]
        sizes = np.bincount(mine, minlength=5)
        if count >= 20:
            assert sizes.max() - sizes.min() <= 4 * (1 + count // 200)
            assert np.count_nonzero(np.diff(mine)) == 19


@pytest.mark.parametrize(("others", "gain", "refused"), [(0, 0.0, False), (1, 0.02, False), (1, 0.01, True),
                                                         (2, 0.12, False), (2, 0.10, True)])  # fmt: skip
def test_only_a_linear_estimate_far_below_the_least_share_spares_a_refit(others, gain, refused):
    """The share is 5 % of the misfit beyond noise, a third beside two effects; a refit may find three times as much."""
    before = Optimum(np.zeros(1), np.array([0]), np.full(400, 100.0), np.ones((400, 1)), np.zeros((0, 1)), True, 1)
    assert hopeless(gain * excess(before), before, others) == refused
