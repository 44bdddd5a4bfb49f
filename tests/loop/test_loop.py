"""The closed loop equals a second implementation of it in NumPy, and refuses what cannot run."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from harness import record
from oracles import closed_loop, kalman, motion

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import DualMassGyro, SingleMassGyro
from memsgyro_jax.device.propagate import Exact, ForwardEuler
from memsgyro_jax.loop import noise
from memsgyro_jax.loop.controllers import DampingCompensation, OpenLoop, Tone
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.observers import Clock, ExtendedKalmanFilter
from memsgyro_jax.loop.readout import ChargeAmplifier, DirectReadout
from memsgyro_jax.loop.scenario import Constant, Scenario, as_scenario


DESIGN, CIRCUIT = SingleMassGyro.chi2010(), ChargeAmplifier.chi2010()
NUMBERS = {"m": 1.9e-7, "kxx": 60.0, "kyy": 99.0, "kxy": 11.0, "dxx": 3.9e-6, "dyy": 4.2e-6, "dxy": 3.0e-7}
TURN = motion.Frame(wz=1.0, damping=(0.1, -0.2, 0.3))


@pytest.fixture(scope="module")
def loop():
    """The thesis' loop around a die that is not the design."""
    die = SingleMassGyro(*NUMBERS.values())
    observer = ExtendedKalmanFilter.for_device(DESIGN, CIRCUIT)
    start = (1.01e-6, 0.02e-6, 1e-4, -2e-4)
    made = ClosedLoop(die, CIRCUIT, observer, DampingCompensation(Tone(600.0, 53.95)), start)
    return made.sampled_at(100e3)


@pytest.fixture(scope="module")
def run(loop):
    """400 samples under a constant rate, drifted offsets and changed damping."""
    changes = tuple(map(Constant, TURN.damping))
    scenario = Scenario(Constant(TURN.wz), (Constant(1e-3), Constant(-2e-3)), changes)
    return record(loop, scenario, blocks=400)[1]


def test_equals_a_second_implementation(loop, run):
    """Truth, volts, forces and estimates over 400 samples: the loop with nothing of the package but its noise."""
    words = noise.die_words(jax.random.key(0), jnp.asarray(0))
    draws = np.stack(noise.normal_pair(words, jnp.arange(400), 0), axis=1)
    scale, density = np.array(CIRCUIT.scale), np.array(CIRCUIT.noise_density)
    prior = loop.observer.prior
    std = np.array([*prior.motion_std, *prior.offset_std, *prior.theta_std])
    oracle = kalman.Kalman(
        kalman.SINGLE, np.array([*prior.motion, *prior.offset, *prior.theta]), np.diag(std**2), scale, (0, 1), density,
        1e-5, np.zeros(14), terms=26,
    )  # fmt: skip
    want = closed_loop.run(
        motion.single_mass(*NUMBERS.values(), frame=TURN), np.array(loop.start), oracle, scale,
        np.array(CIRCUIT.offset) + np.array([1e-3, -2e-3]), density * np.sqrt(0.5e5) * draws, 100e3,
        lambda time: 53.95 * np.sin(2 * np.pi * 600.0 * time),
    )  # fmt: skip
    truth, volts, force = run[:, :4], run[:, 4:6], run[:, 6:8]
    assert np.max(np.abs(truth - want[:, :4]) / [1, 1, 2e4, 2e4]) < 1e-15
    assert np.max(np.abs(volts - want[:, 4:6])) < 1e-10
    assert np.max(np.abs(force - want[:, 6:8])) < 1e-8 * 1e-5
    spread = np.sqrt(np.diag(oracle.covariance))
    estimates = np.concatenate([run[:, 8:12], run[:, 20:22], run[:, 12:20]], axis=1)
    assert np.max(np.abs(estimates - want[:, 8:22]) / spread) < 1e-7
    assert np.allclose(run[:, 22:], want[:, 22:], rtol=1e-7)


def test_the_filter_finds_the_rate(run):
    """A sanity check of scale: after 4 ms the error is a few of the stated standard deviations."""
    error, std = run[-1, 12] - TURN.wz, np.sqrt(run[-1, 22])
    assert std < 1.5
    assert abs(error) < 5 * std


def test_the_observer_never_sees_the_truth(loop):
    """Two devices that give the same volts give the same estimate and command, whatever their motion."""
    zero = (jnp.zeros(()), jnp.zeros(()))
    ideal = eqx.tree_at(lambda tree: (tree.readout.mismatch, tree.readout.opamp_offset), loop, (zero, zero))
    ideal = eqx.tree_at(lambda tree: tree.controller, ideal, OpenLoop())
    half = eqx.tree_at(lambda tree: tree.readout.bias, ideal, 0.5 * ideal.readout.bias)
    state, conditions, clock = loop.init(), as_scenario(0.0).at(0.0), Clock(0.0, 0, 1e-5)
    twice = state._replace(motion=tuple(2.0 * m for m in state.motion))
    _, first = ideal.step(state, conditions, (0.0, 0.0), clock)
    _, second = half.step(twice, conditions, (0.0, 0.0), clock)
    assert np.allclose(np.array(first.volts), np.array(second.volts), rtol=1e-13)
    assert not np.allclose(np.array(first.motion), np.array(second.motion))
    assert np.allclose(np.array(first.estimate.theta), np.array(second.estimate.theta), rtol=1e-12)


def test_a_sample_has_one_clock(loop):
    """The command acts from `clock` to one period later; what is recorded belongs to the end."""
    _, sample = loop.step(loop.init(), as_scenario(0.0).at(0.0), (0.0, 0.0), Clock(2e-3, 200, 1e-5))
    assert float(sample.clock.time) == pytest.approx(2.01e-3)
    assert sample.clock.sample == 201
    tone = 53.95 * np.sin(2 * np.pi * 600.0 * 2e-3)
    theta, prior = loop.observer.prior.theta, loop.observer.prior.motion
    want = closed_loop.compensated(np.array(theta), np.array(prior)[2:], tone)
    assert np.array(sample.force) == pytest.approx(want, rel=1e-12)


def test_sampling_sets_every_exact_series(loop):
    fast, slow = loop.sampled_at(1e6), loop.sampled_at(12e3)
    assert fast.discretisation.order < slow.discretisation.order
    assert fast.discretisation == fast.observer.discretisation
    assert slow.observer.discretisation.nodes > 1
    chosen = eqx.tree_at(lambda tree: tree.observer.discretisation, loop, Exact(24, nodes=6))
    assert chosen.sampled_at(1e6).sampled_at(50e3).observer.discretisation == Exact(24, nodes=6)
    assert chosen.sampled_at(1e6).discretisation == fast.discretisation
    assert loop.sampled_at(1e5, duration=0.1).discretisation.nodes == 1
    assert loop.sampled_at(1e5, duration=1.0).discretisation.nodes > 2, "damping leaves the motion as if known"
    euler = eqx.tree_at(lambda tree: tree.observer.discretisation, loop, ForwardEuler())
    assert isinstance(euler.sampled_at(50e3).observer.discretisation, ForwardEuler)
    assert isinstance(euler.sampled_at(50e3).discretisation, Exact)


@pytest.mark.parametrize("rate", [0.0, -1e5, float("nan"), float("inf")])
def test_impossible_sample_rates_are_refused(loop, rate):
    with pytest.raises(InputError, match="`sample_rate` must be a positive number of Hz"):
        loop.sampled_at(rate)


def test_an_under_sampled_loop_is_refused(loop):
    with pytest.raises(InputError, match="`sample_rate` must exceed twice the highest frequency"):
        loop.sampled_at(5e3)


def test_an_observer_of_another_kind_of_device_is_refused():
    with pytest.raises(InputError, match=r"observer must expect the kind of device it watches; make it with `for_dev"):
        ClosedLoop(DualMassGyro.chi2010(), CIRCUIT, ExtendedKalmanFilter.for_device(DESIGN), OpenLoop())


def test_an_observer_of_another_signal_is_refused():
    observer = ExtendedKalmanFilter.for_device(DESIGN, CIRCUIT)
    with pytest.raises(InputError, match="must measure the same, displacement or velocity"):
        ClosedLoop(DESIGN, DirectReadout.of_velocity(1.0, 1e-9), observer, OpenLoop())


def test_an_observer_of_the_opposite_sign_is_refused():
    observer = ExtendedKalmanFilter.for_device(DESIGN)  # expects the charge amplifier, whose scale is negative
    with pytest.raises(InputError, match="a scale of the same sign as the read-out's; make it with `for_device"):
        ClosedLoop(DESIGN, DirectReadout(1e5, noise_density=1e-7), observer, OpenLoop())


@pytest.mark.parametrize("travel", [0.0, -1e-6, float("nan")])
def test_an_impossible_travel_is_refused(loop, travel):
    with pytest.raises(InputError, match="`travel` must be positive and finite"):
        ClosedLoop(DESIGN, CIRCUIT, loop.observer, OpenLoop(), travel=travel)


def test_a_start_must_have_four_finite_entries(loop):
    for start in ((1e-6, 0.0), (1e-6, 0.0, float("nan"), 0.0)):
        with pytest.raises(InputError, match="`start` must be 4 finite numbers"):
            ClosedLoop(DESIGN, CIRCUIT, loop.observer, OpenLoop(), start)
