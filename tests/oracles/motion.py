"""Thesis (2.4), (3.1) and (3.3) as matrices, and their exact solution, in any number system NumPy can hold."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Frame:
    """Rates in rad/s, spin dΩz/dt in rad/s², linear acceleration in m/s², relative changes of dxx, dyy, dxy."""

    wx: float = 0.0
    wy: float = 0.0
    wz: float = 0.0
    spin: float = 0.0
    ax: float = 0.0
    ay: float = 0.0
    damping: tuple[float, float, float] = (0.0, 0.0, 0.0)


def single_mass(m, kxx, kyy, kxy, dxx, dyy, dxy, dyx=None, *, frame=None, full=False):
    """(A, B, c) of `state' = A state + B force + c`; `full` keeps every term of (2.4)."""
    f = frame or Frame()
    dyx = dxy if dyx is None else dyx
    sx, sy, sc = (1 + change for change in f.damping)
    k = [[kxx, kxy], [kxy, kyy]]
    if full:
        k = [
            [kxx - m * (f.wy**2 + f.wz**2), kxy + m * (f.wx * f.wy - f.spin)],
            [kxy + m * (f.wx * f.wy + f.spin), kyy - m * (f.wx**2 + f.wz**2)],
        ]
    c = [[dxx * sx, dxy * sc - 2 * m * f.wz], [dyx * sc + 2 * m * f.wz, dyy * sy]]
    return _assembled(k, c, (m, m), (f.ax, f.ay) if full else (0, 0))


def dual_mass(mx, my, kxx, kyy, kxy, kyx, dxx, dyy, *, frame=None, full=False):
    """(3.3): along x the whole mass `mx` moves, along y (and under the cross terms of the frame) `my` alone."""
    f = frame or Frame()
    sx, sy, _ = (1 + change for change in f.damping)
    k = [[kxx, kxy], [kyx, kyy]]
    if full:
        k = [
            [kxx - mx * (f.wy**2 + f.wz**2), kxy + my * (f.wx * f.wy - f.spin)],
            [kyx + my * (f.wx * f.wy + f.spin), kyy - my * (f.wx**2 + f.wz**2)],
        ]
    c = [[dxx * sx, -2 * my * f.wz], [2 * my * f.wz, dyy * sy]]
    return _assembled(k, c, (mx, my), (f.ax, f.ay) if full else (0, 0))


def _assembled(stiffness, damping, masses, acceleration):
    zero = 0 * masses[0]
    one = zero + 1
    a = [[zero, zero, one, zero], [zero, zero, zero, one]]
    for k, c, m in zip(stiffness, damping, masses, strict=True):
        a.append([-k[0] / m, -k[1] / m, -c[0] / m, -c[1] / m])
    b = [[zero, zero], [zero, zero], [one / masses[0], zero], [zero, one / masses[1]]]
    bias = [zero, zero, zero - acceleration[0], zero - acceleration[1]]
    return np.array(a), np.array(b), np.array(bias)


def exponential(matrix, terms=60):
    """exp(matrix) by its Taylor series: right for any number system as long as frequency × time is of order one."""
    term = np.array([[matrix[0, 0] * 0 + (i == j) for j in range(len(matrix))] for i in range(len(matrix))])
    total = term
    for n in range(1, terms):
        term = term @ matrix / n
        total = total + term
    return total


def held(a, b, h, terms=60):
    """(E, G): `state(h) = E state + G u` under constant u in `state' = A state + B u`."""
    n, m = len(a), b.shape[1]
    block = np.array([[a[0, 0] * 0] * (n + m)] * (n + m))
    block[:n, :n], block[:n, n:] = a * h, b * h
    whole = exponential(block, terms)
    return whole[:n, :n], whole[:n, n:]


def trajectory(system, start, forces, h):
    """States after each sample under forces held over the samples, for one constant system (A, B, c)."""
    a, b, c = system
    step, push = held(a, np.concatenate([b, c[:, None]], axis=1), h)
    states, state = [], np.array(start)
    for force in forces:
        state = step @ state + push @ np.array([*force, 1])
        states.append(state)
    return np.array(states)
