"""The observer of thesis (4.11) in scaled variables: the continuous equations and a sampled form, in NumPy.

Length unit L, time unit 1/w. A coefficient is in w² (stiffness), w (damping, rate) or its design value (1/mass); a
force in units of what accelerates the nominal mass by L w².
"""

import numpy as np

from .kalman import influence
from .motion import held


class Lyapunov:
    """`theta` and `motion` in SI; `gain` (2), `adaptation` per coefficient, `units` of the coefficients in SI."""

    def __init__(self, table, motion, theta, gain, adaptation, units, length, w):
        self.table, self.gain, self.w, self.length = table, np.array(gain), w, length
        self.motion, self.theta = np.array(motion, float), np.array(theta, float)
        self.adaptation, self.units = np.array(adaptation), np.array(units)
        self.signal_units = np.array([length, length, length * w, length * w])

    def weights(self, signals):
        """2 × n of (4.11) in scaled variables: the transposed parameter gain L2."""
        force_units = [self.length * self.w**2 / self.units[-2 + i if self.split else -1] for i in (0, 1)]
        scaled = np.array(signals) / np.array([*self.signal_units, *force_units])
        return influence(self.table, scaled)

    @property
    def split(self):
        """Whether the two axes have a 1/mass each."""
        return len(self.table) == 10

    def derivative(self, motion, theta, force, velocity):
        """Time derivatives (SI) of motion and coefficients under the true velocity."""
        signals = [*motion, *force]
        acceleration = influence(self.table, signals) @ theta
        error = (velocity - motion[2:]) / (self.length * self.w)
        push = self.gain * error * self.length * self.w**2
        moving = self.w * self.units * self.adaptation * (self.weights(signals).T @ error)
        return np.concatenate([motion[2:], acceleration + push]), moving

    def step(self, velocity, force, h):
        """Exact prediction, then the correction of a sample by the velocity error, held and decaying with the gain."""
        zero, n = np.zeros(6), len(self.theta)
        a, b = np.zeros((4, 4)), np.zeros((4, 2))
        for i in range(6):
            unit = zero.copy()
            unit[i] = 1.0
            column = influence(self.table, unit) @ self.theta
            (a if i < 4 else b)[2:, i if i < 4 else i - 4] = column
        a[0, 2] = a[1, 3] = 1.0
        step, push = held(a, b, h, 30)
        moved = step @ self.motion + push @ force
        error = (velocity - moved[2:]) / (self.length * self.w)
        closed = 1.0 - np.exp(-self.gain * self.w * h)
        signals = [*moved, *force]
        self.theta = self.theta + self.units * self.adaptation * (
            self.weights(signals).T @ (closed * error / self.gain)
        )
        self.motion = moved
        self.motion[2:] += closed * error * self.length * self.w
        assert len(self.theta) == n
        return self


def energy(stiffness, error_motion, error_theta, units, length, w):
    """V = ½(e₁ᵀK e₁ + e₂ᵀe₂ + ρᵀρ) of scaled errors; K is the plant's stiffness in w²."""
    e1, e2 = error_motion[:2] / length, error_motion[2:] / (length * w)
    rho = error_theta / units
    return 0.5 * (e1 @ (np.array(stiffness) / w**2) @ e1 + e2 @ e2 + rho @ rho)
