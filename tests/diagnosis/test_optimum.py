"""What becomes of a fit where the model has no finite residual or slopes."""

from types import SimpleNamespace

import numpy as np
import pytest

from memsgyro_jax.diagnosis.optimum import optimise


def lame(broken):
    """A linear joint residual of three parameters, which is `broken` where the last is beyond a half."""
    table, target = np.random.default_rng(5).normal(size=(12, 3)), np.arange(12.0)

    def linearise(vector, rows, chosen):
        residual, slopes = table @ vector - target, table @ rows.T
        return broken(residual, slopes) if vector[2] > 0.5 else (residual, slopes)

    nothing = np.zeros(0, int)
    return SimpleNamespace(
        linearise=linearise, bounds=(np.full(3, -10.0), np.full(3, 10.0)), numbers=nothing, parameters=(),
        model=SimpleNamespace(effects=()), of_effect=lambda i: nothing, numbers_of=lambda i: nothing,
        at=lambda vector: SimpleNamespace(device=SimpleNamespace(is_held=True, is_slowed=True)),
    )  # fmt: skip


@pytest.mark.parametrize("start", [0.0, 1.0])
@pytest.mark.parametrize(
    "broken",
    [
        lambda residual, slopes: (residual, np.full_like(slopes, np.nan)),
        lambda residual, slopes: (np.full_like(residual, np.nan), slopes),
        lambda residual, slopes: (np.full_like(residual, np.inf), np.full_like(slopes, np.inf)),
    ],
)
def test_a_model_that_is_not_finite_ends_a_fit_and_not_the_program(start, broken):
    """LAPACK raised "SVD did not converge", and a diagnosis of six minutes ended without a verdict."""
    found = optimise(lame(broken), np.array([0.0, 0.0, start]), np.arange(3), ())
    assert np.isfinite(found.vector).all()
    assert np.isfinite(found.chi2)
    assert np.isfinite(found.jacobian).all()
