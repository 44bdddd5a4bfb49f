"""A plain second way to a settled vibration: Newton's method on the map of one period, integrated by SciPy.

Knows nothing of the package: forces come in as a function of displacement, velocity and drive, in N.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp


@dataclass(frozen=True)
class Plant:
    """m·q'' = −k·q − d·q' + u + extra(q, q', u), on two axes: SI units, matrices of shape (2, 2)."""

    mass: float
    stiffness: np.ndarray
    damping: np.ndarray
    extra: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def settled(plant: Plant, omega: float, drive: np.ndarray, guess: np.ndarray, samples: int = 2048, rtol=1e-11):
    """Displacement and velocity (2, samples) over one period of the drive [N]·cos(ωt), from near the phasor `guess`
    [m].
    """
    unit = np.abs(guess).max()  # time in 1/ω, displacement in this: all of order one

    def slope(theta: float, s: np.ndarray) -> np.ndarray:
        q, v, u = s[:2] * unit, s[2:] * unit * omega, drive * np.cos(theta)
        force = u - plant.stiffness @ q - plant.damping @ v + plant.extra(q, v, u)
        return np.concatenate([s[2:], force / (plant.mass * omega**2 * unit)])

    def period(s: np.ndarray, at=None) -> np.ndarray:
        done = solve_ivp(slope, (0, 2 * np.pi), s, "DOP853", rtol=rtol, atol=rtol, t_eval=at)
        return done.y if at is not None else done.y[:, -1]

    s = np.concatenate([guess.real, -guess.imag]) / unit
    for _ in range(12):
        end, step = period(s), 1e-5
        steps = np.eye(4) * step
        monodromy = np.stack([(period(s + d) - period(s - d)) / (2 * step) for d in steps], axis=1)
        change = np.linalg.solve(monodromy - np.eye(4), end - s)
        s = s - change
        if np.abs(change).max() < 1e-10:
            break
    else:
        raise RuntimeError("no periodic solution from this guess")
    path = period(s, at=2 * np.pi * np.arange(samples) / samples)
    return path[:2] * unit, path[2:] * unit * omega


def first_harmonic(signal: np.ndarray) -> np.ndarray:
    """Phasor at the drive frequency of a waveform (..., samples) over one period."""
    count = signal.shape[-1]
    return 2 / count * signal @ np.exp(-2j * np.pi * np.arange(count) / count)
