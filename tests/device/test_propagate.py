"""One sample is the matrix exponential, forward Euler is of first order, and derivatives converge with the nodes."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import motion
from oracles.kalman import SINGLE, influence
from scipy.integrate import solve_ivp

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import DualMassGyro, Dynamics, Inertial, SingleMassGyro, mode_frequencies
from memsgyro_jax.device.propagate import Exact, ForwardEuler, applied, fence, once


START = (1e-6, 0.3e-6, 2e-3, -4e-3)
ATTOMETRE = 1e-15  # m: the 1e-9 µm of the requirement
SINGLE_NUMBERS = {"m": 1.8e-7, "kxx": 63.96, "kyy": 95.92, "kxy": 12.78, "dxx": 3.6e-6, "dyy": 4.5e-6, "dxy": 3.6e-7}
DUAL_NUMBERS = {
    "mx": 2.6e-7, "my": 1.6e-7, "kxx": 92.38, "kyy": 85.26, "kxy": 0.92, "kyx": 0.25, "dxx": 5.2e-6, "dyy": 4.8e-6
}  # fmt: skip
TURNING = motion.Frame(30.0, -20.0, 50.0, 4000.0, 3.0, -2.0, (0.5, 0.4, 4.0))


def single(numbers, full=False, dyx=None):
    return SingleMassGyro(*numbers.values(), dyx=dyx, rotating_frame=full)


def inertial(frame):
    return Inertial(frame.wz, frame.spin, (frame.wx, frame.wy), (frame.ax, frame.ay), frame.damping)


@jax.jit
def follow(discretisation, dynamics, start, forces, period):
    """Motion after each sample under held forces."""

    def step(state, force):
        state = discretisation.advance(
            state, applied(dynamics, (force[0], force[1])), dynamics.stiffness, dynamics.velocity, period
        )
        return state, jnp.stack(state)

    return jax.lax.scan(step, tuple(map(jnp.asarray, start)), forces)[1]


def forces_of(rate, duration=20e-3):
    time = (np.arange(round(duration * rate)) + 0.5) / rate
    return 9.7e-6 * np.stack([np.sin(2 * np.pi * 600 * time), np.cos(2 * np.pi * 3100 * time)], axis=1)


def exact_numbers(numbers):
    return {name: mpmath.mpf(value) for name, value in numbers.items()}


CASES = {
    "uncoupled": (SingleMassGyro, SINGLE_NUMBERS | {"kxy": 0.0, "dxy": 0.0}, motion.Frame(), False),
    "coupled and damped": (SingleMassGyro, SINGLE_NUMBERS, motion.Frame(), False),
    "turning": (SingleMassGyro, SINGLE_NUMBERS, motion.Frame(wz=1.0), False),
    "turning, all terms": (SingleMassGyro, SINGLE_NUMBERS, TURNING, True),
    "dual mass": (DualMassGyro, DUAL_NUMBERS, motion.Frame(wz=-2.0, damping=(0.5, 0.4, 0.0)), False),
    "dual mass, all terms": (DualMassGyro, DUAL_NUMBERS, TURNING, True),
}


@pytest.mark.parametrize("rate", [20e3, 50e3, 100e3, 200e3])
@pytest.mark.parametrize("name", CASES)
def test_follows_the_exact_solution_for_twenty_milliseconds(name, rate):
    kind, numbers, frame, full = CASES[name]
    gyro = kind(*numbers.values(), rotating_frame=full)
    exact = Exact.covering(float(np.max(mode_frequencies(gyro))), rate)
    forces = forces_of(rate)
    got = np.asarray(follow(exact, gyro.dynamics(inertial(frame)), START, forces, 1.0 / rate))
    with mpmath.workdps(40):
        make = motion.single_mass if kind is SingleMassGyro else motion.dual_mass
        fields = {k: mpmath.mpf(v) if isinstance(v, float) else v for k, v in vars(frame).items()}
        system = make(**exact_numbers(numbers), frame=motion.Frame(**fields), full=full)
        want = motion.trajectory(system, list(map(mpmath.mpf, START)), forces, mpmath.mpf(1.0 / rate)).astype(float)
    assert np.max(np.abs(got - want)[:, :2]) < ATTOMETRE
    assert np.max(np.abs(got - want)[:, 2:]) < ATTOMETRE * 2 * np.pi * 4e3


def slowly_turning(time):
    """A rate with ramp and oscillation, in rad/s."""
    return 0.5 + 10.0 * time + 0.3 * np.sin(2 * np.pi * 5.0 * time)


def integrated(rate, rates, duration, forces):
    """Reference motion with a continuous rate under held forces, by a Runge-Kutta formula of order 8."""
    states, state, h = [], np.array(START) * 1e6, 1.0 / rate
    for n in range(round(duration * rate)):

        def derivative(time, s, force=forces[n]):
            a, b, _ = motion.single_mass(*SINGLE_NUMBERS.values(), frame=motion.Frame(wz=rates(time)))
            return a @ s + b @ force * 1e6

        done = solve_ivp(derivative, (n * h, (n + 1) * h), state, method="DOP853", rtol=3e-14, atol=1e-15)
        state = done.y[:, -1]
        states.append(state * 1e-6)
    return np.array(states)


@jax.jit
def follow_turning(discretisation, gyro, start, forces, rates, period):
    """The loop's own treatment: the rate in the middle of a sample holds for the sample."""

    def step(state, row):
        force, rate = row
        dynamics = gyro.dynamics(Inertial(rate))
        push = applied(dynamics, (force[0], force[1]))
        state = discretisation.advance(state, push, dynamics.stiffness, dynamics.velocity, period)
        return state, jnp.stack(state)

    return jax.lax.scan(step, tuple(map(jnp.asarray, start)), (forces, rates))[1]


def turning_error(rate, rates, duration):
    forces, middles = forces_of(rate, duration), (np.arange(round(duration * rate)) + 0.5) / rate
    exact = Exact.covering(3800.0, rate)
    got = np.asarray(follow_turning(exact, single(SINGLE_NUMBERS), START, forces, rates(middles), 1.0 / rate))
    return np.max(np.abs(got - integrated(rate, rates, duration, forces))[:, :2])


def test_follows_a_varying_rate():
    assert turning_error(100e3, slowly_turning, 4e-3) < ATTOMETRE


@pytest.mark.slow
@pytest.mark.parametrize("rate", [100e3, 200e3])
def test_follows_a_varying_rate_for_twenty_milliseconds(rate):
    assert turning_error(rate, slowly_turning, 20e-3) < ATTOMETRE


@pytest.mark.slow
def test_holding_a_fast_rate_over_a_sample_is_of_second_order():
    def rates(time):
        return 3.0 * np.sin(2 * np.pi * 500.0 * time)

    errors = [turning_error(rate, rates, 4e-3) for rate in (25e3, 50e3, 100e3)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.2)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.2)


@pytest.mark.parametrize("rate", [8e3, 20e3, 50e3, 100e3, 200e3, 1e6, 10e6])
def test_covering_leaves_rounding_errors(rate):
    """One sample against 40 digits, each entry in units of what it stands for (1 m beside 1/ω s)."""
    exact = Exact.covering(3760.0, rate)
    dynamics = single(SINGLE_NUMBERS).dynamics(Inertial(rate=1.0))
    step = exact.transition(dynamics.stiffness, dynamics.velocity, 1.0 / rate)
    with mpmath.workdps(40):
        frame = motion.Frame(wz=mpmath.mpf(1))
        a, _, _ = motion.single_mass(**exact_numbers(SINGLE_NUMBERS), frame=frame)
        push = np.array([[mpmath.mpf(0)] * 2] * 2 + [[mpmath.mpf(1), mpmath.mpf(0)], [mpmath.mpf(0), mpmath.mpf(1)]])
        want = [part.astype(float) for part in motion.held(a, push, mpmath.mpf(1.0 / rate), 80)]
    unit = np.array([1.0, 1.0, 2e4, 2e4])
    assert np.max(np.abs(np.array(step.full) - want[0]) / unit[:, None] * unit) < 2e-14
    scale = np.array([1 / rate, 1 / rate, 1.0, 1.0]) / rate
    assert np.max(np.abs(np.array(step.push) - want[1]) / scale[:, None]) < 2e-14
    moved = exact.advance(START, (0.3, -0.7), dynamics.stiffness, dynamics.velocity, 1.0 / rate)
    expected = want[0] @ START + want[1] @ (0.3, -0.7)
    assert np.max(np.abs(np.array(moved) - expected) / (unit * 1e-6)) < 2e-14


@given(st.floats(100.0, 20e3), st.floats(2.01, 1000.0))
def test_covering_takes_the_shortest_series(frequency, ratio):
    """The remainder of the chosen order is below 1e-17, that of one order less above it (or the order is the least)."""
    exact = Exact.covering(frequency, ratio * frequency)
    phase = 2 * np.pi / ratio
    remainder = [phase ** (n + 1) / float(mpmath.factorial(n + 1)) for n in (exact.order, exact.order - 1)]
    assert remainder[0] <= 1e-17
    assert remainder[1] > 1e-17 or exact.order == 4


@pytest.mark.parametrize("rate", [7e3, 1e3])
def test_under_sampling_is_refused(rate):
    with pytest.raises(InputError, match=f"`sample_rate` must exceed twice .* 3760 Hz, but {rate:g} Hz .* 9400 Hz"):
        Exact.covering(3760.0, rate)


def relative_jacobian_error(nodes, rate):
    """Error of the coefficient columns by the nodes' rule, against the exact derivative in 40 digits, per column."""
    start = (1e-6, 0.8e-6, 1.5e-2, -1.2e-2)  # no signal near a zero, beside which every error would look large
    exact, theta = Exact(26, nodes), [1.0, *(float(c) for c in single(SINGLE_NUMBERS).coefficients(1.0)[1:])]
    force, h = (2e-5, -1e-5), 1.0 / rate
    dynamics = SingleMassGyro.model.assemble(tuple(theta))
    step = exact.transition(dynamics.stiffness, dynamics.velocity, h)
    columns = np.zeros((4, 8))
    for node in step.nodes:
        inside = np.array(node.reach) @ start + np.array(node.push) @ (np.array(dynamics.gain) * force)
        columns += np.array(node.kick) @ influence(SINGLE, [*inside, *force])
    unit = np.array([1.0, 1.0, 2e4, 2e4])
    errors = []
    with mpmath.workdps(40):
        for i in range(8):
            derivative = mpmath.mpf(0)
            for sign in (-1, 1):
                moved = list(map(mpmath.mpf, theta))
                delta = mpmath.mpf(10) ** -12 * (1 + abs(moved[i]))
                moved[i] += sign * delta
                omega, kxx, kyy, kxy, dxx, dyy, dxy, sigma = moved
                numbers = [1 / sigma, *(value / sigma for value in (kxx, kyy, kxy, dxx, dyy, dxy))]
                system = motion.single_mass(*numbers, frame=motion.Frame(wz=omega))
                end = motion.trajectory(system, list(map(mpmath.mpf, start)), [force], mpmath.mpf(h))[0]
                derivative = derivative + sign * end / (2 * delta)
            want = derivative.astype(float)
            errors.append(np.linalg.norm((columns[:, i] - want) / unit) / np.linalg.norm(want / unit))
    return np.array(errors)


@pytest.mark.slow
def test_derivatives_converge_with_the_number_of_nodes():
    """The Gauss rule of n nodes errs as h^(2n) beside the leading h; that of `covering` stays within a few percent."""
    coarse, fine = relative_jacobian_error(1, 50e3), relative_jacobian_error(1, 100e3)
    assert np.all(fine < 0.01)
    assert np.all(coarse / fine == pytest.approx(4.0, rel=0.3))
    coarse, fine = relative_jacobian_error(2, 100e3), relative_jacobian_error(2, 200e3)
    assert np.all(coarse / fine == pytest.approx(16.0, rel=0.3))
    assert np.all(relative_jacobian_error(5, 100e3) < 1e-10)
    for rate in (12e3, 20e3, 30e3, 39e3, 50e3):  # with the margin that the loop takes
        assert np.all(relative_jacobian_error(Exact.covering(1.3 * 3760.0, rate).nodes, rate) < 0.07)


def test_what_an_exact_series_is_given_stands():
    """The rest follows sample rate and duration: the less damping leaves of a swing, the more nodes."""
    assert Exact.covering(5e3, 100e3, Exact(24, nodes=6)) == Exact(24, nodes=6)
    automatic = Exact.covering(5e3, 50e3)
    longer = Exact.covering(5e3, 50e3, Exact(24))
    assert (longer.order, longer.nodes) == (24, automatic.nodes)
    assert Exact.covering(5e3, 50e3, Exact(nodes=1)).order == automatic.order
    counts = [Exact.covering(5e3, 100e3, left=left).nodes for left in (1.0, 0.1, 1e-3, 1e-6, 0.0)]
    assert counts == sorted(counts)
    assert counts[0] == 1
    assert counts[-2] == counts[-1] > 2
    with pytest.raises(InputError, match="`nodes` must be at least 1, but 0"):
        Exact(nodes=0)


def test_forward_euler_is_one_step_of_the_definition():
    dynamics = single(SINGLE_NUMBERS).dynamics(Inertial(rate=3.0))
    a, b, _ = motion.single_mass(*SINGLE_NUMBERS.values(), frame=motion.Frame(wz=3.0))
    force, euler = (2e-5, -1e-5), ForwardEuler()
    want = np.array(START) + 1e-6 * (a @ START + b @ force)
    push = applied(dynamics, force)
    assert np.allclose(euler.advance(START, push, dynamics.stiffness, dynamics.velocity, 1e-6), want, rtol=1e-14)
    step = euler.transition(dynamics.stiffness, dynamics.velocity, 1e-6)
    moved = np.array(step.full, float) @ START + np.array(step.push, float) @ push
    assert np.allclose(moved, want, rtol=1e-14)


def test_forward_euler_is_of_first_order():
    dynamics = single(SINGLE_NUMBERS).dynamics(Inertial(rate=1.0))

    def end(discretisation, rate):
        return np.asarray(follow(discretisation, dynamics, START, np.zeros((round(rate * 1e-4), 2)), 1.0 / rate))[-1]

    want = end(Exact(12), 1e6)
    errors = [np.linalg.norm((end(ForwardEuler(), rate) - want)[:2]) for rate in (2e7, 4e7, 8e7)]
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.01)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.01)


def test_forward_euler_pumps_energy_as_computed():
    """Without damping the amplitude of one axis grows by sqrt(1 + (ωh)²) a sample."""
    k = 3.5e8
    dynamics = Dynamics(((k, 0.0), (0.0, k)), ((0.0, 0.0), (0.0, 0.0)), ((0.0, 0.0), (0.0, 0.0)), (1.0, 1.0))
    path = np.asarray(follow(ForwardEuler(), dynamics, (1e-6, 0, 0, 0), np.zeros((1000, 2)), 1e-6))
    amplitude = np.hypot(path[:, 0], path[:, 2] / k**0.5)
    assert np.allclose(amplitude, 1e-6 * (1 + k * 1e-12) ** (np.arange(1, 1001) / 2), rtol=1e-12)


@pytest.mark.parametrize("spinning", [0.0, 1e4])
def test_energy_is_kept_without_damping(spinning):
    """Coriolis forces do no work: ½v² + ½qᵀKq stays, at any rate of turn."""
    numbers = SINGLE_NUMBERS | {"dxx": 1e-30, "dyy": 1e-30, "dxy": 0.0}
    dynamics = single(numbers).dynamics(Inertial(rate=spinning))
    path = np.asarray(follow(Exact.covering(6e3, 100e3), dynamics, START, np.zeros((2000, 2)), 1e-5))
    k = np.array(dynamics.stiffness)
    energy = 0.5 * np.sum(path[:, 2:] ** 2, axis=1) + 0.5 * np.einsum("ti,ij,tj->t", path[:, :2], k, path[:, :2])
    assert np.max(np.abs(energy / energy[0] - 1.0)) < 1e-12


def test_motion_of_a_matched_gyro_is_thesis_4_30():
    """The closed form for kxx = kyy without damping, started at rest from x = A."""
    k, kxy, turn, start = 4.4e8, 7.1e7, 40.0, 1e-6
    dynamics = Dynamics(((k, kxy), (kxy, k)), ((0.0, 0.0), (0.0, 0.0)), ((0, -2 * turn), (2 * turn, 0)), (1.0, 1.0))
    got = np.asarray(follow(Exact.covering(3700.0, 100e3), dynamics, (start, 0, 0, 0), np.zeros((2000, 2)), 1e-5))
    t, xi = np.arange(1, 2001) * 1e-5, np.sqrt(kxy**2 + 4 * turn**2 * (k + turn**2))
    w1, w2 = np.sqrt(k + 2 * turn**2 + xi), np.sqrt(k + 2 * turn**2 - xi)
    x = (
        (start / 2 - turn**2 * start / xi) * np.cos(w1 * t)
        + (start / 2 + turn**2 * start / xi) * np.cos(w2 * t)
    )  # fmt: skip
    y = kxy * start / (2 * xi) * (np.cos(w1 * t) - np.cos(w2 * t))
    sines = np.sin(w1 * t) / w1, np.sin(w2 * t) / w2
    forward = x + kxy * turn * start / xi * (sines[0] - sines[1]), y - k * turn * start / xi * (sines[0] - sines[1])
    errors = np.max(np.abs(got[:, :2] - np.stack(forward, axis=1)))
    assert errors < ATTOMETRE


def test_a_fence_changes_nothing(monkeypatch):
    """Where the compiler lacks fusion over several outputs, a conditional stands in; the numbers stay."""
    dynamics = single(SINGLE_NUMBERS).dynamics(Inertial(rate=1.0))
    bare = Exact(12).transition(dynamics.stiffness, dynamics.velocity, 1e-5)
    assert fence(0.0, bare) is bare
    monkeypatch.setenv("XLA_FLAGS", "")
    fenced = jax.jit(lambda time: fence(time, bare))(0.0)
    assert fenced is not bare
    same = jax.tree.map(lambda a, b: bool(np.all(np.asarray(a) == np.asarray(b))), fenced, bare)
    assert all(jax.tree.leaves(same))


def test_a_sine_that_dies_share_is_not_in_their_loop():
    def loops_with_a_sine(step) -> list[str]:
        program = jax.jit(step).lower(0.1, jnp.ones(32)).compile().as_text()
        loops = (part for part in program.split("\n\n") if not part.startswith("ENTRY"))
        return [loop for loop in loops if " sine(" in loop and "[32]" in loop]

    assert loops_with_a_sine(lambda time, dies: dies * jnp.sin(time))  # else `once` has become superfluous
    assert not loops_with_a_sine(lambda time, dies: dies * once(time, jnp.sin(time)))


def test_what_is_computed_once_stays_as_it_is():
    times, each = jnp.linspace(0.0, 1.0, 5), jnp.arange(3.0)
    for time in times:
        value, slope = jax.jit(jax.value_and_grad(lambda t: once(t, (jnp.sin(3.0 * t), each))[0]))(time)
        np.testing.assert_allclose((value, slope), (np.sin(3.0 * time), 3.0 * np.cos(3.0 * time)), rtol=1e-14)
    assert once(0.0, (1.0, each))[1] is each
