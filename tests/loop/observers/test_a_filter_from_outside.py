"""Somebody's own filter, written as its equations, gets what the package gives to a filter with a covariance."""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.device.gyro import MotionModel
from memsgyro_jax.device.small import Matrix, Vector, identity
from memsgyro_jax.loop.observers.base import Innovation
from memsgyro_jax.tuning.tunable import resolved
from memsgyro_jax.tuning.tune import _stages


class Belief(NamedTuple):
    mean: tuple
    covariance: Matrix
    innovation: Innovation


class RateFilter(mg.AbstractCovarianceObserver):
    """A Kalman filter for motion and rate of a device that is known otherwise."""

    prior: mg.Prior
    process_noise: mg.ProcessNoise
    scale: tuple
    noise_density: tuple
    model: MotionModel = eqx.field(static=True)
    states = ("x", "y", "vx", "vy", "rate")
    usually_tuned = ("process_noise.rate",)

    def init(self):
        std = Vector((*self.prior.motion_std, self.prior.theta_std[0]))
        mean = (*self.prior.motion, self.prior.theta[0])
        return Belief(mean, _diagonal(std * std), Innovation((0.0, 0.0), (1.0, 1.0)))

    def update(self, state, measured, force, clock):
        motion, rate = state.mean[:4], state.mean[4]
        device = self.model.assemble((rate, *self.prior.theta[1:]))
        step = mg.Exact().transition(device.stiffness, device.velocity, clock.period)
        push = device.gain * force
        middle = step.nodes[0].reach @ motion + step.nodes[0].push @ push
        turned = step.nodes[0].kick @ (2.0 * middle[3], -2.0 * middle[2])
        F = step.full.beside(Matrix([turned]).T).above([(0.0, 0.0, 0.0, 0.0, 1.0)])
        x = Vector((*(step.full @ motion + step.push @ push), rate))
        P = F @ state.covariance @ F.T
        P = P + _diagonal((0.0, 0.0, 0.0, 0.0, self.process_noise.theta[0] * clock.period))
        errors, variances = [], []
        for axis, scale in enumerate(self.scale):
            h = Vector(scale if i == axis else 0.0 for i in range(5))
            error = measured[axis] - self.prior.offset[axis] - h @ x
            variance = h @ P @ h + self.noise_density[axis] ** 2 * 0.5 / clock.period
            gain = P @ h / variance
            x, P = x + gain * error, P - Matrix(k * (P @ h) for k in gain)
            errors.append(error)
            variances.append(variance)
        return Belief(tuple(x), P, Innovation(tuple(errors), tuple(variances)))

    def estimate(self, state):
        theta = (state.mean[4], *self.prior.theta[1:])
        return mg.Estimate(
            state.mean[:4], theta, self.prior.offset, self.model, state.covariance[4][4], state.innovation
        )

    def covariance(self, state):
        return jnp.stack([jnp.stack(row) for row in state.covariance])


def _diagonal(entries):
    return Matrix(row * entry for row, entry in zip(identity(len(entries)), entries, strict=True))


@pytest.fixture(scope="module")
def loop() -> mg.ClosedLoop:
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    prior = eqx.tree_at(lambda p: p.offset, mg.design_prior(gyro), readout.offset)
    noise = mg.ProcessNoise.of(gyro.model, rate=1.0)
    observer = RateFilter(prior, noise, readout.scale, readout.noise_density, gyro.model)
    return mg.ClosedLoop(gyro, readout, observer, mg.DampingCompensation(mg.Tone(600.0, 53.95)))


@pytest.mark.slow
def test_it_gets_nees_and_the_ratio_to_the_bound(loop):
    spread = mg.Spread((mg.Vary("start.1", mg.Normal(std=5e-8)),))
    summary = mg.sweep(loop, spread, 1.0, dies=32, sample_rate=100e3, duration=2e-3, bound_dies=2).summary
    assert summary.states == 5
    assert summary.nees == pytest.approx(5.0, abs=4.0 * np.sqrt(2.0 * 5.0 / 32))
    assert summary.nis == pytest.approx(2.0, abs=0.1)
    assert 0.5 < summary.ratio_to_bound < 3.0


def test_it_gets_tuning_in_two_stages_within_bounds_that_its_prior_tells(loop):
    tunables = resolved(loop, mg.free({"travel": (1e-6, 1e-3)}, observer=loop.observer.usually_tuned), 100e3, 0.1)
    assert [type(stage.loss).__name__ for stage in _stages(loop, tunables, None, 0.0)] == [
        "InnovationLikelihood",
        "SquaredRateError",
    ]
    prior_std, duration = 3.0, 0.1
    place = tunables.labels.index("observer.process_noise.rate")
    assert tunables.high[place] == pytest.approx((10.0 * prior_std) ** 2 / duration)


class Narrow(RateFilter):
    """One that forgets the row of the rate."""

    def covariance(self, state):
        return super().covariance(state)[:4, :4]


class Listed(RateFilter):
    """One that gives variances alone."""

    def covariance(self, state):
        return jnp.diagonal(super().covariance(state))


@pytest.mark.parametrize(("kind", "shape"), [(Narrow, r"\(4, 4\)"), (Listed, r"\(5,\)")])
def test_a_covariance_of_another_shape_is_refused_before_a_run(loop, kind, shape):
    observer = kind(**{field.name: getattr(loop.observer, field.name) for field in dataclasses.fields(loop.observer)})
    wrong, spread = eqx.tree_at(lambda made: made.observer, loop, observer), mg.Spread.relative(0.1)
    words = rf"covariance of {kind.__name__} must have the shape \(5, 5\).*x, y, vx, vy, rate, but has {shape}"
    for run in (
        lambda: mg.sweep(wrong, spread, 1.0, dies=2, sample_rate=100e3, duration=1e-3),
        lambda: mg.tune(wrong, free=mg.free(observer=wrong.observer.usually_tuned), sample_rate=1e5, duration=1e-3),
    ):
        with pytest.raises(mg.InputError, match=words):
            run()
