"""Forces against the thesis' formulas written out, and what they do to a device whose estimate is right."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import motion

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import DUAL_MASS, SINGLE_MASS, DualMassGyro, Inertial, SingleMassGyro
from memsgyro_jax.device.propagate import Exact, applied
from memsgyro_jax.loop.controllers import (
    Ahead,
    DampingCompensation,
    EnergyControl,
    OpenLoop,
    ReferenceModel,
    Saturated,
    Tone,
)
from memsgyro_jax.loop.observers import Clock, Estimate


MOTION = (0.8e-6, -0.4e-6, 0.011, 0.017)
SINGLE = tuple(map(float, SingleMassGyro.chi2010().coefficients(1.5)))
DUAL = tuple(map(float, DualMassGyro.chi2010().coefficients(1.5)))
ESTIMATES = {
    "single": Estimate(MOTION, SINGLE, (0.0, 0.0), SINGLE_MASS),
    "dual": Estimate(MOTION, DUAL, (0.0, 0.0), DUAL_MASS),
}
CLOCK = Clock(1.3e-3, 130, 1e-5)


def force_of(controller, estimate, clock=CLOCK):
    force, state = controller.command(controller.init(), estimate, clock)
    assert state == controller.init()
    return np.array(force, float)


def sine(amplitude, frequency, phase, time):
    return amplitude * np.sin(2 * np.pi * frequency * time + phase)


def test_tones():
    tone = Tone(600.0, 53.95, 0.4)
    assert float(tone.value(1.3e-3)) == pytest.approx(sine(53.95, 600.0, 0.4, 1.3e-3), rel=1e-13)


@pytest.mark.parametrize(
    ("tones", "x", "y"),
    [
        (((), ()), 0.0, 0.0),
        (Tone(600.0, 2.0), sine(2, 600, 0, 1.3e-3), sine(2, 600, 0, 1.3e-3)),
        ((Tone(600.0, 2.0), ()), sine(2, 600, 0, 1.3e-3), 0.0),
        ((Tone(600.0, 2.0), (Tone(50.0, 1.0), Tone(70.0, 3.0, 0.1))), sine(2, 600, 0, 1.3e-3),
         sine(1, 50, 0, 1.3e-3) + sine(3, 70, 0.1, 1.3e-3)),
    ],
    ids=["none", "one for both", "x alone", "two on y"],
)  # fmt: skip
def test_damping_compensation_of_one_mass_is_4_27(tones, x, y):
    _, _, _, _, dxx, dyy, dxy, sigma = SINGLE
    vx, vy = MOTION[2:]
    want = np.array([dxx * vx + dxy * vy + x, dxy * vx + dyy * vy + y]) / sigma
    assert force_of(DampingCompensation(tones), ESTIMATES["single"]) == pytest.approx(want, rel=1e-13)


def test_damping_compensation_of_two_masses_is_4_28():
    dxx, dyy, sigma_x, sigma_y = DUAL[6:]
    tone = sine(53.95, 600.0, 0.0, 1.3e-3)
    want = [(dxx * MOTION[2] + tone) / sigma_x, (dyy * MOTION[3] + tone) / sigma_y]
    assert force_of(DampingCompensation(Tone(600.0, 53.95)), ESTIMATES["dual"]) == pytest.approx(want, rel=1e-13)


def reference_force(kind, motion_now, tone):
    """(4.17) and (4.18), y's velocity multiplying d_yy, at the given motion."""
    x, y, vx, vy = motion_now
    kax, kay = (2 * np.pi * 3000.0) ** 2, (2 * np.pi * 5000.0) ** 2
    if kind == "single":
        w, kxx, kyy, kxy, dxx, dyy, dxy, sx = SINGLE
        kyx, dyx, wx, sy = kxy, dxy, w, sx
    else:
        wx, w, kxx, kyy, kxy, kyx, dxx, dyy, sx, sy = DUAL
        dxy = dyx = 0.0
    return np.array(
        [
            (dxx * vx + dxy * vy + kxx * x + kxy * y - kax * x - 2 * wx * vy + tone) / sx,
            (dyx * vx + dyy * vy + kyx * x + kyy * y - kay * y + 2 * w * vx + tone) / sy,
        ]
    )


@pytest.mark.parametrize("kind", ["single", "dual"])
def test_reference_model_is_4_17_and_4_18_half_a_sample_ahead(kind):
    """Half a sample ahead along the reference oscillators, found here by the exponential."""
    ahead, _ = motion.held(
        np.array(
            [[0, 0, 1, 0], [0, 0, 0, 1], [-((2 * np.pi * 3e3) ** 2), 0, 0, 0], [0, -((2 * np.pi * 5e3) ** 2), 0, 0]]
        ),
        np.zeros((4, 1)),
        0.5e-5,
    )
    tone = sine(2.0, 600.0, 0.0, 1.3e-3 + 0.5e-5)
    want = reference_force(kind, ahead @ MOTION, tone)
    controller = ReferenceModel((3000.0, 5000.0), Tone(600.0, 2.0))
    assert force_of(controller, ESTIMATES[kind]) == pytest.approx(want, rel=1e-10)
    at_once = force_of(controller, ESTIMATES[kind], Clock(1.3e-3, 0, 1e-12))
    assert at_once == pytest.approx(reference_force(kind, MOTION, sine(2.0, 600.0, 0.0, 1.3e-3)), rel=1e-5)


def driven(gyro, controller, rate, count, sample_rate):
    """Motion under the controller with a perfect estimate, through the exact propagator."""
    state, path, exact = np.array([1e-6, 0.5e-6, 0.0, 0.0]), [], Exact.covering(5500.0, sample_rate)
    dynamics, theta = gyro.dynamics(Inertial(rate)), gyro.coefficients(rate)
    step = exact.transition(dynamics.stiffness, dynamics.velocity, 1 / sample_rate)
    full, push = np.array(step.full), np.array(step.push)

    @jax.jit
    def commanded(motion, index):
        estimate = Estimate(motion, theta, (0.0, 0.0), gyro.model)
        return controller.command(controller.init(), estimate, Clock(index / sample_rate, index, 1 / sample_rate))[0]

    for i in range(count):
        force = np.array(commanded(tuple(state), i))
        state = full @ state + push @ np.array(applied(dynamics, force), float)
        path.append(state)
    return np.array(path)


@pytest.mark.parametrize("gyro", [SingleMassGyro.chi2010(), DualMassGyro.chi2010()], ids=["single", "dual"])
def test_reference_model_makes_oscillators_of_its_frequencies(gyro):
    """After 0.6 ms at 200 kHz, true motion is that of two undamped, uncoupled oscillators."""
    path = driven(gyro, ReferenceModel((3000.0, 5000.0)), 1.0, 120, 200e3)
    t = np.arange(1, 121) / 200e3
    want = np.stack([1e-6 * np.cos(2 * np.pi * 3000 * t), 0.5e-6 * np.cos(2 * np.pi * 5000 * t)], axis=1)
    assert np.max(np.abs(path[:, :2] - want)) < 0.02e-6


def test_damping_compensation_removes_the_decay():
    """The free device loses ω/Q·t of its energy; compensated it keeps all but the sample-and-hold's remainder."""
    gyro = SingleMassGyro.chi2010()

    def energy(path):
        k = np.array(gyro.dynamics(Inertial()).stiffness)
        return np.sum(path[:, 2:] ** 2, axis=1) + np.einsum("ti,ij,tj->t", path[:, :2], k, path[:, :2])

    free = energy(driven(gyro, OpenLoop(), 0.0, 300, 100e3))
    kept = energy(driven(gyro, DampingCompensation(), 0.0, 300, 100e3))
    assert free[-1] / free[0] == pytest.approx(np.exp(-22.0 * 299e-5), rel=0.01)
    # A force held over a sample is half a sample old: cos(ωh/2) of it does work, 1 % is left of the damping.
    assert abs(np.log(kept[-1] / kept[0])) < 0.02 * abs(np.log(free[-1] / free[0]))


def test_looking_ahead_leaves_nothing_of_the_decay():
    """At 50 kHz holding leaves 3.5 % of the damping that it cancels; fed back for the middle of the sample, 1e-4."""
    gyro = SingleMassGyro.chi2010()
    left = []
    for law in (DampingCompensation(), Ahead(DampingCompensation())):
        path = driven(gyro, law, 0.0, 300, 50e3)
        k = np.array(gyro.dynamics(Inertial()).stiffness)
        energy = np.sum(path[:, 2:] ** 2, axis=1) + np.einsum("ti,ij,tj->t", path[:, :2], k, path[:, :2])
        left.append(np.log(energy[-1] / energy[0]) / (-22.0 * 299 / 50e3))
    assert 0.02 < left[0] < 0.05
    assert abs(left[1]) < 1e-3


def test_a_force_ends_at_its_limit_and_the_trace_says_so():
    law, estimate = ReferenceModel((3000.0, 5000.0)), ESTIMATES["single"]
    free = force_of(law, estimate)
    cut = Saturated(law, (0.5 * abs(free[0]), 2.0 * abs(free[1])))
    assert force_of(cut, estimate) == pytest.approx([0.5 * free[0], free[1]], rel=1e-15)
    assert cut.reached(np.array([free, 0.4 * free])) == 0.5
    for limit in ((1e-6,), (1e-6, 0.0)):
        with pytest.raises(InputError, match="`limit` must be"):
            Saturated(law, limit)


@pytest.mark.parametrize(("start", "gain"), [(0.2, 1500.0), (2.0, 800.0)])
def test_energy_grows_to_its_level_as_a_logistic(start, gain):
    """Averaged over a period dE/dt = gain (1 - E/E0) E; the reference model leaves nothing else that works."""
    reference = ReferenceModel((3000.0, 5000.0))
    level = np.array([1e-6, 0.5e-6]) / start
    omega = 2 * np.pi * np.array([3000.0, 5000.0])
    controller = EnergyControl(reference, (3000.0, 5000.0), tuple(level), gain)
    path = driven(SingleMassGyro.chi2010(), controller, 1.0, 800, 200e3)
    energy = 0.5 * np.sum(path[:, 2:] ** 2 + (omega * path[:, :2]) ** 2, axis=1)
    wanted = 0.5 * np.sum((omega * level) ** 2)
    time = np.arange(1, 801) / 200e3
    expected = wanted / (1 + (1 / start**2 - 1) * np.exp(-gain * time))
    ripple = gain * abs(start**2 - 1.0) / (2.0 * omega[0])  # within a period
    assert np.max(np.abs(energy / expected - 1.0)) < 1.1 * ripple
    assert energy[-1] / expected[-1] == pytest.approx(1.0, abs=0.02)
    assert abs(energy[-1] / wanted - 1.0) < 0.7 * abs(start**2 - 1.0)


def test_energy_control_is_4_25_and_without_gain_nothing():
    inner, estimate = DampingCompensation(Tone(600.0, 2.0)), ESTIMATES["single"]
    controller = EnergyControl(inner, (3000.0, 5000.0), (1e-6, 0.0), 9e3)
    x, y, vx, vy = MOTION
    energy = 0.5 * (vx**2 + vy**2 + (6e3 * np.pi * x) ** 2 + (1e4 * np.pi * y) ** 2)
    push = 9e3 * (1 - energy / (0.5 * (6e3 * np.pi * 1e-6) ** 2)) * np.array([vx, vy]) / SINGLE[-1]
    assert force_of(controller, estimate) - force_of(inner, estimate) == pytest.approx(push, rel=1e-9)
    silent = EnergyControl(inner, (3000.0, 5000.0), (1e-6, 0.0), 0.0)
    assert np.array_equal(force_of(silent, estimate), force_of(inner, estimate))
    with pytest.raises(InputError, match="sum of `amplitude`"):
        EnergyControl(inner, (3000.0, 5000.0), (0.0, 0.0), 9e3)
    with pytest.raises(InputError, match="`amplitude` must be a pair"):
        EnergyControl(inner, (3000.0, 5000.0), (1e-6,), 9e3)


def test_open_loop_holds_its_tones_at_the_middle_of_a_sample():
    controller = OpenLoop((Tone(600.0, 1e-6), ()))
    want = [sine(1e-6, 600.0, 0.0, 1.3e-3 + 0.5e-5), 0.0]
    assert force_of(controller, ESTIMATES["single"]) == pytest.approx(want, rel=1e-13)
    elsewhere = Estimate((1.0, 2.0, 3.0, 4.0), SINGLE, (0.0, 0.0), SINGLE_MASS)
    assert np.array_equal(force_of(controller, elsewhere), force_of(controller, ESTIMATES["single"]))


def test_forces_have_one_value_per_die():
    many = Estimate(tuple(jnp.full(3, m) for m in MOTION), SINGLE, (0.0, 0.0), SINGLE_MASS)
    tone = Tone(600.0, 2.0)
    reference = ReferenceModel((3e3, 5e3), tone)
    energy = EnergyControl(reference, (3e3, 5e3), (1e-6, 1e-6), 9e3)
    for controller in (OpenLoop(tone), DampingCompensation(tone), reference, energy):
        force = force_of(controller, many)
        assert force.shape == (2, 3)
        assert force[:, 0] == pytest.approx(force_of(controller, ESTIMATES["single"]), rel=1e-14)


@pytest.mark.parametrize("frequency", [(0.0, 5e3), (3e3, -5e3), (float("nan"), 1.0)])
def test_impossible_reference_frequencies_are_refused(frequency):
    with pytest.raises(InputError, match="`frequency` must be positive and finite"):
        ReferenceModel(frequency)


@pytest.mark.parametrize("count", [1, 3])
def test_what_is_no_pair_of_axes_is_refused(count):
    with pytest.raises(InputError, match=f"`tones` must be one tone for both axes or a pair .*{count} entries"):
        OpenLoop((Tone(600.0, 1e-6),) * count)
    with pytest.raises(InputError, match=f"`frequency` must be a pair .*{count} entries"):
        ReferenceModel((3e3,) * count)
