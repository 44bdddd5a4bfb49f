"""The engine's loop over blocks."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from memsgyro_jax.loop.engine import _scan_in_groups


@pytest.mark.parametrize("count", [1, 256, 257, 400, 1000])
def test_a_loop_of_loops_is_one_loop(count):
    def body(total, number):
        total = 0.5 * total + number
        return total, (total, jnp.stack([number, -number]))

    for got, want in zip(
        jax.tree.leaves(_scan_in_groups(body, jnp.zeros(()), count)),
        jax.tree.leaves(jax.lax.scan(body, jnp.zeros(()), jnp.arange(count))),
        strict=True,
    ):
        np.testing.assert_array_equal(got, want)
