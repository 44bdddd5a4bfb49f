"""Each loss on a made-up trace: its value against plain NumPy, its slope against finite differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special

import memsgyro_jax as mg
from memsgyro_jax import losses
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import SINGLE_MASS
from memsgyro_jax.loop.loop import Sample
from memsgyro_jax.loop.observers.base import Clock, Innovation
from memsgyro_jax.loop.scenario import Conditions


COUNT, PERIOD, SETTLE, DIES = 300, 1e-3, 0.1, 7
RNG = np.random.default_rng(0)
TIME = PERIOD * np.arange(1, COUNT + 1)
TRUE, SLOPE = np.sin(20.0 * TIME), 20.0 * np.cos(20.0 * TIME)
RATE = np.sin(20.0 * (TIME[:, None] - 4e-3)) + 0.3 * np.exp(-TIME[:, None] / 0.05) * (1.0 + np.arange(DIES))
ERRORS = RNG.normal(size=(2, COUNT, DIES)) * 1e-3
CLAIMED = np.array([1.1e-6, 0.7e-6])[:, None, None] * np.ones((2, COUNT, DIES))
LATE = TIME >= SETTLE


class Absolute(losses.AbstractMean):
    """A loss of a user's own, outside the package."""

    def of(self, sample):
        return jnp.sqrt(losses.rate_error(sample) ** 2 + 0.01)


@eqx.filter_jit
def values(loss, factor):
    """The loss of each die where the rate is `factor` times that of the trace, and claimed deviations as well."""

    def one(memory, row):
        time, true, slope, rate, errors, claimed = row
        innovation = Innovation(tuple(errors), tuple(claimed * factor**2))
        estimate = mg.Estimate((0.0,) * 4, (rate,) * 8, (0.0, 0.0), SINGLE_MASS, claimed[0] * factor**2, innovation)
        conditions = Conditions(true, slope)
        clock = Clock(time, 0, PERIOD)
        sample = Sample(clock, conditions, (0.0,) * 4, (0.0, 0.0), (0.0, 0.0), estimate, factor * rate)
        return loss.sample(memory, sample), None

    rows = tuple(map(jnp.asarray, (TIME, TRUE, SLOPE, RATE, np.moveaxis(ERRORS, 0, 1), np.moveaxis(CLAIMED, 0, 1))))
    begin = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (DIES,)), loss.init())
    return loss.value(jax.lax.scan(one, begin, rows)[0])


def likelihood(factor):
    variance = CLAIMED[:, LATE] * factor**2
    return np.mean(0.5 * np.sum(np.log(variance) + ERRORS[:, LATE] ** 2 / variance, axis=0), axis=0)


def consistency(factor):
    ratios = np.mean(ERRORS[:, LATE] ** 2 / (CLAIMED[:, LATE] * factor**2), axis=1)
    return np.sum(np.log(ratios) ** 2, axis=0)


def squares(factor):
    return np.mean((factor * RATE[LATE] - TRUE[LATE, None]) ** 2, axis=0)


def outside(factor):
    size = np.sqrt((factor * RATE - TRUE[:, None]) ** 2 + (1e-3 * 0.2) ** 2)
    return np.sum(PERIOD / (1.0 + np.exp(-(size / 0.2 - 1.0) / 0.1)), axis=0)


def delay(factor):
    slope = SLOPE[LATE, None]
    found = -np.sum((factor * RATE[LATE] - TRUE[LATE, None]) * slope, axis=0) / np.sum(slope**2)
    return np.maximum(found / 2e-3 - 1.0, 0.0) ** 2


def missed(factor):
    size = np.sqrt((factor * RATE[-1] - TRUE[-1]) ** 2 + (1e-3 * 0.02) ** 2)
    return 1.0 / (1.0 + np.exp(-(size / 0.02 - 1.0) / 0.2))


SQUARED = losses.SquaredRateError(SETTLE)
CASES = {
    "squared error": (SQUARED, squares),
    "likelihood": (losses.InnovationLikelihood(SETTLE), likelihood),
    "consistency": (losses.Consistency(SETTLE), consistency),
    "convergence": (losses.ConvergenceTime(0.2), outside),
    "out of tolerance": (losses.OutOfTolerance(0.02), missed),
    "expected misses": (losses.ExpectedMisses(2e-3), lambda f: special.erfc(2e-3 / np.sqrt(2 * CLAIMED[0, -1] * f**2))),
    "delay": (losses.Delay(2e-3, SETTLE), delay),
    "claimed variance": (losses.ClaimedVariance(SETTLE), lambda f: np.mean(np.log(CLAIMED[0, LATE] * f**2), axis=0)),
    "weighted": (
        losses.Weighted((SQUARED, 2.0), (losses.Consistency(SETTLE), 0.1)),
        lambda f: 2.0 * squares(f) + 0.1 * consistency(f),
    ),
    "own": (Absolute(SETTLE), lambda f: np.mean(np.sqrt((f * RATE[LATE] - TRUE[LATE, None]) ** 2 + 0.01), axis=0)),
}


@pytest.mark.parametrize("name", CASES)
def test_values_and_slopes(name):
    loss, plain = CASES[name]
    assert np.asarray(values(loss, 1.03)) == pytest.approx(plain(1.03), rel=1e-10)
    slope = jax.jvp(lambda f: values(loss, f), (jnp.asarray(1.03),), (jnp.ones(()),))[1]
    step = 1e-4
    parts = [plain(1.03 + k * step) for k in (-2, -1, 1, 2)]
    difference = (parts[0] - 8 * parts[1] + 8 * parts[2] - parts[3]) / (12 * step)
    assert np.asarray(slope) == pytest.approx(difference, rel=1e-6)
    assert np.all(np.asarray(slope) != 0.0)


def test_a_rate_that_does_not_vary_has_no_delay():
    loss = losses.Delay(1e-3)
    assert float(loss.value((jnp.zeros(()), jnp.zeros(())))) == 0.0


def test_the_worst_dies_are_the_mean_of_the_tail_when_hardly_softened():
    tail = RNG.gamma(1.0, size=200)
    loss = losses.WorstDies(SQUARED, 0.1, 1e-4)
    assert float(loss.combine(jnp.asarray(tail))) == pytest.approx(np.mean(np.sort(tail)[-20:]), rel=1e-3)
    assert float(loss.combine(jnp.full(5, 3.0))) == pytest.approx(3.0)


def test_the_slope_of_the_worst_dies_is_that_of_finite_differences():
    tail = RNG.gamma(1.0, size=50)
    combine = jax.jit(lambda values: losses.WorstDies(SQUARED, 0.2).combine(values))
    slopes = np.asarray(jax.jit(jax.grad(combine))(jnp.asarray(tail)))
    for i in (int(np.argmin(tail)), int(np.argsort(tail)[-10]), int(np.argmax(tail))):
        unit = np.eye(50)[i] * 1e-3
        parts = [float(combine(jnp.asarray(tail + k * unit))) for k in (-2, -1, 1, 2)]
        difference = (parts[0] - 8 * parts[1] + 8 * parts[2] - parts[3]) / 12e-3
        assert slopes[i] == pytest.approx(difference, rel=1e-6, abs=1e-9)


def test_which_losses_need_the_truth():
    assert not losses.Weighted((losses.InnovationLikelihood(), 1.0), (losses.Consistency(), 1.0)).sees_truth
    assert losses.Weighted((losses.InnovationLikelihood(), 1.0), (SQUARED, 1.0)).sees_truth
    assert losses.WorstDies(SQUARED).begins() == SETTLE


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: losses.WorstDies(SQUARED, 1.5), "Argument `share` must lie between 0 and 1"),
        (lambda: losses.Weighted((losses.WorstDies(SQUARED), 1.0)), "wrap the sum in it"),
        (lambda: losses.Weighted(), "at least one"),
        (lambda: losses.Delay(0.0), "Argument `allowed` must be positive"),
        (lambda: losses.ConvergenceTime(-1.0), "Argument `tolerance` must be positive"),
        (lambda: SQUARED.__class__(-1.0), "Argument `settle` must be finite and not negative"),
    ],
)
def test_losses_that_cannot_be(make, message):
    with pytest.raises(InputError, match=message):
        make()
