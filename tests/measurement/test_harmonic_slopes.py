"""The Jacobian of the harmonic balance, put together from Fourier coefficients, against automatic differentiation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from memsgyro_jax.base.linalg import inverse, product
from memsgyro_jax.measurement import steady


@pytest.mark.parametrize("fineness", [steady.FINENESS[0], pytest.param(steady.FINENESS[1], marks=pytest.mark.slow)])
def test_slopes_are_those_of_the_law(fineness):
    """For a law of three of four entries of a state that has kinks, even and odd powers, and entries that mix."""
    harmonics, samples = fineness
    rng = np.random.default_rng(5)
    push = rng.normal(size=(harmonics + 1, 4, 3)) + 1j * rng.normal(size=(harmonics + 1, 4, 3))
    push[0] = push[0].real

    def law(s):
        return jnp.stack([s[0] ** 3 + s[1] * s[2], jnp.maximum(s[2] - 0.3, 0.0), jnp.tanh(s[3]) * s[0]])

    class Model:  # as much of one as unflattening looks at
        nonlinear_rows = (0, 1, 2)

    def coefficients(flat):
        state = product(push, steady._unflatten(flat, Model, harmonics))
        return steady._flatten(steady.spectrum(jax.vmap(law)(steady.waveform(state, samples)), harmonics))

    at = jnp.asarray(rng.normal(size=3 * (2 * harmonics + 1)))

    @jax.jit
    def found(flat):
        state = product(push, steady._unflatten(flat, Model, harmonics))
        return steady._harmonic_slopes(jax.vmap(jax.jacfwd(law))(steady.waveform(state, samples)), push)

    wanted = jax.jit(jax.jacfwd(coefficients))(at)
    np.testing.assert_allclose(found(at), wanted, atol=1e-11 * np.abs(wanted).max())


@pytest.mark.parametrize("size", [1, 5, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 31))])
@pytest.mark.parametrize("kind", [float, complex])
def test_inverses_are_those_of_lapack(size, kind):
    """Also where rows must change places, and where they are of very different size."""
    rng = np.random.default_rng(size)
    matrices = rng.normal(size=(20, size, size)).astype(kind)
    matrices = matrices + 1j * rng.normal(size=matrices.shape) if kind is complex else matrices
    matrices[::2] = matrices[::2, ::-1] * np.geomspace(1e-9, 1e9, size)[:, None]
    matrices[1::4, 0, 0] = 0.0 if size > 1 else 1.0
    found = jax.jit(jax.vmap(inverse))(matrices)
    for one, other in zip(found, np.linalg.inv(matrices), strict=True):
        assert np.all(np.abs(one - other) <= 1e-8 * np.abs(other) + 1e-10 * np.abs(other).max(axis=0))
