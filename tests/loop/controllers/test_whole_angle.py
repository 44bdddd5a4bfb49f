"""Whole-angle control against the formulas written out, and what a device does whose estimate is right."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import DUAL_MASS, SINGLE_MASS, Inertial
from memsgyro_jax.device.propagate import Exact, applied


MOTION = (0.8e-6, -0.4e-6, 0.011, 0.017)
K = (2 * np.pi * 3200.0) ** 2
SINGLE, DUAL = mg.SingleMassGyro.chi2010(), mg.DualMassGyro.chi2010()
OTHER = mg.SingleMassGyro.from_modes(1e-9, (10e3, 10.5e3), (4000.0, 6000.0), angle=0.6, cross_damping=0.3)


def force_of(controller, motion, theta, model, period, time=1.3e-3):
    estimate = mg.Estimate(motion, theta, (0.0, 0.0), model)
    return controller.command((), estimate, mg.Clock(time, 0, period))[0]


@pytest.mark.parametrize("kind", ["single", "dual"])
def test_force_is_6_1_and_6_2(kind):
    """At a vanishing period; y's damping multiplies its own velocity in (6.2)."""
    x, y, vx, vy = MOTION
    tone = 40.0 * np.sin(2 * np.pi * 500.0 * 1.3e-3)
    if kind == "single":
        model, theta = SINGLE_MASS, tuple(map(float, SINGLE.coefficients(1.5)))
        _, kxx, kyy, kxy, dxx, dyy, dxy, sx = theta
        kyx, sy = kxy, sx
    else:
        model, theta = DUAL_MASS, tuple(map(float, DUAL.coefficients(1.5)))
        _, _, kxx, kyy, kxy, kyx, dxx, dyy, sx, sy = theta
        dxy = 0.0
    want = [
        (dxx * vx + dxy * vy + kxx * x + kxy * y - K * x + tone) / sx,
        (dxy * vx + dyy * vy + kyx * x + kyy * y - K * y + tone) / sy,
    ]
    controller = mg.WholeAngle(3200.0, mg.Tone(500.0, 40.0))
    assert np.array(force_of(controller, MOTION, theta, model, 1e-13)) == pytest.approx(want, rel=1e-7)


COUNT = 4000


@eqx.filter_jit
def driven(gyro, controller, rate, period, start):
    """Motion under the controller with a perfect estimate, through the exact propagator."""
    dynamics, theta = gyro.dynamics(Inertial(rate)), gyro.coefficients(rate)
    step = Exact(16).transition(dynamics.stiffness, dynamics.velocity, period)
    full, push = jnp.array(step.full), jnp.array(step.push)

    def one(motion, index):
        force = force_of(controller, tuple(motion), theta, gyro.model, period, index * period)
        motion = full @ motion + push @ jnp.stack(applied(dynamics, force))
        return motion, motion

    return jax.lax.scan(one, start, jnp.arange(COUNT))[1]


@pytest.mark.slow
@pytest.mark.parametrize("amplitude", [0.0, 1.2024], ids=["still", "rocking"])
@pytest.mark.parametrize(("gyro", "frequency"), [(SINGLE, 3200.0), (OTHER, 10.3e3)], ids=["thesis", "10 kHz"])
def test_a_device_that_is_known_becomes_an_ideal_one(gyro, frequency, amplitude):
    """The frame turns beneath the vibration, whose amplitude stays; what a sample is too long for falls with its
    length. The ripple of a held force leaves an offset, of second order, at the samples.
    """
    drifts, start, rate = [], jnp.array([1e-6, 0.4e-6, 0.0, 0.0]), frequency / 1000.0
    controller = mg.WholeAngle(frequency, rocking=mg.Tone(frequency / 30.0, amplitude))
    for samples in (20, 40):  # per period
        period = 1.0 / (samples * frequency)
        time = np.arange(1, COUNT + 1) * period
        begin = 2 * start - jnp.array(controller.unrocked(tuple(start), 0.0))  # still, in the frame that rocks
        motion = controller.unrocked(
            tuple(driven(gyro, controller, jnp.asarray(rate), jnp.asarray(period), begin).T), time
        )
        ellipse = mg.vibration_ellipse(motion, frequency, rate)
        turned = np.degrees(np.unwrap(np.asarray(ellipse.angle), period=np.pi) + rate * time)
        whole = 30 * samples  # samples in a period of the rocking
        drifts.append(abs(np.mean(turned[-whole:]) - np.mean(turned[:whole])) / (COUNT - whole))
        assert np.max(np.abs(turned - np.degrees(np.arctan2(0.4, 1.0)))) < 0.5
        assert np.max(np.abs(ellipse.major / np.hypot(1e-6, 0.4e-6) - 1.0)) < 5e-3
    assert drifts[1] * COUNT < 1e-3
    assert drifts[1] < drifts[0] / 2.0


def test_rocking_by_nothing_is_none():
    theta = tuple(map(float, SINGLE.coefficients(0.0)))
    still = force_of(mg.WholeAngle(3200.0), MOTION, theta, SINGLE_MASS, 1e-5)
    silent = mg.WholeAngle(3200.0, rocking=mg.Tone(120.0, 0.0))
    assert np.array(force_of(silent, MOTION, theta, SINGLE_MASS, 1e-5)) == pytest.approx(np.array(still), rel=1e-13)
    slope = jax.grad(lambda a: force_of(mg.WholeAngle(3200.0, rocking=mg.Tone(120.0, a)), MOTION, theta, SINGLE_MASS,
                                        1e-5)[0])(0.0)  # fmt: skip
    assert np.isfinite(slope)
    assert slope != 0.0


def test_forces_have_one_value_per_die():
    theta = tuple(map(float, SINGLE.coefficients(0.0)))
    controller = mg.WholeAngle(3200.0, mg.Tone(500.0, 40.0), mg.Tone(120.0, 1.2024))
    one = np.array(force_of(controller, MOTION, theta, SINGLE_MASS, 1e-5))
    many = np.array(force_of(controller, tuple(jnp.full(3, m) for m in MOTION), theta, SINGLE_MASS, 1e-5))
    assert many.shape == (2, 3)
    assert many[:, 1] == pytest.approx(one, rel=1e-13)


@pytest.mark.parametrize("frequency", [0.0, -3e3, float("nan")])
def test_impossible_frequencies_are_refused(frequency):
    with pytest.raises(InputError, match="`frequency` must be positive and finite"):
        mg.WholeAngle(frequency)
