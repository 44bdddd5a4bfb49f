"""The thesis' single-mass closed loop in NumPy: plant (3.1), charge amplifier, dense filter, damping compensation."""

import numpy as np

from .motion import held


def compensated(theta, velocity, tone):
    """Force of (4.27): estimated damping times estimated velocity plus the auxiliary signal, over 1/mass."""
    _, _, _, _, dxx, dyy, dxy, sigma = theta
    return (
        np.array([dxx * velocity[0] + dxy * velocity[1] + tone, dxy * velocity[0] + dyy * velocity[1] + tone]) / sigma
    )


def run(system, start, kalman, scale, offset, noise, rate, tone):
    """Truth, volts, force and the filter's mean after each sample; `noise` [V] is added, `tone` a function of time."""
    a, b, c = system
    h = 1.0 / rate
    step, push = held(a, np.concatenate([b, c[:, None]], axis=1), h, 30)
    state, rows = np.array(start), []
    for i, added in enumerate(noise):
        force = compensated(kalman.mean[6:], kalman.mean[2:4], tone(i * h))
        state = step @ state + push @ np.array([*force, 1.0])
        volts = scale * state[:2] + offset + added
        kalman.step(volts, force, (i + 1) * h)
        rows.append(np.concatenate([state, volts, force, kalman.mean, [kalman.covariance[6, 6], kalman.nis]]))
    return np.array(rows)
