"""Margins of classic loops whose read-out answers late: against simulations of the same loops."""

from itertools import pairwise

import jax
import numpy as np
import pytest
from scipy import optimize

import memsgyro_jax as mg
from memsgyro_jax.effects import CubicStiffness, ReadoutDelay
from memsgyro_jax.loop.separate_loops import separate_margins
from memsgyro_jax.loop.stability import _matrices, _numbers, closed_poles
from memsgyro_jax.tuning.caveats import margin_eaten


GYRO = mg.SingleMassGyro.from_modes(
    0.8e-9, ("32 kHz", "32.9 kHz"), (4e4, 3e3), quadrature="80 deg/s", cross_damping=0.005
)
READOUT = mg.DirectReadout(5e4)
CONTROL = mg.ClassicControl.force_rebalance(GYRO, READOUT, amplitude=1e-5, demodulator_bandwidth="5 kHz")
TURN = 2.0 * np.pi * 32e3


def loop_of(*effects, readout=READOUT, control=CONTROL):
    gyro = GYRO.with_effect(*effects) if effects else GYRO
    observer = mg.NoObserver.for_device(gyro, readout)
    return mg.ClosedLoop(gyro, readout, observer, control, start=(0.0,) * 4, travel=1.0)


def growth(late):
    return float(np.max(closed_poles(loop_of(ReadoutDelay(late))).real))


@pytest.fixture(scope="module")
def edge():
    """The delay [s] from which the loops of rate and quadrature oscillate."""
    return optimize.brentq(lambda late: growth(late), 4e-6, 6e-6, rtol=1e-4)


def test_a_late_read_out_takes_its_turn_off_the_margin(edge):
    early, late = mg.gain_phase_margins(loop_of()), mg.gain_phase_margins(loop_of(ReadoutDelay(3e-6)))
    assert early.phase_margin[2] - late.phase_margin[2] > np.degrees(TURN * 3e-6)
    assert late.phase_margin[0] == pytest.approx(early.phase_margin[0], abs=1.0)  # the drive locks to what is shown
    assert 0.2 < float(late.distance.rate) < 0.5 < float(early.distance.rate)
    for share, stable in ((0.99, True), (1.01, False), (1.4, False)):
        assert bool(mg.loop_margins(loop_of(ReadoutDelay(share * edge))).rate > 0.0) is stable
    beyond = mg.loop_margins(loop_of(ReadoutDelay(1.1 * 0.5 * np.pi / TURN)))
    assert float(beyond.amplitude) < 0.0, "past a quarter turn the drive's force brakes"


@pytest.mark.slow
def test_simulations_grow_past_that_edge_as_fast_as_the_poles_say(edge):
    def spread_in(late, *ends):
        run = {"sample_rate": 2e6, "duration": ends[-1], "decimation": 20}
        trace = mg.simulate(loop_of(ReadoutDelay(late)), 0.0, **run)
        return [np.std(trace.rate_estimate[(trace.time > end - 0.01) & (trace.time < end)]) for end in ends]

    calm = spread_in(0.93 * edge, 0.02, 0.06)
    assert calm[1] < 1e-2 * calm[0]
    late = 1.04 * edge
    wild = spread_in(late, 0.02, 0.03, 0.04)
    for one, after in pairwise(wild):
        # The series by which a read-out shows late turns by 2 degrees more than the delay, here 4 % of the edge's.
        assert np.log(after / one) / 0.01 == pytest.approx(growth(late), rel=0.3)


def test_a_delayed_read_out_counts_as_the_effect_does():
    late = 4e-7
    by_readout = mg.loop_margins(loop_of(readout=mg.Delayed(READOUT, late)))
    by_effect = mg.loop_margins(loop_of(ReadoutDelay(late)))
    np.testing.assert_allclose(by_readout, by_effect, rtol=1e-9)
    assert float(by_effect.rate) < float(mg.loop_margins(loop_of()).rate) - 0.03


@pytest.mark.slow
def test_one_by_one_they_say_the_same_and_a_lot_of_delays_has_slopes():
    late = np.array([0.0, 2e-6, 4e-6])
    together, alone = (margins(loop_of(ReadoutDelay(late))) for margins in (mg.loop_margins, separate_margins))
    np.testing.assert_allclose(together.rate, alone.rate, atol=0.05)
    np.testing.assert_allclose(together.amplitude, alone.amplitude, atol=0.05)
    one = separate_margins(loop_of(ReadoutDelay(late[1]))).rate
    np.testing.assert_allclose(alone.rate[1], one, rtol=1e-9)
    slope = jax.grad(lambda one: mg.loop_margins(loop_of(ReadoutDelay(one))).rate)(3e-6)
    ends = [float(mg.loop_margins(loop_of(ReadoutDelay(3e-6 + step))).rate) for step in (1e-9, -1e-9)]
    assert float(slope) == pytest.approx((ends[0] - ends[1]) / 2e-9, rel=1e-3)


def test_distances_are_the_least_ones():
    """Beside a frequency that a pair of poles gives twice, too: the least singular value of the return difference."""
    loop = loop_of(ReadoutDelay(3e-6))
    closed, push, out = (np.asarray(part) for part in _matrices(_numbers(loop)[0][0], *_numbers(loop)[1:3])[:3])
    omega = np.geomspace(1e2, 1e5, 20001)
    back = out @ np.linalg.solve(1j * omega[:, None, None] * np.eye(len(closed)) - closed, push + 0j)
    apart = 1.0 / np.linalg.norm((np.eye(4) + back)[:, 2:, 2:], ord=2, axis=(1, 2))
    assert float(mg.loop_margins(loop).rate) == pytest.approx(np.min(apart), rel=1e-6)


def test_effects_that_the_margins_leave_out_are_named():
    found = mg.gain_phase_margins(loop_of(ReadoutDelay(1e-6), CubicStiffness("x", 1e9), CubicStiffness("y", 0.0)))
    assert found.left_out == ("cubic_stiffness x",)
    assert "leave out what these effects of the device do: cubic_stiffness x;" in str(found)
    assert "leave out" not in str(mg.gain_phase_margins(loop_of(ReadoutDelay(1e-6))))
    (said,) = margin_eaten(loop_of(), loop_of(ReadoutDelay(4e-6), CubicStiffness("x", 1e9)))
    assert said.endswith("`simulate` counts them.")


@pytest.mark.slow
def test_samples_take_little_of_a_margin_beside_what_averaging_leaves_out():
    """The open loop of rate at its crossover, from the simulated answer to a rate and what holding makes of it."""
    gyro = mg.SingleMassGyro.from_modes(0.8e-9, ("32 kHz", "32.9 kHz"), (4e4, 3e3))
    control = mg.ClassicControl.force_rebalance(gyro, READOUT, amplitude=1e-5, demodulator_bandwidth="5 kHz")
    loop = mg.ClosedLoop(gyro, READOUT, mg.NoObserver.for_device(gyro, READOUT), control, start=(1e-5, 0.0, 0.0, 0.0))
    told = mg.gain_phase_margins(loop)
    crossover = told.crossover[2]

    def open_loop(samples):
        rate = 32e3 * samples
        found = mg.frequency_response(loop, [0.9 * crossover, crossover], sample_rate=rate, duration=0.03)
        turn = np.pi * crossover / rate
        answer = found.response[1] * np.exp(-1j * turn) * np.sinc(turn / np.pi)
        return answer / (1.0 - answer)

    few, usual, many = map(open_loop, (8, 27, 100))
    assert crossover == pytest.approx(32e3 / 20, rel=0.1)
    assert np.degrees(np.angle(few / many)) == pytest.approx(2.0, abs=0.5)
    assert np.degrees(np.angle(usual / many)) == pytest.approx(0.4, abs=0.2)
    assert 180.0 - abs(np.degrees(np.angle(many))) == pytest.approx(told.phase_margin[2] - 5.3, abs=0.5)
