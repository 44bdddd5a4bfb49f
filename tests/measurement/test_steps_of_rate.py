"""Rows of a rate table that last for many beats of the split, through steps and fast sines of the rate."""

from functools import cache
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.device.gyro import SingleMassGyro
from memsgyro_jax.effects import by_name
from memsgyro_jax.measurement.absent import Absent
from memsgyro_jax.measurement.experiments import CartesianNoise, RateTable
from memsgyro_jax.measurement.first_order import contributions
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.rate_nodes import RateNodes


MASS, FORCE, OMEGA = 2.5e-7, 5e-8, 2 * np.pi * 6000.0
MODES, LOSSES = OMEGA * np.array([1.0, 6400 / 6000]), OMEGA * np.array([1 / 3000, 6400 / 6000 / 1200])
QUADRATURE, JOINT = 2 * OMEGA * 2.6, 0.02  # per mass: of stiffness and damping
FASTEST = np.radians(300.0)
STEPS = FASTEST * np.repeat([0.0, 0.5, 0.0, -0.5, 1.0, 0.0, -1.0, 0.0], 4)
SINE = FASTEST * np.sin(2 * np.pi * 0.13 * np.arange(32))  # a row is an eighth of a period


def true_means(rates, cycles):
    """(t, 2) mean phasors of blocks of held rates [m]: q̈ + C q̇ + K q = F cos ωt / m, where C turns with the rate."""
    step, motion, means = cycles * 2 * np.pi / OMEGA, None, []
    for rate in rates:
        stiffness = np.array([[MODES[0] ** 2, QUADRATURE], [QUADRATURE, MODES[1] ** 2]])
        damping = np.array([[LOSSES[0], JOINT - 2 * rate], [JOINT + 2 * rate, LOSSES[1]]])
        turning = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -damping]]) - 1j * OMEGA * np.eye(4)
        settled = np.linalg.solve(turning, -np.array([0.0, 0.0, FORCE / MASS, 0.0]))
        away = np.zeros(4) if motion is None else motion - settled
        end = expm(turning * step) @ away
        means.append((settled + np.linalg.solve(turning, end - away) / step)[:2])
        motion = settled + end
    return np.array(means)


def turned(rates, cycles, boxcar=False):
    """The table of this device, and a model of it."""
    k, c = MASS * MODES**2, MASS * LOSSES
    gyro = SingleMassGyro(mass=MASS, kxx=k[0], kyy=k[1], kxy=MASS * QUADRATURE, dxx=c[0], dyy=c[1], dxy=MASS * JOINT)
    step = cycles * 2 * np.pi / OMEGA
    around = eqx.tree_at(lambda s: s.rate, Conditions().rows(len(rates)), jnp.asarray(rates))
    blank = np.zeros((len(rates), 2))
    table = RateTable(
        "turned", step * jnp.arange(len(rates)), blank + 0j, CartesianNoise(blank + 1.0), jnp.asarray(OMEGA),
        jnp.asarray([FORCE, 0.0]), around, jnp.asarray(step), RateNodes.of(rates, step), boxcar,
    )  # fmt: skip
    return table, Model(gyro)


@cache
def predicted(kind, cycles):
    rates = {"steps": STEPS, "sine": SINE}[kind]
    table, model = turned(rates, cycles)
    return SimpleNamespace(means=np.asarray(jax.jit(lambda: table.predict(model))()), wanted=true_means(rates, cycles))


@pytest.mark.parametrize(("kind", "cycles"), [("steps", 600), ("sine", 60)])
def test_rows_of_many_beats_follow_the_rate(kind, cycles):
    found = predicted(kind, cycles)
    np.testing.assert_allclose(found.means, found.wanted, rtol=0, atol=1e-8 * np.max(np.abs(found.wanted)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cubic_stiffness", "centrifugal"])
def test_what_an_effect_adds_on_its_way_is_what_it_changes(name):
    """Cubic stiffness acts on what a step leaves out; centrifugal softening on what is propagated, rate by rate."""
    table, model = turned(STEPS[::2], 600)
    effect = by_name(name, "x") if name == "cubic_stiffness" else by_name(name)
    places = Absent((effect,), (0,))
    strength = jnp.zeros_like(effect.strength)

    def carried(strength):
        return table.predict(model.with_effect(eqx.tree_at(lambda e: e.strength, effect, strength)))

    inquiry = jax.jit(lambda: table.predict_beside(model, table.nothing(model))[1])()
    added = jax.tree.map(lambda leaf: jnp.asarray(leaf)[0], contributions(model, places, inquiry))
    none = jax.tree.map(jnp.asarray, table.nothing(model))
    _, beside = jax.jit(lambda: jax.jvp(lambda a: table.predict_beside(model, a)[0], (none,), (added,)))()
    _, wanted = jax.jit(lambda: jax.jvp(carried, (strength,), (jnp.ones_like(strength),)))()
    np.testing.assert_allclose(beside, wanted, rtol=0, atol=1e-6 * np.max(np.abs(wanted)))


@pytest.mark.parametrize(("step", "count"), [(0.1, 9), (30.0, 5)])
def test_nodes_tell_what_turns_by_the_rate(step, count):
    """Also where a table turns round many times within a row: steps of few rates are then made one by one."""
    nodes = RateNodes.of(STEPS, step)
    assert nodes.rate.size == count
    turned = np.asarray(nodes.at_rows(jnp.exp(1j * nodes.rate * step)))
    np.testing.assert_allclose(turned, np.exp(1j * STEPS * step), rtol=0, atol=1e-9)
