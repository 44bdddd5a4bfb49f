"""Derivatives through a closed loop agree in reverse mode, forward mode and by finite differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from memsgyro_jax.device.gyro import SingleMassGyro
from memsgyro_jax.device.propagate import Exact
from memsgyro_jax.loop import noise
from memsgyro_jax.loop.controllers import DampingCompensation, ReferenceModel, Tone
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.observers import Clock, ExtendedKalmanFilter, LyapunovObserver
from memsgyro_jax.loop.readout import Adc, ChargeAmplifier, DirectReadout
from memsgyro_jax.loop.scenario import as_scenario


DESIGN, CIRCUIT = SingleMassGyro.chi2010(), ChargeAmplifier.chi2010()


@pytest.fixture(scope="module")
def small():
    """A cheap loop of the other kind: Lyapunov observer, reference model, a converter with fine steps."""
    readout = DirectReadout.of_velocity((5.0, 6.0), 1e-6)
    observer = LyapunovObserver.for_device(DESIGN, readout, start=0.9, gain=20.0)
    return ClosedLoop(DESIGN, readout, observer, ReferenceModel((3e3, 5e3), Tone(600.0, 5.0)), discretisation=Exact(12))


def _squares(truth, estimate):
    return sum(((a - b) / s) ** 2 for a, b, s in zip(truth, estimate, (1e-8, 1e-8, 1e-4, 1e-4), strict=True))


def end_error(loop, rate=200e3, count=300):
    """Squared error of rate and motion at the end of a run, in units of 1 rad/s, 10 nm and 10 nm·10⁴/s."""
    words = noise.die_words(jax.random.key(1), jnp.asarray(3))

    def sample(state, i):
        clock = Clock(i / rate, i, 1.0 / rate)
        return loop.step(state, as_scenario(1.0).at(clock.time), noise.normal_pair(words, i, 0), clock)[0], None

    state, _ = jax.lax.scan(sample, loop.init(), jnp.arange(count))
    estimate = loop.observer.estimate(state.observer)
    motion_error = sum(
        ((a - b) / s) ** 2 for a, b, s in zip(state.motion, estimate.motion, (1e-8, 1e-8, 1e-4, 1e-4), strict=True)
    )
    return (estimate.rate - 1.0) ** 2 + motion_error


def directions(loop):
    """A relative change of one part of the loop at a time: device, read-out, observer, controller."""
    arrays, _ = eqx.partition(loop, eqx.is_inexact_array)
    made = {}
    for part in ("device", "readout", "observer", "controller"):
        rng = np.random.default_rng(0)  # anew for each part: one more leaf in one must not change the others
        zero = jax.tree.map(jnp.zeros_like, arrays)
        changed = jax.tree.map(lambda leaf, rng=rng: leaf * rng.uniform(0.5, 1.5), getattr(arrays, part))
        made[part] = eqx.tree_at(lambda tree, part=part: getattr(tree, part), zero, changed)
    return made


def assert_gradients_agree(loop, count, epsilon, tolerance, reverse=True):
    """Reverse mode, forward mode and a fourth-order finite difference agree along each direction."""
    arrays, static = eqx.partition(loop, eqx.is_inexact_array)
    value = lambda a: end_error(eqx.combine(a, static), count=count)  # noqa: E731
    gradient = jax.jit(jax.grad(value))(arrays) if reverse else None
    forward = jax.jit(lambda a, t: jax.jvp(value, (a,), (t,)))  # one program for values and slopes
    for part, tangent in directions(loop).items():
        along = float(forward(arrays, tangent)[1])
        near = [jax.tree.map(lambda a, t, s=s: a + s * epsilon * t, arrays, tangent) for s in (-2, -1, 1, 2)]
        values = [float(forward(at, tangent)[0]) for at in near]
        difference = (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * epsilon)
        assert along == pytest.approx(difference, rel=tolerance), part
        assert along != 0.0, part
        if reverse:
            pairs = zip(*map(jax.tree.leaves, (gradient, tangent)), strict=True)
            assert float(sum(jnp.vdot(g, t) for g, t in pairs)) == pytest.approx(along, rel=1e-9), part


@pytest.mark.slow
def test_gradients_of_the_lyapunov_loop(small):
    assert_gradients_agree(small, 300, 1e-5, 1e-6)


def test_derivatives_of_the_kalman_loop():
    """Forward mode only: with the flags of `runtime.configure`, reverse mode takes minutes to compile."""
    observer = ExtendedKalmanFilter.for_device(DESIGN, CIRCUIT, discretisation=Exact(8))
    controller = DampingCompensation(Tone(600.0, 53.95))
    loop = ClosedLoop(DESIGN, CIRCUIT, observer, controller, discretisation=Exact(8))
    assert_gradients_agree(loop, 200, 1e-4, 1e-6, reverse=False)


@pytest.mark.slow
def test_gradients_pass_through_a_converter(small):
    """Rounding has no useful derivative; the straight line's is used, and tends to the loop without a converter."""
    converted = eqx.tree_at(lambda tree: tree.readout.adc, small, Adc(1.0, 36), is_leaf=lambda leaf: leaf is None)

    def slopes(loop):
        arrays, static = eqx.partition(loop, eqx.is_inexact_array)
        value = lambda a: end_error(eqx.combine(a, static), count=100)  # noqa: E731
        along = jax.jit(lambda tangent: jax.jvp(value, (arrays,), (tangent,))[1])
        return [float(along(tangent)) for tangent in directions(loop).values()]

    assert slopes(converted) == pytest.approx(slopes(small), rel=1e-4)
