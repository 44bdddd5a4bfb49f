"""A summary made part by part is that of the whole: exact sums, quantiles within their stated error."""

from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from memsgyro_jax.montecarlo import sketch
from memsgyro_jax.montecarlo.batch import Plan
from memsgyro_jax.montecarlo.merit import percentiles
from memsgyro_jax.montecarlo.sketch import Sketch
from memsgyro_jax.montecarlo.status import DIVERGED, LOST, OK, PENDING, STATUS
from memsgyro_jax.montecarlo.tally import Tally


ERROR = 1.0 / 8192.0


def sketch_of(*parts) -> Sketch:
    made = Sketch()
    for part in parts:
        made.add(np.asarray(part, float))
    return made


@pytest.mark.parametrize("law", ["normal", "lognormal", "few", "cauchy"])
def test_percentiles_of_many_are_within_their_error(law):
    rng = np.random.default_rng(0)
    count = 3 * sketch.EXACT + 17
    numbers = {
        "normal": rng.standard_normal(count), "lognormal": np.exp(8.0 * rng.standard_normal(count)),
        "few": rng.integers(0, 3, count).astype(float), "cauchy": rng.standard_cauchy(count),
    }[law]  # fmt: skip
    found, exact = sketch_of(*np.array_split(numbers, 40)).percentiles, percentiles(numbers)
    assert found.rms == pytest.approx(exact.rms, rel=1e-12)
    ordered = np.sort(np.abs(numbers))
    for share, value in ((0.5, found.p50), (0.95, found.p95)):
        assert value == pytest.approx(ordered[int(np.ceil(share * count)) - 1], rel=ERROR, abs=1e-300)
    assert (found.p95_low, found.p95_high) == pytest.approx((exact.p95_low, exact.p95_high), rel=1e-3)
    assert found.p95_low <= found.p95 <= found.p95_high


def test_few_numbers_are_exact_and_many_add_up_in_any_order():
    rng = np.random.default_rng(1)
    few = rng.standard_normal(1000)
    assert astuple(sketch_of(few[:300], few[300:]).percentiles) == pytest.approx(astuple(percentiles(few)), rel=1e-12)
    parts = np.array_split(rng.standard_normal(2 * sketch.EXACT), 7)
    there, back = sketch_of(*parts), sketch_of(*parts[::-1])
    assert there.quantile(0.1, 0.5, 0.999) == back.quantile(0.1, 0.5, 0.999)


@given(
    st.lists(st.floats(-1e300, 1e300) | st.sampled_from([np.inf, -np.inf, np.nan, 0.0]), max_size=30),
    st.floats(0.0, 1.0),
)
@settings(max_examples=60, deadline=None)
def test_any_numbers_give_a_quantile(numbers, share):
    size = np.sort(np.abs([n for n in numbers if not np.isnan(n)]))
    (exact,) = sketch_of(numbers).quantile(share)
    if not size.size:
        assert np.isnan(exact)
        return
    assert size[0] <= exact <= size[-1]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sketch, "EXACT", 0)
        (binned,) = sketch_of(numbers).quantile(share)
    wanted = size[max(int(np.ceil(share * size.size)), 1) - 1]
    assert binned == pytest.approx(wanted, rel=ERROR, abs=1e-300)


def rows_of(dies: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(2)
    rows = {name: rng.standard_normal(dies) for name in ("rate_error_end", "rate_error_rms", "rate_series_std")}
    rows |= {name: rng.uniform(size=dies) for name in ("nees_end", "nis_mean", "redrawn", "rate_std_end")}
    rows["convergence_time"] = np.where(rng.uniform(size=dies) < 0.2, np.nan, 0.07 * rng.uniform(size=dies))
    rows["rate_true"] = np.sin(np.arange(8.0)) + rng.standard_normal((dies, 1))
    rows["rate_estimate"] = rows["rate_true"] * 1.01 + 0.1 * rng.standard_normal((dies, 8))
    rows["coefficient_true"] = rng.standard_normal((dies, 3))
    rows[STATUS] = rng.choice([PENDING, OK, OK, OK, LOST, DIVERGED], dies).astype(np.int8)
    for name in set(rows) - {STATUS, "redrawn", "coefficient_true"}:
        rows[name][rows[STATUS] == LOST] = np.nan
    rows["lost_at"] = np.where(rows[STATUS] == LOST, rng.uniform(size=dies), np.nan)
    return rows


def test_within_the_tolerance_at_the_end_alone_is_not_converged():
    """An error that swings through the tolerance "converged" at the end of the run."""
    tally, rows = Tally(Plan(1e-3, 8, 10, 0.02, 1.0), 64), rows_of(100)
    rows[STATUS][:] = OK
    for time, told in ((0.0765, np.inf), (0.03, 0.03)):
        tally.converged = type(tally.converged)()
        tally.add({**rows, "convergence_time": np.full(100, time)}, 0)
        assert tally.converged.quantile(0.5) == [told]


def test_parts_add_up_to_the_whole():
    dies, plan = 500, Plan(1e-3, 8, 10, 0.02, 1.0)
    rows, (whole, parts) = rows_of(dies), (Tally(plan, 64) for _ in range(2))
    whole.add(rows, 0)
    for first in range(0, dies, 48):
        parts.add({name: column[first : first + 48] for name, column in rows.items()}, first)
    status = rows[STATUS]
    alive = (status == OK) | (status == DIVERGED)
    assert parts.computed == np.sum(status != PENDING)
    assert parts.lost == np.sum(status == LOST)
    assert parts.good == np.sum(np.abs(rows["rate_error_end"][alive]) <= 1.0)
    assert parts.mean("nis_mean") == pytest.approx(np.mean(rows["nis_mean"][alive]), rel=1e-12)
    squares = (rows["rate_error_end"][alive] / rows["rate_std_end"][alive]) ** 2
    assert parts.mean("claim") == pytest.approx(np.mean(squares), rel=1e-12)
    late = np.where(np.isnan(rows["convergence_time"][alive]), np.inf, rows["convergence_time"][alive])
    assert parts.converged.quantile(0.5) == [pytest.approx(np.median(late))]
    for name in ("end", "sound", "run", "nees"):
        assert getattr(parts, name).percentiles == getattr(whole, name).percentiles
    np.testing.assert_array_equal(parts.first, whole.first)
    gone = rows["lost_at"][status == LOST]
    assert parts.lost_at == whole.lost_at == pytest.approx((gone.min(), np.median(gone), gone.max()))
    assert Tally(plan, 64).lost_at is None
    np.testing.assert_array_equal(parts.diverged[0], np.flatnonzero(status == DIVERGED))
    np.testing.assert_array_equal(parts.diverged[1], rows["coefficient_true"][status == DIVERGED])
    for one, other in zip(parts.over_time, whole.over_time, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(parts.straight.mean, whole.straight.mean, rtol=1e-12)
    np.testing.assert_allclose(parts.straight.products, whole.straight.products, rtol=1e-9)
