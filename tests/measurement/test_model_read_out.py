"""A read-out of velocity or of acceleration shows the derivative of what one of displacement shows, in every record."""

import jax.numpy as jnp
import numpy as np
import pytest

from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.effects import CubicStiffness, PickoffNonlinearity, QuadraticDamping, ReadoutDelay
from memsgyro_jax.measurement.experiments import CartesianNoise, HarmonicSweep
from memsgyro_jax.measurement.model import Model


W, D = 2 * np.pi * 1000.0, 60.0
DEVICE = NormalisedDevice([W**2], [D], 3.0)
AROUND = Conditions(rate=0.0, temperature=298.15, bias_voltage=0.0, time=0.0, progress=0.0, record=0.0)


def test_waveforms_of_each_quantity_are_derivatives_of_the_one_before():
    cubic = CubicStiffness("x", 1e11)
    models = [Model(DEVICE, scale=2.0, effects=(cubic,), order=order) for order in range(3)]
    state, push = jnp.array([1e-3, 4.0]), jnp.array([20.0])
    slope = models[0].derivative(state, push, AROUND)
    seen = [float(model.observe(state, push, jnp.zeros(1), AROUND)[0]) for model in models]
    np.testing.assert_allclose(seen, 2.0 * np.array([1e-3, 4.0, float(slope[1])]), rtol=1e-12)


@pytest.mark.parametrize("order", [1, *(pytest.param(order, marks=pytest.mark.slow) for order in (0, 2))])
def test_sweeps_of_each_quantity(order):
    omega = W * np.linspace(0.97, 1.03, 9)
    force = np.full((9, 1), 5.0 + 0j)
    sweep = HarmonicSweep(
        "sweep", jnp.asarray(omega), jnp.asarray(force), jnp.zeros((9, 1), complex), CartesianNoise(1.0),
        AROUND.rows(9), jnp.zeros((9, 1), complex), jnp.ones(9),
    )  # fmt: skip
    delay = 2.6 / W
    model = Model(DEVICE, scale=2.0, order=order, effects=(ReadoutDelay(delay),))
    shown = np.asarray(sweep.predict(model))[:, 0] * np.exp(1j * omega * delay)
    response = 3.0 * 5.0 / (W**2 - omega**2 + 1j * omega * D)
    np.testing.assert_allclose(shown, 2.0 * (1j * omega) ** order * response, rtol=1e-10)
    np.testing.assert_allclose(model.motion(shown[:, None], omega)[:, 0], response, rtol=1e-10)
    force = np.asarray(sweep.missing(model, slice(None), sweep.predict(model))[1])
    assert force.shape == (9, 1)


def test_a_channel_that_is_turned_round_shows_the_same_device():
    """Springs and dampers act on the mass; only what drives it, or shows it, has its sign the other way round."""
    odd = CubicStiffness("x", 1e11), QuadraticDamping("x", 3.0)
    plain, turned = (Model(NormalisedDevice([W**2], [D], sign * 3.0), effects=odd) for sign in (1.0, -1.0))
    state, push = jnp.array([1e-3, 4.0]), jnp.array([20.0])
    np.testing.assert_allclose(
        turned.derivative(-state, push, AROUND), -plain.derivative(state, push, AROUND), rtol=1e-12
    )


def test_read_out_effects_act_on_what_is_read():
    curved = Model(DEVICE, scale=2.0, effects=(PickoffNonlinearity("x", 0.1),), order=1)
    state, still = jnp.array([1e-3, 4.0]), jnp.zeros(1)
    assert float(curved.observe(state, still, still, AROUND)[0]) == pytest.approx(2.0 * (4.0 + 0.1 * 16.0), rel=1e-12)
    late = [Model(DEVICE, effects=(ReadoutDelay(s),), order=1) for s in (1e-6, 0.0)]
    turned = [complex(v) for v in (_phasor(model) for model in late)]
    assert turned[0] / turned[1] == pytest.approx(np.exp(-1j * W * 1e-6), abs=(W * 1e-6) ** 3)


def _phasor(model: Model) -> complex:
    """Of a free undamped turn: its value now, and a quarter of a period later."""
    device = NormalisedDevice([W**2], [0.0], 3.0)
    model = Model(device, effects=model.effects, order=1)
    still = jnp.zeros(1)
    now, later = (float(model.observe(jnp.array(s), still, still, AROUND)[0]) for s in ([1e-3, 0.0], [0.0, -1e-3 * W]))
    return now - 1j * later
