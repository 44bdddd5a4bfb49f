"""The tests of a misfit keep their level on noise and see what they are for."""

import numpy as np
import pytest
from scipy import stats

from memsgyro_jax.diagnosis import misfit
from memsgyro_jax.diagnosis.misfit import check_all, holm
from memsgyro_jax.measurement.experiments.deviation import Band, Series, Subset, Variable


def series(white, *, record="a", turned=None, pieces=None):
    """A record of two channels and 300 rows in three sweeps with everything that can be tested."""
    n = len(white)
    rows = np.arange(n)
    parts = tuple(Subset("drive", f"{k} nN", rows // (n // 3) == k) for k in range(3))
    variables = (
        Variable("displacement", np.abs(np.sin(0.1 * rows)) + 1e-3 * rows),
        Variable("time", rows * 1.0),
        Variable("drive", rows // (n // 3) * 1.0),
        Variable("temperature", np.full(n, 298.15)),
    )
    third = n // 3
    pieces = pieces or (slice(0, third), slice(third, 2 * third), slice(2 * third, n))
    bands = (Band("at resonance", 0.14, 0.16), Band("above", 0.2, 0.5))
    return Series(record, ("x", "y"), white, white if turned is None else turned, pieces, parts, bands, variables)


def noise(seed, n=300, parts=2):
    return np.random.default_rng(seed).standard_normal((n, 2, parts))


@pytest.mark.slow
def test_a_comparison_of_noise_keeps_its_level():
    """1000 comparisons of two records, 40 tests each: false alarms as often as stated, within 3 σ of a binomial."""
    level, draws = 0.05, 1000
    alarms = sum(
        any(c.failed for c in check_all([series(noise([k, 0])), series(noise([k, 1], parts=1), record="b")], level))
        for k in range(draws)
    )
    assert alarms <= level * draws + 3 * np.sqrt(level * (1 - level) * draws)
    assert alarms >= 0.2 * level * draws, "so careful that it would miss what it is for"


@pytest.mark.parametrize("kind", ["variance", "whiteness", "dependence"])
def test_p_values_of_each_kind_are_uniform(kind):
    found = [c.p_value for k in range(150) for c in check_all([series(noise([7, k]))]) if c.kind == kind]
    # Tests of one draw share rows, hence the wide margin: a wrong number of degrees of freedom is far outside.
    assert stats.kstest(found, "uniform").statistic < 0.06


def test_missing_rows_change_no_level():
    white = noise(3)
    white[::3] = np.nan
    white[:, 1, 0] = np.where(np.arange(300) < 150, np.nan, white[:, 1, 0])
    checks = check_all([series(white)])
    assert not any(c.failed for c in checks)
    whole = [c for c in checks if c.name == "variance"]
    assert whole[0].count == 400


def failed(white, **more):
    return {(c.channel, c.name) for c in check_all([series(white, **more)]) if c.failed}


def test_excess_in_one_drive_level_is_named():
    white = noise(1)
    white[200:, 0] *= 2.0
    found = failed(white)
    assert ("x", "variance drive 2 nN") in found
    assert ("x", "variance") in found
    assert ("x", "variance drive 0 nN") not in found
    assert not {f for f in found if f[0] == "y"}


def test_a_smooth_pattern_is_not_white_but_its_scale_does_not_matter():
    pattern = 0.8 * np.sin(np.arange(300) / 5.0)[:, None, None]
    for scale in (1.0, 1e-3):
        assert ("y", "whiteness") in failed(scale * (noise(2) + pattern))
    quiet = failed(1e-3 * noise(2))
    assert not quiet, "noise that was declared too large is no failure of the model"


def test_neighbours_of_different_sweeps_do_not_count():
    white = noise(4, parts=1)
    white[150:] = white[:150]  # correlated between pieces of 150 rows, white within
    assert not any("whiteness" in name for _, name in failed(white, pieces=(slice(0, 150), slice(150, 300))))


def test_a_dependence_on_displacement_is_seen_in_the_turned_residual():
    turned = noise(5)
    amplitude = np.abs(np.sin(0.1 * np.arange(300))) + 1e-3 * np.arange(300)
    turned[:, 0, 0] += amplitude**3
    found = failed(noise(6), turned=turned)
    assert ("x", "dependence displacement") in found
    assert ("y", "dependence displacement") not in found


def test_a_variable_that_stays_is_not_tested():
    assert not any("temperature" in c.name for c in check_all([series(noise(8))]))


def test_a_weak_tone_is_seen_in_its_band_only():
    white = noise(9, n=3000, parts=1)
    white[:, 0, 0] += 0.25 * np.cos(2 * np.pi * 0.15 * np.arange(3000))
    found = failed(white)
    assert ("x", "variance frequency at resonance") in found
    assert ("x", "variance frequency above") not in found


def test_band_power_is_exact():
    """Parseval: all lines together hold the whole of the power, less mean."""
    values = np.random.default_rng(0).standard_normal(401)
    ((ratio, count, _),) = misfit.in_band(values, Band("all", 0.0, 0.5))
    assert count == 400
    assert ratio * count == pytest.approx(np.sum((values - values.mean()) ** 2), rel=1e-12)


def test_analysis_of_variance_is_that_of_scipy():
    rng = np.random.default_rng(1)
    values, place = rng.standard_normal(90), np.arange(90) % 3
    ((f, count, p),) = misfit.dependence(values[:, None], place * 10.0)
    expected = stats.f_oneway(*(values[place == k] for k in range(3)))
    assert (f, p) == pytest.approx((expected.statistic, expected.pvalue), rel=1e-10)
    assert count == 90


def test_correlations_are_those_of_ljung_and_box():
    """For one run Q is n(n+2) Σ ρ²/(n−k), without removing the mean."""
    r = np.random.default_rng(2).standard_normal(200)
    rho = [r[k:] @ r[:-k] / (r @ r) for k in range(1, 11)]
    q = 200 * 202 * sum(x**2 / (200 - k) for k, x in enumerate(rho, 1))
    ((found, _, p),) = misfit.whiteness(r[:, None], [slice(None)])
    assert found == pytest.approx(q, rel=1e-12)
    assert p == pytest.approx(stats.chi2.sf(q, 10), rel=1e-12)


@pytest.mark.parametrize(
    ("p", "failures"),
    [
        ([0.001, 0.02, 0.03], [True, True, True]),
        ([0.03, 0.03, 0.03], [False] * 3),
        ([0.02, 0.001, 0.3], [True, True, False]),
    ],
)
def test_holm(p, failures):
    p = np.array(p)
    assert list(p <= holm(p, 0.05)) == failures


def test_no_series_no_checks():
    assert check_all([]) == ()
