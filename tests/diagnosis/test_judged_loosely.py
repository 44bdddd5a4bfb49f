"""A record that only judges what the others hold too loosely is fitted too."""

from dataclasses import replace

import numpy as np
import pytest

from memsgyro_jax.diagnosis.judged_loosely import judged_loosely, with_these_fitted


class Fit:
    """What a fit says of its records: one fitted, one that judges at ten times its noise, and what of that is beyond
    the uncertainty of the fit.
    """

    leaves_noise = True

    def __init__(self, case, beyond, fitted=1.0):
        self.case, self.beyond = case, beyond
        self.errors = (Error("sweep_x", "fit", fitted), Error("ringdown", "validation", 10.0))

    def beyond_uncertainty(self, error):
        return self.beyond**2 * error.count


class Error:
    def __init__(self, name, role, rms):
        self.name, self.role, self.rms, self.count, self.chi2 = name, role, rms, 1000, 1000 * rms**2
        self.explained = rms < 1.1


@pytest.fixture(scope="module")
def case():
    from bench_case import bench

    return with_role(bench().case, None)


def test_what_the_uncertainty_takes_is_fitted(case):
    assert judged_loosely(Fit(case, 1.2)) == ("ringdown",)
    whole = with_these_fitted(case, ("ringdown",))
    assert whole.record("ringdown").role == "fit"
    assert whole.record("sweep_x").role == case.record("sweep_x").role
    assert len(whole.records) == len(case.records)


@pytest.mark.parametrize(
    "fit",
    [
        lambda case: Fit(case, 9.0),  # it denies the model anyway
        lambda case: Fit(case, 1.2, fitted=3.0),  # what was fitted is not explained either
        lambda case: Fit(with_role(case, "validation"), 1.2),  # as the case says
    ],
    ids=["denied", "unexplained", "declared"],
)
def test_what_denies_a_model_is_not(case, fit):
    assert judged_loosely(fit(case)) == ()


def with_role(case, role):
    records = tuple(replace(r, role=role) if r.name == "ringdown" else r for r in case.records)
    return replace(case, records=records)


def test_the_figures_are_those_of_a_fit():
    """To first order what a refit would leave, and of what was fitted as it is."""
    from bench_case import bench

    from memsgyro_jax.diagnosis.fit import fit_case

    fit = fit_case(bench().case)
    for error in fit.errors:
        beyond = fit.beyond_uncertainty(error)
        assert np.isfinite(beyond)
        assert beyond <= error.chi2 * (1 + 1e-9)
        if error.role == "fit":
            assert beyond == error.chi2
