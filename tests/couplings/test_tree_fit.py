"""Maximum likelihood on problems with known answers, and the tree of what is free."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.transforms import (
    Free,
    GaussianPrior,
    Identity,
    Log,
    Logit,
    LogLogit,
    fixed,
    from_vector,
    mark,
    to_vector,
)
from memsgyro_jax.couplings.tree_fit import evaluate, fit_tree, fit_tree_from
from memsgyro_jax.measurement.experiments.base import Experiment, Noise


class Line(eqx.Module):
    slope: jax.Array = eqx.field(converter=jnp.asarray)
    offset: jax.Array = eqx.field(converter=jnp.asarray)
    unused: jax.Array | None = None


class White(Noise):
    std: float

    def whiten(self, measured, predicted):
        return (measured - predicted) / self.std


class Ruler(Experiment):
    name: str = eqx.field(static=True)
    x: jax.Array
    measured: jax.Array
    noise: White

    def predict(self, bench):
        return bench.slope * self.x + bench.offset

    def conditions(self):
        return {"x [1]": self.x}


X = np.linspace(0.0, 4.0, 41)
RECORD = Ruler(
    "line", jnp.asarray(X), jnp.asarray(2.0 * X - 1.0 + 0.1 * np.random.default_rng(0).normal(size=41)), White(0.1)
)
LINE = Line(1.0, 0.5)
BOTH = mark(fixed(LINE), lambda line: (line.slope, line.offset), Free())


def test_a_line_is_fitted_like_least_squares():
    result = fit_tree(LINE, BOTH, [RECORD])
    matrix = np.stack([X, np.ones(41)], axis=1)
    expected, rest, *_ = np.linalg.lstsq(matrix, np.asarray(RECORD.measured), rcond=None)
    np.testing.assert_allclose([result.values.slope, result.values.offset], expected, rtol=1e-9)
    np.testing.assert_allclose(result.covariance, 0.01 * np.linalg.inv(matrix.T @ matrix), rtol=1e-9)
    assert float(result.chi2) == pytest.approx(rest[0] / 0.01, rel=1e-9)
    assert result.dof == 39
    assert result.status == "converged"
    assert result.names == ("slope", "offset")
    np.testing.assert_allclose(evaluate(LINE, BOTH, [RECORD]).covariance, result.covariance, rtol=1e-9)


def test_only_what_is_free_moves():
    result = fit_tree(LINE, mark(fixed(LINE), lambda line: line.slope, Free(Log())), [RECORD])
    assert float(result.values.offset) == 0.5
    expected = X @ (np.asarray(RECORD.measured) - 0.5) / (X @ X)
    assert float(result.values.slope) == pytest.approx(expected, rel=1e-9)
    assert float(result.std_of(lambda line: line.slope)) == pytest.approx(0.1 / np.sqrt(X @ X), rel=1e-6)


def test_a_prior_is_one_more_reading():
    spec = mark(fixed(LINE), lambda line: line.slope, Free(Identity(), GaussianPrior(3.0, 0.01)))
    result = fit_tree(LINE, spec, [RECORD])
    target = np.asarray(RECORD.measured) - 0.5
    expected = (X @ target / 0.01 + 3.0 / 1e-4) / (X @ X / 0.01 + 1e4)
    assert float(result.values.slope) == pytest.approx(expected, rel=1e-9)
    assert result.dof == 41


class Sum(Ruler):
    def predict(self, bench):
        return (bench.slope + bench.offset) * self.x


def test_a_null_direction_is_named():
    record = Sum("sum", RECORD.x, RECORD.measured, White(0.1))
    result = fit_tree(LINE, BOTH, [record])
    (null,) = result.null_directions()
    assert str(null) in ("+0.71·slope -0.71·offset", "-0.71·slope +0.71·offset")
    assert "leave open" in result.status


def test_an_unused_positive_parameter_is_named():
    line = Line(1.0, 0.5, jnp.asarray(3.0))
    spec = mark(fixed(line), lambda tree: tree.unused, Free(Log()))
    spec = mark(spec, lambda tree: tree.slope, Free())
    assert fit_tree(line, spec, [RECORD]).open_parameters() == ("unused",)


def test_the_best_of_several_starts_is_returned():
    class Wave(Ruler):
        def predict(self, bench):
            return jnp.sin(bench.slope * self.x) + bench.offset

    wave = Wave("wave", RECORD.x, jnp.sin(3.0 * RECORD.x), White(0.01))
    starts = Line(jnp.array([0.3, 2.8, 9.0]), jnp.zeros(3))
    result = fit_tree_from(starts, mark(fixed(LINE), lambda line: (line.slope, line.offset), Free()), [wave])
    assert float(result.values.slope) == pytest.approx(3.0, abs=1e-9)


def test_the_fit_is_differentiable_and_batched():
    @jax.jit
    def slope(readings):
        return fit_tree(LINE, BOTH, [eqx.tree_at(lambda r: r.measured, RECORD, readings)]).values.slope

    gradient = jax.jacfwd(slope)(RECORD.measured)
    matrix = np.stack([X, np.ones(41)], axis=1)
    np.testing.assert_allclose(gradient, np.linalg.pinv(matrix)[0], atol=1e-9)
    batch = jax.vmap(slope)(jnp.stack([RECORD.measured, RECORD.measured + X]))
    np.testing.assert_allclose(batch[1] - batch[0], 1.0, rtol=1e-8)


TRANSFORMS = [Identity(), Log(), Logit(0.0, 10.0), LogLogit(1e-3, 1e3)]


@pytest.mark.parametrize("transform", TRANSFORMS, ids=lambda t: type(t).__name__)
@given(value=st.floats(0.01, 9.9))
def test_a_transform_and_its_inverse_agree(transform, value):
    assert float(transform.inverse(transform.forward(jnp.asarray(value)))) == pytest.approx(value, rel=1e-9)
    assert bool(transform.admits(jnp.asarray(value)))


def test_a_value_on_its_bound_keeps_a_finite_coordinate():
    assert np.isfinite(float(LogLogit(1.0, 1e9).forward(jnp.asarray(1e9))))


def test_vector_and_tree_are_one_to_one():
    spec = mark(BOTH, lambda line: line.slope, Free(Log()))
    vector = to_vector(LINE, spec)
    back = from_vector(vector, LINE, spec)
    assert (float(back.slope), float(back.offset)) == (pytest.approx(1.0), pytest.approx(0.5))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: fit_tree(LINE, fixed(LINE), [RECORD]), "at least one leaf free"),
        (lambda: fit_tree(LINE, BOTH, []), "at least one record"),
        (
            lambda: fit_tree(Line(-1.0, 0.0), mark(BOTH, lambda line: line.slope, Free(Log())), [RECORD]),
            "`slope` must lie within",
        ),
        (lambda: fit_tree(LINE, Free(), [RECORD]), "shape of the values"),
        (
            lambda: fit_tree(
                LINE, BOTH, [eqx.tree_at(lambda r: (r.x, r.measured), RECORD, (jnp.ones(2), jnp.ones(2)))]
            ),
            "more than 2",
        ),
    ],
)
def test_what_cannot_be_fitted_is_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_single_precision_is_refused():
    with jax.enable_x64(False), pytest.raises(InputError, match="float64"):
        fit_tree(LINE, BOTH, [RECORD])
