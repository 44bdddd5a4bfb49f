"""Small matrices of scalars against NumPy, and what their zeros and ones cost."""

import jax
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.device.small import Matrix, Vector, identity, zeros


RNG = np.random.default_rng(0)
A, B, U, V = RNG.normal(size=(3, 4)), RNG.normal(size=(4, 2)), RNG.normal(size=4), RNG.normal(size=2)
F, G, X, Y = Matrix(A.tolist()), Matrix(B.tolist()), Vector(U.tolist()), Vector(V.tolist())


def test_operators_are_those_of_linear_algebra():
    np.testing.assert_allclose(F @ X, A @ U, rtol=1e-14)
    np.testing.assert_allclose(X @ G, U @ B, rtol=1e-14)
    np.testing.assert_allclose(F @ G, A @ B, rtol=1e-14)
    np.testing.assert_allclose(F @ G @ Y - 2.0 * (F @ X) + np.float64(3.0), A @ B @ V - 2.0 * A @ U + 3.0, rtol=1e-13)
    np.testing.assert_allclose(F.T @ -F, A.T @ -A, rtol=1e-13)
    np.testing.assert_allclose(G.beside(G).above(F), np.vstack([np.hstack([B, B]), A]))
    np.testing.assert_allclose(X * X / 2.0, U * U / 2.0)
    np.testing.assert_allclose(X @ X, U @ U)


def test_a_plain_tuple_may_stand_on_either_side():
    row, rows = (1.0, 2.0), ((1.0, 2.0), (3.0, 4.0))
    assert row + Vector((3.0, 4.0)) == Vector((3.0, 4.0)) + row == (4.0, 6.0)
    assert Matrix(rows) @ row == (5.0, 11.0)
    assert identity(2) + rows == ((2.0, 2.0), (3.0, 5.0))


def test_plain_zeros_and_ones_record_no_operation():
    def program(x, y):
        one, none = identity(2), zeros(2, 2)
        return tuple(one @ (x, y) + none @ (x, y) - (0.0, 0.0)), one.beside(none) @ (x, y, x, y)

    assert not jax.make_jaxpr(program)(1.0, 2.0).eqns
    assert len(jax.make_jaxpr(lambda x, y: Matrix(((x, 0.0), (1.0, y))) @ (x, y))(1.0, 2.0).eqns) == 3


def test_they_pass_through_transformations():
    doubled = jax.jit(lambda m: m + m)(Matrix(((1.0, 2.0), (3.0, 4.0))))
    assert isinstance(doubled, Matrix)
    assert isinstance(doubled[0], Vector)
    np.testing.assert_array_equal(doubled, [[2.0, 4.0], [6.0, 8.0]])
    dies = jax.vmap(lambda v: Vector((v, 2.0 * v)) @ (v, 1.0))(jnp.arange(3.0))
    np.testing.assert_array_equal(dies, [0.0, 3.0, 8.0])
