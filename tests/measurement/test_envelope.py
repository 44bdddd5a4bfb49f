"""What a lock-in makes of a block, against the integral of the signal itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from memsgyro_jax.base.linalg import among, at_place
from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.device.gyro import SingleMassGyro
from memsgyro_jax.effects import CubicStiffness
from memsgyro_jax.measurement.envelope import Driven, Propagator
from memsgyro_jax.measurement.model import Model


def test_a_block_of_a_lock_in_is_the_mean_of_the_turned_signal():
    """Six cycles in which the drive sets in while a deflection decays: harmonics 0 and 1 both change within it."""
    device = SingleMassGyro(mass=1e-7, kxx=60.0, kyy=80.0, kxy=3.0, dxx=2e-4, dyy=3e-4, dxy=1e-5)
    model, omega, fine = Model(device), 2.1e4, 12_000
    length = 6 * 2 * np.pi / omega
    driven = Driven.of(model, jnp.asarray(omega), jnp.asarray([1e-6, 0.0]), Conditions())
    start = driven.at_rest().at[0, :2].set(jnp.asarray([2e-7, -1e-7]))

    def course(step, count):
        return driven.run(start, step, Conditions().rows(count))[1]

    (block,) = jax.jit(lambda: driven.demodulated(start, length, Conditions().rows(1))[0])()
    states = jax.jit(lambda: course(length / fine, fine).start)()
    time = np.arange(fine) * length / fine
    signal = np.real(np.einsum("th,thn->tn", np.exp(1j * np.outer(time, np.arange(3)) * omega), np.asarray(states)))
    last = np.asarray(jax.jit(lambda: driven.instant(driven.run(start, length, Conditions().rows(1))[0], length))())
    turned = np.exp(-1j * omega * np.append(time, length))[:, None] * np.concatenate([signal, last[None]])
    wanted = 2 * np.trapezoid(turned, dx=1 / fine, axis=0)
    assert abs(block[0, 0]) > 1e-3 * abs(block[1, 0]), "the deflection must matter"
    np.testing.assert_allclose(block[1, :2], wanted[:2], rtol=2e-6)


def test_a_step_is_of_second_order_in_what_the_linear_part_leaves_out():
    matrix, load = np.array([[-0.3, 2.0], [-2.0, -0.5]]), np.array([0.4, -0.2])

    def rest(state):
        return jnp.stack([-0.3 * state[0] ** 3, state[0] * state[1]])

    def end(count):
        step, state = Propagator.of(jnp.asarray(matrix), jnp.asarray(1.0 / count), jnp.ones(2)), jnp.array([1.0, 0.5])
        for _ in range(count):
            state, *_ = step.advance(state, load, rest)
        return state

    course = solve_ivp(lambda t, s: matrix @ s + load + np.asarray(rest(s)), (0, 1), [1.0, 0.5], rtol=1e-9, atol=1e-12)
    coarse, fine = (np.abs(end(count) - course.y[:, -1]) for count in (12, 24))
    assert np.all(fine < 2e-3)
    np.testing.assert_allclose(coarse / fine, 4.0, rtol=0.2)


@pytest.mark.parametrize("effects", [(), (CubicStiffness("x", 1e9),)])
def test_a_step_has_no_scatter_of_which_a_loop_would_be_made(effects):
    """XLA wrote one for each `.at[...]`: 86 kernels a step of a rate table along twelve directions, in place of 27."""
    device = SingleMassGyro(mass=1e-7, kxx=60.0, kyy=80.0, kxy=3.0, dxx=2e-4, dyy=3e-4, dxy=1e-5)

    def end(force):
        driven = Driven.of(Model(device, effects=effects), jnp.asarray(2.1e4), force, Conditions())
        return driven.run(driven.at_rest(), 1e-3, Conditions().rows(5))[0]

    def along(force):
        return jax.jvp(end, (force,), (force,))[1]

    program = str(jax.make_jaxpr(along)(jnp.asarray([1e-6, 0.0])))
    assert "scan" in program
    assert "scatter" not in program[program.index("scan") :]


def test_entries_stand_at_their_places():
    entries = jnp.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(among(entries, (1, 2, 3), 5), np.pad(entries, ((0, 0), (1, 1))))
    spread = np.zeros((2, 5))
    spread[:, [0, 2, 4]] = entries
    np.testing.assert_array_equal(among(entries, (0, 2, 4), 5), spread)
    np.testing.assert_array_equal(at_place(entries, 1, 3)[1], entries)
    np.testing.assert_array_equal(at_place(entries, 1, 3)[::2], 0.0)
