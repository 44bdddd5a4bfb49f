"""Devices far from the thesis', each on a bench of its own: what a rate of errors is counted over."""

from dataclasses import dataclass

import numpy as np
from lab.die import Die
from lab.protocol import Laboratory, RingDown, Sweep


@dataclass(frozen=True)
class Device:
    """A die and the bench that measures it."""

    die: Die
    protocol: Laboratory


def gyro(frequency, split, quality, mass, coupling):
    """Two axes [Hz] of one quality factor; `coupling` of their springs as a share of the split."""
    w = 2 * np.pi * np.array([frequency, frequency + split])
    k, d = mass * w**2, mass * w / quality
    kxy = coupling * mass * w.mean() * 2 * np.pi * split
    return Die(mass, *k, kxy, *d, 0.05 * d[0], 0.012, -0.009, scale=5e5, length=5e-7)


def peak(die, axis, motion):
    """Force [N] that moves an axis by so many meters at its resonance, to two digits."""
    w = np.sqrt(die.stiffness[axis] / die.mass)
    return float(f"{motion * w * die.damping[axis]:.2g}")


def _swept(die, name, axis, motions, widths=6.0, points=17, **more):
    """Settled sweeps with the given peak motions, over so many full widths to either side."""
    width = die.damping[axis] / die.mass / (2 * np.pi)
    forces = tuple(peak(die, axis, motion) for motion in motions)
    return Sweep(name, axis, forces, points=points, span=widths * width, dense=width, **more)


def _decaying(die, name, axis, motion, cycles, interval, samples, **more):
    seconds = cycles * die.period
    return RingDown(name, axis, peak(die, axis, motion), seconds, interval, samples, **more)


def _wide():
    die = gyro(25e3, 800.0, 2000.0, 2e-9, 0.03)
    return Device(die, Laboratory((
        _swept(die, "sweep_x", 0, (1e-7, 7e-7)),
        _swept(die, "sweep_y", 1, (1e-7, 7e-7)),
        _decaying(die, "ringdown", 0, 7e-7, 3000, 1e-5, 600, noise=2e-3),
    )))  # fmt: skip


def _matched():
    die = gyro(14e3, 5.0, 1e5, 1e-8, 0.2)
    return Device(die, Laboratory((
        _swept(die, "sweep_x", 0, (1e-7, 7e-7)),
        _swept(die, "sweep_y", 1, (1e-7, 7e-7)),
        _decaying(die, "ringdown", 0, 7e-7, 2000, 1.7e-5, 600, noise=2e-3),
    ), finder=3, digits=9))  # fmt: skip


def _one_axis():
    die = Die.resonator(32.8e3, 2e4, 1e-3, length=0.1)
    swept = {"both": False, "noise": 1e-4}
    return Device(die, Laboratory((
        _swept(die, "sweep", 0, (0.02, 0.08, 0.2), points=21, **swept),
        _swept(die, "sweep_check", 0, (0.12,), points=21, role="validation", **swept),
        _decaying(die, "ringdown", 0, 0.2, 6000, 1.1e-5, 600, noise=1e-3),
    ), finder=2, digits=9))  # fmt: skip


def _few_records():
    die = gyro(8e3, 120.0, 5000.0, 3e-8, 0.05)
    return Device(die, Laboratory((
        _swept(die, "sweep_x", 0, (5e-7,), points=31),
        _decaying(die, "ringdown", 0, 5e-7, 6000, 4.9e-5, 2400, noise=2e-3),
    )))  # fmt: skip


DEVICES = {
    "25 kHz, Q 2000, split 800 Hz": _wide(),
    "14 kHz, Q 1e5, split 5 Hz": _matched(),
    "one axis, 32.8 kHz, Q 20 000": _one_axis(),
    "8 kHz, one sweep and one ring-down": _few_records(),
}
