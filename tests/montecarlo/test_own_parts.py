"""Parts of a user's own are written for one die: in a lot they say of each die what they say of it alone."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.loop.die_by_die import differs, from_outside
from memsgyro_jax.loop.each_part import each_mapped
from memsgyro_jax.montecarlo.bounds import own_bounds
from memsgyro_jax.tuning import objective
from memsgyro_jax.tuning.objective import Objective
from memsgyro_jax.tuning.tunable import resolved
from memsgyro_jax.tuning.tune import timing_of


GYRO = mg.SingleMassGyro.from_modes("15 ug", ("3.2 kHz", "3.26 kHz"), (400, 350))
READOUT = mg.DirectReadout(0.1e6, noise_density=1e-7)
SPREAD = mg.Spread(
    (mg.Vary("device.kyy", mg.Normal(relative=0.02)), mg.Vary("start.0", mg.Uniform(low=2e-7, high=5e-6)))
)
RATE, DURATION = 80e3, 5e-4


class Level(mg.AbstractObserver):
    """Says as rate what the channels' root mean square gives."""

    pull: jax.Array = eqx.field(converter=jnp.asarray, default=0.2)
    model = mg.SingleMassGyro.model

    def init(self):
        return jnp.zeros(2)

    def update(self, state, measured, force, clock):
        return state + self.pull * (jnp.array(measured) - state)

    def estimate(self, state):
        rate = jnp.sqrt(jnp.mean(state**2))
        return mg.Estimate((*state * 1e-5, *state), GYRO.coefficients(rate), (0.0, 0.0), self.model)


class Unit(mg.AbstractController):
    """Pushes along the velocity, as hard whatever that is."""

    def init(self):
        return ()

    def command(self, state, estimate, clock):
        along = jnp.array(estimate.motion[2:])
        return tuple(1e-8 * along / (jnp.linalg.norm(along) + 1e-6)), state


class Common(mg.DirectReadout):
    """Both channels hold a share of their mean."""

    def measure(self, motion, noise, drift, period, effects=None, late=None):
        volts = jnp.array(super().measure(motion, noise, drift, period, effects, late))
        return tuple(volts + 0.3 * jnp.mean(volts))


class Bumps(mg.AbstractProfile):
    heights: tuple = eqx.field(converter=lambda given: tuple(map(jnp.asarray, given)), default=(0.5, 1.0))

    def value(self, time):
        return jnp.mean(jnp.array(self.heights) * jnp.cos(1e4 * time))


class Both(mg.losses.AbstractMean):
    def of(self, sample):
        return jnp.sum(jnp.array(sample.volts) ** 2)


LOOP = mg.ClosedLoop(GYRO, Common(0.1e6, noise_density=1e-7), Level(), Unit())
KALMAN = mg.ExtendedKalmanFilter.for_device(GYRO, READOUT)


def each(draw, design, die):
    """The loop and the scenario of one die of a draw."""
    given = draw.loop, draw.scenario
    return jax.tree.map(lambda leaf, varies: leaf[..., die] if varies else leaf, given, differs(given, design))


def test_a_sweep_gives_each_die_what_it_gets_alone():
    spread = mg.Spread((*SPREAD.items, mg.Vary("scenario.rate.heights.0", mg.Uniform(low=0.1, high=2.0))))
    scenario = mg.Scenario(Bumps())
    lot = mg.sweep(LOOP, spread, scenario, dies=3, seed=2, bound_dies=0, sample_rate=RATE, duration=DURATION)
    draw = spread.draw(LOOP, scenario, 2, np.arange(3))
    alone = []
    for die in range(3):
        loop, turning = each(draw, (LOOP, scenario), die)
        trace = mg.simulate(loop, turning, sample_rate=RATE, duration=DURATION, seed=2, die=die)
        alone.append(trace.rate_estimate[-1] - trace.rate_true[-1])
    assert np.ptp(alone) > 0.1
    np.testing.assert_allclose(lot.to_xarray().rate_error_end, alone, rtol=1e-9)


@pytest.mark.parametrize(
    "loss",
    [pytest.param(Both(), id="own", marks=pytest.mark.slow), pytest.param(mg.losses.SquaredRateError(), id="known")],
)
@pytest.mark.parametrize("many", [pytest.param(1, marks=pytest.mark.slow), 1000])
def test_tuning_gives_each_die_what_it_gets_alone(many, loss, monkeypatch):
    """Under a loss of the package the parts are mapped each by itself, under one of a user's own the whole."""
    monkeypatch.setattr(objective, "_MANY", many)  # backwards, forwards
    tunables = resolved(LOOP, mg.free({"observer.pull": (0.01, 0.9)}), RATE, DURATION)
    given = LOOP, mg.Scenario(mg.Constant(1.0)), SPREAD, tunables, loss
    lots = (
        Objective.of(*given, dies=np.arange(n), timing=timing_of(RATE, DURATION, 0.0), seed=0, lanes=n) for n in (1, 3)
    )
    (one, _, slope), (lot, _, slopes) = (made._run(tunables.values, derivative=True) for made in lots)
    np.testing.assert_allclose(lot[0], one[0], rtol=1e-9)
    np.testing.assert_allclose(slopes[0, 0], slope[0, 0], rtol=1e-9)
    assert np.ptp(lot) > 0.0


def test_bounds_are_those_of_each_die_alone():
    given = mg.ClosedLoop(GYRO, READOUT, Level(), Unit()), mg.Scenario(mg.Constant(1.0)), SPREAD, 0
    one, lot = (own_bounds(*given, n, RATE, DURATION) for n in (1, 3))
    assert lot[0] == one[0]
    assert np.ptp(lot) > 0.0


def test_a_part_from_outside_is_found_wherever_it_stands():
    plain = mg.ClosedLoop(GYRO, READOUT, KALMAN, mg.DampingCompensation())
    assert not from_outside(plain, mg.Scenario(mg.Constant(1.0)))
    assert from_outside(LOOP)
    assert from_outside(plain, mg.Scenario(Bumps()))
    assert from_outside(mg.losses.Weighted((Both(), 1.0)))
    assert not from_outside(GYRO.with_effect(mg.effects.CubicStiffness("x", 1e9)))


class Counting(mg.AbstractController):
    """Its state has a number, a table and a flag; its gain differs from die to die."""

    gain: jax.Array = eqx.field(converter=jnp.asarray, default=1e-8)
    share: jax.Array = eqx.field(converter=jnp.asarray, default=(1.0, 2.0, 3.0))

    def init(self):
        return jnp.zeros((), int), jnp.ones((2, 3)), jnp.zeros((), bool)

    def command(self, state, estimate, clock):
        number, table, _ = state
        table = 0.9 * table + jnp.array(estimate.motion[2:])[:, None] * self.share / jnp.sum(self.share)
        return self.gain * jnp.sum(table, axis=1) / jnp.linalg.norm(table), (number + 1, table, number > 3)


class Held(mg.DirectReadout):
    @property
    def travel(self):
        return jnp.mean(jnp.array(self.scale)) * 1e-10


def test_only_the_part_from_outside_is_mapped():
    """What is the package's stays as it is; a part's answers are those of each die alone; who computes more of its
    numbers than a port's methods do is mapped as a whole.
    """
    loop, scenario = mg.ClosedLoop(GYRO, READOUT, KALMAN, Counting()), mg.Scenario()
    spread = mg.Spread((mg.Vary("controller.gain", mg.Normal(relative=0.1)), *SPREAD.items))
    drawn = spread.draw(loop, scenario, 0, np.arange(3))
    mapped = each_mapped((drawn.loop, drawn.scenario), (loop, scenario))[0]
    assert type(mapped.observer) is type(KALMAN)
    estimate = mg.Estimate((*jnp.arange(12.0).reshape(4, 3),), GYRO.coefficients(1.0), (0.0, 0.0), GYRO.model)
    state = jax.tree.map(lambda leaf: jnp.stack([leaf] * 3, axis=-1), loop.controller.init())
    force, later = mapped.controller.command(state, estimate, mg.Clock(0.0, 0, 1e-5))
    for die in range(3):
        one, alone = (
            each(drawn, (loop, scenario), die)[0].controller,
            jax.tree.map(lambda leaf, k=die: leaf[..., k], state),
        )
        told = eqx.tree_at(lambda e: e.motion, estimate, tuple(value[die] for value in estimate.motion))
        own = one.command(alone, told, mg.Clock(0.0, 0, 1e-5))
        for found, expected in zip(jax.tree.leaves((force, later)), jax.tree.leaves(own), strict=True):
            np.testing.assert_allclose(found[..., die], expected, rtol=1e-15)

    plain = mg.ClosedLoop(GYRO, READOUT, KALMAN, mg.DampingCompensation())
    assert each_mapped((plain, scenario), (plain, scenario))[0] is plain
    whole = eqx.tree_at(lambda made: made.readout, loop, Held(0.1e6, noise_density=1e-7))
    for other in (whole, loop.in_blocks()):
        assert each_mapped((other, scenario), (other, scenario)) is None
