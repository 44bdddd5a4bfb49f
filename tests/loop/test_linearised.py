"""A loop over frequency and as matrices: against formulas of the device, and against the runs themselves."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from kept import kept
from scipy import signal
from scipy.linalg import expm

import memsgyro_jax as mg
from memsgyro_jax.device.gyro import Inertial
from memsgyro_jax.loop import noise
from memsgyro_jax.loop.observers.no_observer import NoObserver


RATE = 100e3
SPLIT = mg.SingleMassGyro.from_modes(2e-9, (10e3, 10.3e3), 1000.0, quadrature=np.radians(50.0))
READOUT = mg.DirectReadout(1e6, noise_density=(1e-6, 3e-7))
SWUNG = {"sample_rate": RATE, "duration": 0.15}


@pytest.fixture(scope="module")
def loop():
    control = mg.ClassicControl.open_loop(SPLIT, READOUT, amplitude=1e-6)
    return mg.ClosedLoop(SPLIT, READOUT, NoObserver.for_device(SPLIT, READOUT), control, filter=mg.Lowpass(200.0))


@pytest.fixture(scope="module")
def response(loop):
    return mg.frequency_response(loop, [40.0, 150.0], **SWUNG, settle=0.1)


@pytest.fixture(scope="module")
def trace(loop):
    return mg.simulate(loop, mg.Sine(0.0, 150.0), **SWUNG, seed=1)


def test_it_is_what_a_simulation_of_a_small_sine_shows(loop, response, trace):
    turned = mg.simulate(loop, mg.Sine(0.1, 150.0), **SWUNG, seed=1)
    answer, time = (turned.rate_estimate - trace.rate_estimate)[10_000:] / 0.1, trace.time[10_000:]
    angle = 2.0 * np.pi * 150.0 * time
    basis = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)
    sine, cosine, _ = np.linalg.lstsq(basis, answer)[0]
    assert abs(response.response[1] - (sine + 1j * cosine)) < 1e-4
    assert response.rest[1] < 0.01


def test_it_rises_towards_the_sense_mode_as_the_sidebands_do(loop, response, trace):
    """Half the sum of both sidebands' responses over that at rest, behind the demodulator's pole and the filter."""
    omega, f = 2.0 * np.pi * float(trace.readings.frequency[-1]), response.frequency
    stiff = lambda w: (2.0 * np.pi * 10.3e3) ** 2 - w**2 + 1j * w * 2.0 * np.pi * 10.3  # noqa: E731
    side = [stiff(omega) / stiff(omega + sign * 2.0 * np.pi * f) for sign in (1.0, -1.0)]
    ratio = np.abs(0.5 * (side[0] + np.conj(side[1])))
    behind = np.abs(signal.freqz(*signal.butter(3, 200.0, fs=RATE), worN=f, fs=RATE)[1])
    pole = float(loop.controller.sense.demodulator.bandwidth)
    expected = ratio * behind / np.sqrt(1.0 + (f / pole) ** 2)
    np.testing.assert_allclose(np.abs(response.response), expected, rtol=0.01)


def test_it_prints_draws_and_goes_into_a_file(response, tmp_path):
    data = kept(response, tmp_path)
    np.testing.assert_allclose(data["gain"] * np.exp(1j * data["phase"]), response.response)
    assert "150 Hz" in str(response)
    assert response.plot().get_ylabel() == "gain [dB of 1]"
    assert np.isnan(response.bandwidth)
    assert "ask for lower" not in str(response)
    assert abs(response.static - 1.0) < 1e-3
    late = replace(response, response=0.5 * response.response)
    assert "below 40 Hz already: ask for lower" in str(late)
    assert np.isnan(late.bandwidth)
    falling = replace(response, frequency=np.array([40.0, 80.0]), response=np.array([0.8, 0.4j]))
    assert "no such sine" not in str(response)
    assert "0.077 of the answer is no such sine" in str(replace(response, rest=np.array([0.077, 0.001])))
    assert abs(falling.bandwidth - 40.0 * 2.0 ** (np.log(0.8 * np.sqrt(2.0)) / np.log(2.0))) < 1e-2


def test_what_it_cannot_answer_it_says(loop):
    for frequency, name, said in (
        (10.0, "rate", "at least 13.3"),
        (6e4, "rate", "below 5e"),
        (50.0, "heat", "force x"),
    ):
        with pytest.raises(mg.InputError, match=said):
            mg.frequency_response(loop, [frequency], name, **SWUNG)


def test_the_matrices_are_those_of_the_device(loop, tmp_path):
    linear = loop.linearise(sample_rate=RATE, after=0.001)
    a, b, c, d, dt = linear.space
    dynamics = SPLIT.dynamics(Inertial())
    stiffness, damping = (np.array(m, float) for m in (dynamics.stiffness, dynamics.velocity))
    plant = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -damping]])
    gain = np.concatenate([np.zeros((2, 2)), np.diag([float(g) for g in dynamics.gain])])
    whole = expm(np.block([[plant, gain], [np.zeros((2, 6))]]) * dt)
    size = np.array([1.0, 1.0, 6e4, 6e4])  # rad/s: velocities are so much larger
    np.testing.assert_allclose(a[:4, :4] / size[:, None] * size, whole[:4, :4] / size[:, None] * size, atol=1e-9)
    np.testing.assert_allclose(b[:4, 1:3], whole[:4, 4:], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(d[3:, 3:], np.eye(2), atol=1e-12)
    assert linear.states[:4] == ("motion x", "motion y", "motion vx", "motion vy")
    assert len(set(linear.states)) == len(a) == len(linear.point)
    assert signal.StateSpace(*linear.space[:4], dt=dt).A.shape == a.shape
    assert c.shape == (5, len(a))
    kept(linear, tmp_path)


def test_a_step_that_is_no_whole_period_of_the_swing_is_told(loop):
    """10 kHz at 100 kHz: ten samples are a period, seven are none, and their poles say nothing."""
    linear = loop.linearise(sample_rate=RATE, after=0.02, samples=7)
    assert linear.recurs == 10
    assert linear.apart > 0.3
    assert "`samples=10` is one" in str(linear)
    whole = replace(linear, apart=0.004)
    assert "whole periods" not in str(whole)
    assert f"`samples={linear.nearest}` brings it nearest" in str(whole)
    assert "swing ends" not in str(replace(linear, apart=1e-5))
    assert linear.nearest % 10 == 0


def test_the_response_is_solved_and_not_made_of_polynomials(loop, response):
    """As runs have it, where a step is a period; and as the matrices by themselves go on in time."""
    linear = loop.linearise(sample_rate=RATE, after=0.1, samples=10)
    found = linear.response(["40 Hz", 150.0])
    np.testing.assert_allclose(found, linear.response(np.array([40.0, 150.0])))
    # A run's answer is a mean over the swing, the matrices are those of one moment of it: `rest` tells by how much.
    apart = np.abs(np.abs(found[:, 0, 0]) - np.abs(response.response))
    assert np.all(apart < 2.0 * response.rest)
    assert np.all(response.rest < 0.005)
    a, b, c, d, dt = linear.space
    space = signal.StateSpace(a, b[:, :1], c[:1], d[:1, :1], dt=dt)
    time = np.arange(6000) * dt
    _, moved, _ = signal.dlsim(space, np.sin(2.0 * np.pi * 150.0 * time))
    late = time > 0.3
    basis = np.stack([np.sin(2.0 * np.pi * 150.0 * time), np.cos(2.0 * np.pi * 150.0 * time)], axis=1)[late]
    sine, cosine = np.linalg.lstsq(basis, moved[late, 0])[0]
    np.testing.assert_allclose(found[1, 0, 0], sine + 1j * cosine, rtol=1e-3)


@pytest.mark.slow
def test_poles_have_slopes(loop):
    def highest(factor):
        stiffer = eqx.tree_at(lambda made: made.device.kyy, loop, factor * SPLIT.kyy)
        return jnp.max(mg.linearise(stiffer, sample_rate=RATE, after=0.001).poles.imag)

    slope = jax.jvp(highest, (1.0,), (1.0,))[1]
    ends = [float(highest(1.0 + step)) for step in (1e-5, -1e-5)]
    assert float(slope) == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-3)


@pytest.mark.slow
def test_a_program_of_one_sample_runs_without_the_loop(loop, trace):
    made = mg.export_loop(loop, sample_rate=RATE)
    assert "stablehlo" in made.program.mlir_module()
    state, words = made.start, noise.die_words(jax.random.key(1), np.asarray(0))
    for number in range(5):
        draws = np.stack(noise.normal_pair(words, number, 0))
        state, out = made.program.call(state, np.int64(number), 0.0, draws)
        np.testing.assert_allclose(out[3:], trace.volts[number], rtol=1e-12)
        np.testing.assert_allclose(out[1:3], trace.force[number], rtol=1e-9, atol=1e-18)


@pytest.mark.slow
def test_an_exported_filter_is_as_exact_as_that_of_a_run():
    """The longer a filter runs, the more exactly it takes its derivative: what is exported meets a run whose duration
    it is told to rounding, and any other by less than the filter claims.
    """
    gyro = mg.SingleMassGyro.from_modes("6 ug", ("21 kHz", "21.4 kHz"), (8000, 2500))
    kalman = mg.ExtendedKalmanFilter.for_device(gyro, READOUT)
    loop = mg.ClosedLoop(gyro, READOUT, kalman, mg.DampingCompensation(tones=mg.Tone(4360.0, 50.0)))
    run = {"sample_rate": 4e5, "duration": 0.02}
    trace = mg.simulate(loop, **run, seed=1)
    for made, within in ((mg.export_loop(loop, **run), 1e-6), (mg.export_loop(loop, sample_rate=4e5), 0.3)):
        state, words = made.start, noise.die_words(jax.random.key(1), np.asarray(0))
        for number in range(200):
            draws = np.stack(noise.normal_pair(words, number, 0))
            state, out = made.program.call(state, np.int64(number), 0.0, draws)
            assert abs(out[0] - trace.rate_estimate[number]) < within * trace.rate_std[number], number


@pytest.mark.slow
def test_a_force_beside_the_swing_is_answered_as_the_rate_whose_force_it_is(loop, response):
    """2 m ω A is the Coriolis force of a rate, here of an oscillation at the frequency of the swing."""
    swing = float(mg.noise_budget(loop).swing)
    answer = mg.frequency_response(loop, [40.0, 150.0], "force y", **SWUNG, settle=0.1, carrier=swing)
    per_rate = 2.0 * float(SPLIT.mass) * 2.0 * np.pi * swing * 1e-6
    np.testing.assert_allclose(answer.response * per_rate, response.response, rtol=0.02)
    np.testing.assert_allclose(answer.static * per_rate, response.static, rtol=0.02)
    assert max(answer.rest) < 0.05
    assert f"force y at {swing:.5g} Hz, by its amplitude (rad/s/N)" in str(answer)
