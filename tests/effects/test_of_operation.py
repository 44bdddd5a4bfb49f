"""Effects of temperature and age: promises of the port, laws, and what they do to what other effects see."""

import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from effects.members import CONDITIONS, model, seen, state_of

from memsgyro_jax import effects as fx
from memsgyro_jax.effects.trial import complaint, feels_warmth


ALL = [effect for effect in fx.every_effect(2) if type(effect) in fx.OF_OPERATION]
STRONG = (
    fx.ThermalGain(1e-3), fx.ThermalDelay(1e-9), fx.ThermalDrive(2e-3), fx.ThermalBias(1e-3),
    fx.SelfHeating(2e3, power=2e-3, settling=0.5), fx.AgeingStiffness(-1e-4, age=1e7), fx.AgeingOffset(1e-2, age=1e6),
)  # fmt: skip
WARM = 310.0 - 298.15  # of CONDITIONS
VOLTS = 3.0


@pytest.mark.parametrize("effect", ALL, ids=lambda effect: effect.label)
def test_the_promises_of_the_port(effect):
    assert complaint(effect, 2) == ""
    assert fx.by_name(effect.label).label == effect.label
    text = " ".join(inspect.getdoc(type(effect)).split())
    assert "Zero:" in text
    assert "Shows" in text
    assert effect.reference.split(",")[0].split(" et al")[0].split(" and ")[0] in text
    assert effect.label not in {member.label for member in fx.catalogue(2)}


def test_all_at_zero_are_absent_to_the_last_bit():
    of, without = model(*ALL), model()
    state = state_of(of)
    for one, other in zip(seen(of, state), seen(without, state[:4]), strict=True):
        np.testing.assert_array_equal(one[:4], other)


def test_which_feel_the_warmth():
    assert [feels_warmth(effect) for effect in STRONG] == [True, True, True, True, False, False, False]
    assert not any(feels_warmth(effect) for effect in ALL)
    assert feels_warmth(fx.ThermalStiffness(-6e-5))
    assert not feels_warmth(fx.CubicStiffness("x", 1e12))


def change(*effects, without=()):
    state = state_of(model(*effects))
    return [np.asarray(a)[:4] - np.asarray(b)[:4] for a, b in zip(
        seen(model(*effects), state), seen(model(*without), state[: model(*without).size]), strict=True
    )]  # fmt: skip


def test_laws():
    """Gain and delay of the volts, force of the electrodes, springs and rate that age, by hand."""
    of = model()
    state = state_of(of)
    volts = np.asarray(seen(of, state)[1])
    np.testing.assert_allclose(change(fx.ThermalGain(1e-3))[1], volts * 1e-3 * WARM, rtol=1e-10)
    late = 1e-9 * WARM
    np.testing.assert_allclose(change(fx.ThermalDelay(1e-9))[1], -late * 5e5 * state[2:], rtol=1e-2)
    push = np.array([1e-8, -2e-8]) / 1.8e-7
    np.testing.assert_allclose(change(fx.ThermalDrive(2e-3))[0][2:], 2e-3 * WARM * push, rtol=1e-8)
    decades = np.log10(1.0 + (1e7 + 0.2) / 86400.0)
    stiffness = np.array([64.0, 72.0]) / 1.8e-7
    aged = change(fx.AgeingStiffness(-1e-4, age=1e7))[0][2:]
    np.testing.assert_allclose(aged, 1e-4 * decades * stiffness * state[:2], rtol=1e-8)
    decades = np.log10(1.0 + (1e6 + 0.2) / 3600.0)
    turned = 2.0 * 1e-2 * decades * np.array([state[3], -state[2]])
    np.testing.assert_allclose(change(fx.AgeingOffset(1e-2, age=1e6, onset=3600.0))[0][2:], turned, rtol=1e-7)


def test_one_temperature_for_all_effects():
    """What heats itself is felt by springs, read-out and bias, and the bias at that temperature by what softens."""
    rise = 4.0
    heating = fx.SelfHeating(2e3, power=1e-3, settling=0.5)
    softening, gain = fx.ElectrostaticSoftening("x", 1e-2), fx.ThermalGain(1e-3)
    others = (fx.ThermalBias(1e-3), softening, fx.ThermalStiffness(-6e-5), gain)
    of, without = model(heating, *others), model(*others)
    state = np.concatenate([state_of(without), [rise]])
    hot = eqx.tree_at(lambda c: c.temperature, CONDITIONS, CONDITIONS.temperature + rise)
    for one, other in zip(seen(of, state), seen(without, state[:4], hot), strict=True):
        np.testing.assert_allclose(np.asarray(one)[:4], other, rtol=1e-12)
    bare = model(*others[1:])
    volts = eqx.tree_at(lambda c: c.bias_voltage, hot, VOLTS * (1.0 + 1e-3 * (WARM + rise)))
    np.testing.assert_allclose(seen(without, state[:4], hot)[0], seen(bare, state[:4], volts)[0], rtol=1e-12)
    push, velocity = np.array([1e-8, -2e-8]), state[2:4]
    rate = (2e3 * (1e-3 + push @ velocity) - rise) / 0.5
    np.testing.assert_allclose(seen(of, state)[0][4], rate, rtol=1e-10)


def test_slopes_are_finite_by_every_number():
    """By strengths, ages, powers and times alike, also at strength zero."""
    for effects in (tuple(ALL), STRONG):
        state = state_of(model(*effects))
        found = jax.jit(jax.jacrev(lambda e, s=state: jnp.concatenate(seen(model(*e), s))))(effects)
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(found))
