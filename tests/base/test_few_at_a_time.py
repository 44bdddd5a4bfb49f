"""Rows that iterate as long as they need: the same as all at once, to the last bit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from memsgyro_jax.base import few_at_a_time
from memsgyro_jax.base.few_at_a_time import FEW, over_rows


def _root(square, start):
    """By Newton's method, as many steps as it takes."""
    step = lambda carry: (0.5 * (carry[0] + square / carry[0]), carry[0])  # noqa: E731
    far = lambda carry: jnp.abs(carry[0] - carry[1]) > 1e-14 * carry[0]  # noqa: E731
    found, _ = jax.lax.while_loop(far, step, (start, 2.0 * start + 1.0))
    return {"root": found, "both": jnp.stack([found, -found])}


@pytest.mark.parametrize("count", [1, FEW, FEW + 1, 3 * FEW - 1, 4 * FEW])
def test_rows_are_as_they_are_all_at_once(count):
    squares, start = np.geomspace(1e-8, 1e8, count), np.ones(count)
    whole, few = (jax.jit(every)(squares, start) for every in (jax.vmap(_root), lambda *rows: over_rows(_root, *rows)))
    assert few["both"].shape == (count, 2)
    for name in whole:
        np.testing.assert_array_equal(whole[name], few[name])
    np.testing.assert_allclose(few["root"], np.sqrt(squares), rtol=1e-12)


def test_what_is_not_there_stays_so_and_derivatives_go_through():
    values = jnp.linspace(1.0, 2.0, 2 * FEW + 3)

    def cubes(scale):
        return over_rows(lambda value, none: scale * value**3 if none is None else value, values, None)

    found, slope = jax.jvp(cubes, (2.0,), (1.0,))
    np.testing.assert_allclose(found, 2.0 * values**3)
    np.testing.assert_allclose(slope, values**3)
    ways = jax.vmap(lambda step: jax.jvp(cubes, (2.0,), (step,))[1])(jnp.arange(3.0))
    np.testing.assert_allclose(ways, jnp.arange(3.0)[:, None] * values**3)


def test_an_accelerator_takes_all_rows_at_once(monkeypatch):
    monkeypatch.setattr(few_at_a_time.jax, "default_backend", lambda: "gpu")
    text = str(jax.make_jaxpr(lambda x: over_rows(jnp.sin, x))(jnp.zeros(5 * FEW)))
    assert "scan" not in text
