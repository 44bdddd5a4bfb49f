"""What is affine by what it computes, and what is not."""

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

from memsgyro_jax.base.affine import is_affine, is_constant


TABLE = jnp.arange(6.0).reshape(2, 3)


@jax.jit
def stretched(x):
    return 3.0 * x[::-1] - 1.0


AFFINE = {
    "constant": lambda x: jnp.ones(2),
    "table": lambda x: TABLE @ x + 1.0,
    "put together": lambda x: jnp.concatenate([x, 2.0 * x[:1]]).at[0].add(x[2]),
    "chosen by place": lambda x: jnp.where(jnp.arange(3) == 1, x, -x),
    "jitted": lambda x: stretched(stretched(x)) / 7.0,
    "filter_jit": lambda x: eqx.filter_jit(lambda y: y - 2.0)(x),
    "derivative of a square": jax.grad(lambda x: jnp.sum(x**2)),
}
NOT = {
    "square": lambda x: x**2,
    "product": lambda x: x * x[0],
    "modulus": jnp.abs,
    "beyond a threshold": lambda x: jnp.maximum(x - 1.0, 0.0),
    "chosen by value": lambda x: jnp.where(x > 0, x, 2.0 * x),
    "step": jnp.sign,
    "jitted square": lambda x: jax.jit(lambda y: y**2)(x) + x,
    "jitted step": lambda x: 0.5 * stretched(jnp.sign(x)),
    "rounded": lambda x: x.astype(int).astype(float),
    "held": lambda x: jax.lax.stop_gradient(x) * x,
    "loop": lambda x: jax.lax.fori_loop(0, 3, lambda _, y: y * y, x),
    "quotient": lambda x: 1.0 / x,
    "drawn by its place": lambda x: TABLE.ravel()[jnp.argmax(x)] * x,
}


@pytest.mark.parametrize("law", AFFINE)
def test_what_is_affine(law):
    assert is_affine(AFFINE[law], jnp.zeros(3))


@pytest.mark.parametrize("law", NOT)
def test_what_is_not(law):
    assert not is_affine(NOT[law], jnp.zeros(3))


def test_all_arguments_count():
    assert is_affine(lambda x, y: x + 2.0 * y, jnp.zeros(2), jnp.zeros(2))
    assert not is_affine(lambda x, y: x * y, jnp.zeros(2), jnp.zeros(2))


def test_what_takes_no_notice_is_constant():
    assert is_constant(lambda x, y: TABLE, jnp.zeros(2), jnp.zeros(2))
    assert is_constant(lambda x: jnp.zeros_like(x), jnp.zeros(2))
    assert not is_constant(lambda x, y: TABLE + y[0], jnp.zeros(2), jnp.zeros(2))
    assert not is_constant(lambda x: jnp.sign(x), jnp.zeros(2))


@jax.jit
def inside(x, other):
    return jnp.asarray(is_affine(lambda s: other * s, x)), jnp.asarray(is_affine(lambda s: other * s**2, x))


def test_what_else_it_closes_over_may_be_traced():
    yes, no = inside(jnp.ones(2), jnp.ones(2))
    assert yes
    assert not no
