"""The engine's loop over blocks, and which dies it gives up."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.loop.engine import healthy, scan_in_groups


@pytest.mark.parametrize("count", [1, 256, 257, 400, 1000])
def test_a_loop_of_loops_is_one_loop(count):
    def body(total, number):
        total = 0.5 * total + number
        return total, (total, jnp.stack([number, -number]))

    for got, want in zip(
        jax.tree.leaves(scan_in_groups(body, jnp.zeros(()), count)),
        jax.tree.leaves(jax.lax.scan(body, jnp.zeros(()), jnp.arange(count))),
        strict=True,
    ):
        np.testing.assert_array_equal(got, want)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_die_out_of_its_travel_on_either_axis_is_given_up(sign):
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    observer = mg.ExtendedKalmanFilter.for_device(gyro, readout)
    loop = mg.ClosedLoop(gyro, readout, observer, mg.OpenLoop(), travel=2e-6)
    for motion, whole in (((1.9e-6, -1.9e-6), True), ((2.1e-6, 0.0), False), ((0.0, 2.1e-6), False)):
        state = eqx.tree_at(lambda s: s.motion, loop.init(), (*(sign * place for place in motion), 0.0, 0.0))
        assert bool(healthy(loop, state)) == whole
