"""What a linear device answers to sampled forces, and the lines that stand in its readings beside that."""

import numpy as np
from scipy import fft

from memsgyro_jax.device.normalised import NormalisedDevice

from .declared import Readout
from .experiments.base import Phasors
from .phasor_fit import device_of_phasors
from .standing_line import StandingLine, standing_lines, without_lines


MUCH = 2.0  # times the noise
RINGS, LONGEST = 8.0, 4.0  # time constants, and lengths of the record, over which it rings on behind the rows


def linear_answer(
    device: NormalisedDevice, readout: Readout, forces: np.ndarray, period: float, *, held: bool
) -> np.ndarray:
    """Readings (n, channels) of a device that begins at rest, under forces (n, axes) [N] at even times, each `held`
    until the next, where they are exact, or samples of a band-limited force. Its modes, told by their poles, add up.
    """
    rows, axes, mobility = len(forces), device.axes, float(device.mobility)
    matrix = np.zeros((2 * axes, 2 * axes))
    matrix[:axes, axes:] = np.eye(axes)
    matrix[axes:] = np.concatenate([-np.asarray(device.stiffness_matrix), -np.asarray(device.damping_matrix)], axis=1)
    poles, modes = np.linalg.eig(matrix)
    given = np.linalg.solve(modes, mobility * np.eye(2 * axes)[:, axes:])
    rings = RINGS / np.min(np.abs(poles.real)) / period
    count = fft.next_fast_len(rows + int(min(rings, LONGEST * rows)), real=True)
    turn = 2j * np.pi * np.fft.rfftfreq(count, period)[:, None]
    lines = fft.rfft(forces, count, axis=0)
    if held:
        once = np.expm1(poles * period)
        each = lines @ (given.T * once / poles) / (np.expm1(turn * period) - once)
    else:
        each = lines @ given.T / (turn - poles)
    shown = (modes[:axes], modes[axes:], modes[axes:] * poles)[readout.order]
    moved = each @ shown.T + (mobility * lines if readout.order == 2 else 0.0)
    return np.asarray(readout.scale * fft.irfft(moved, count, axis=0)[:rows])


def lines_beside_answer(
    time: np.ndarray, signals: np.ndarray, forces: np.ndarray, offered: Phasors | None, readout: Readout, *, held: bool,
    noise: float,
) -> tuple[StandingLine, ...]:  # fmt: skip
    """Lines in readings (n, channels) at even times [s] beside what the linear device of their own phasors, which they
    `offered`, answers to the forces (n, axes) [N]; none where they tell none, nor where more than `MUCH` times the
    `noise` is left beside them, as a device that is not linear answers with lines of its own.
    """
    device = None if offered is None else device_of_phasors([offered])
    if device is None:
        return ()
    left = signals - linear_answer(device, readout, forces, (time[-1] - time[0]) / (len(time) - 1), held=held)
    decay = float(np.min(np.linalg.eigvalsh(device.damping_matrix))) / 2
    found = standing_lines(time, left, device.resonances(), decay, forces)
    rest = without_lines(time, left, found)
    return found if np.sqrt(np.mean(rest**2)) <= MUCH * noise else ()
