"""Programs in place of many operations: the same numbers, and the same transformations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from memsgyro_jax.base.plainly import at_once, plainly


traced: list[tuple] = []


def powers(x, scale, count=2, *, shift=0.0):
    traced.append((count,))
    return sum(scale * x**k for k in range(count)) + shift


TOGETHER = at_once(powers)


@pytest.mark.parametrize("make", [at_once, plainly])
def test_the_numbers_are_those_of_the_function(make):
    x = jnp.linspace(0.1, 2.0, 7)
    np.testing.assert_allclose(make(powers)(x, 1.5, 3, shift=0.2), powers(x, 1.5, 3, shift=0.2), rtol=1e-15)


def test_other_numbers_need_no_other_program_and_other_counts_do():
    x = jnp.ones(4)
    TOGETHER(x, 1.0, 3)
    traced.clear()
    for scale in (2.0, 3.0, np.float64(4.0), 5.0 * jnp.ones(())):
        TOGETHER(x, scale, 3, shift=0.0)
    assert len(traced) <= 1, "one more as `shift` is given"
    TOGETHER(x, 1.0, 4, shift=0.0)
    assert traced[-1] == (4,)


def test_it_can_be_differentiated_mapped_and_part_of_another_program():
    def third(x):
        return TOGETHER(x, 2.0, 3)

    np.testing.assert_allclose(jax.grad(third)(0.7), 2.0 + 4.0 * 0.7, rtol=1e-14)
    np.testing.assert_allclose(jax.jvp(third, (0.7,), (1.0,))[1], 2.0 + 4.0 * 0.7, rtol=1e-14)
    x = jnp.linspace(-1.0, 1.0, 5)
    np.testing.assert_allclose(jax.vmap(third)(x), third(x), rtol=1e-15)
    text = jax.jit(lambda x: TOGETHER(x, 2.0, 3) * 2.0).lower(x).as_text()
    assert "call @" not in text, "it is part of what calls it"


def test_what_depends_on_the_value_of_a_number_is_refused():
    with pytest.raises(jax.errors.TracerBoolConversionError):
        at_once(lambda x: x if x > 0.0 else -x)(1.0)
