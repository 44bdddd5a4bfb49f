"""What a linear device answers to sampled forces is as plain steps have it, and what stands beside it is a line."""

import numpy as np
import pytest
from scipy.linalg import expm

from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.measurement.declared import Readout
from memsgyro_jax.measurement.experiments.base import Phasors
from memsgyro_jax.measurement.experiments.windowed_lines import derivatives
from memsgyro_jax.measurement.linear_answer import linear_answer, lines_beside_answer


PERIOD, ROWS = 1 / 40e3, 6000
OMEGA = 2 * np.pi * np.array([4100.0, 4700.0])
DEVICE = NormalisedDevice([*OMEGA**2, 3e6], [*(OMEGA / [150.0, 90.0]), 4.0], 2e4)
TIME = PERIOD * np.arange(ROWS)


def stepped(forces, cubic=0.0):
    """Displacement and velocity at each sample, forces held, of a first axis with a cubic spring that acts in halves
    before and behind each step.
    """
    stiffness, damping = np.asarray(DEVICE.stiffness_matrix), np.asarray(DEVICE.damping_matrix)
    equation = np.zeros((6, 6))
    equation[:2, 2:4] = np.eye(2)
    equation[2:4] = np.concatenate([-stiffness, -damping, float(DEVICE.mobility) * np.eye(2)], axis=1)
    step, state, out = expm(equation * PERIOD)[:4], np.zeros(4), []
    half = -0.5 * PERIOD * cubic * float(DEVICE.mobility)
    for force in forces:
        out.append(state)
        begun = state + np.array([0.0, 0.0, half * state[0] ** 3, 0.0])
        state = step @ np.concatenate([begun, force])
        state[2] += half * state[0] ** 3
    return np.array(out)


def noise(seed, size=1.0):
    return size * np.random.default_rng(seed).standard_normal((ROWS, 2))


@pytest.mark.parametrize("order", [0, 1, 2])
def test_the_answer_to_held_forces(order):
    forces = noise(1)
    told = linear_answer(DEVICE, Readout(3.0, order=order), forces, PERIOD, held=True)
    q, v = np.split(stepped(forces), 2, axis=1)
    bend = float(DEVICE.mobility) * forces - q @ DEVICE.stiffness_matrix - v @ DEVICE.damping_matrix
    true = 3.0 * np.asarray((q, v, bend)[order])
    np.testing.assert_allclose(told, true, atol=1e-4 * np.abs(true).max())


def offered(signals, forces):
    """Spectral lines of a record around its resonances."""
    omega = 2 * np.pi * np.fft.rfftfreq(ROWS, PERIOD)
    near = (omega > 0.5 * OMEGA[0]) & (omega < 2 * OMEGA[1])
    motion, slope, bend = (part[near] for part in derivatives(signals, omega, PERIOD))
    force = derivatives(forces, omega, PERIOD, late=0.5)[0] * np.sinc(omega * PERIOD / 2 / np.pi)[:, None]
    return Phasors(omega[near], motion, force[near], np.full(near.sum(), 1.0), slope=slope, bend=bend)


def found(forces, lines, cubic=0.0, known=1e-3):
    """Lines (frequency: size) in a record of which the noise is `known`, over its size."""
    signals = stepped(forces, cubic)[:, :2]
    size = np.std(signals)
    for hertz, part in lines.items():
        signals = signals + part * size * np.cos(2 * np.pi * hertz * TIME + hertz)[:, None] * [1.0, 0.4]
    signals = signals + noise(2, 1e-3 * size)
    told = lines_beside_answer(
        TIME, signals, forces, offered(signals, forces), Readout(1.0), held=True, noise=known * size
    )
    return {line.omega / 2 / np.pi: line.amplitude[0] / size for line in told}


CHIRP = np.cos(2 * np.pi * (3800.0 * TIME + 4000.0 * TIME**2))[:, None] * [1.0, 0.5]


@pytest.mark.parametrize("forces", [noise(3), CHIRP])
def test_lines_are_found_in_the_band_of_the_device_and_far_below(forces):
    """Two hundred times smaller than the motion in which they stand."""
    told = found(forces, {50.0: 0.02, 4400.0: 5e-3})
    assert list(told) == pytest.approx([50.0, 4400.0], abs=0.05)
    assert list(told.values()) == pytest.approx([0.02, 5e-3], rel=0.05)


TONES = np.cos(2 * np.pi * 3900.0 * TIME)[:, None] * [1.0, 0.0] + np.cos(2 * np.pi * 4250.0 * TIME)[:, None] * [
    0.0,
    1.0,
]


@pytest.mark.parametrize("forces", [noise(4), CHIRP, TONES])
@pytest.mark.parametrize("cubic", [0.0, 0.2])
def test_a_stiff_spring_makes_no_line(forces, cubic):
    """Nor do the harmonics that it makes of tones; the spring is given by how much of its force it adds at most."""
    most = np.abs(stepped(forces)[:, 0]).max()
    assert found(forces, {}, cubic * OMEGA[0] ** 2 / float(DEVICE.mobility) / most**2, known=np.inf) == {}


def test_beside_much_that_is_no_line_none_is_told():
    """Of a benchmark's stiff circuit under many tones eight lines were told, which it answers with itself."""
    lines = {50.0: 0.02, 4400.0: 5e-3}
    assert found(CHIRP, lines, known=0.6e-3)
    assert found(CHIRP, lines, known=0.4e-3) == {}
