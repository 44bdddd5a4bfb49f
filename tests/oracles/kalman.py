"""The extended Kalman filter of the thesis with dense matrices, in any number system NumPy can hold.

State: motion (4), read-out offsets (2), mass-normalised coefficients. All entries are carried, known ones with zero
variance, so that every reduced filter is this one filter with zeros in its prior.
"""

from dataclasses import dataclass, field

import numpy as np

from .motion import held


# (axis, signal, factor) of each coefficient in thesis (3.2) and (3.4); signals x, y, vx, vy, ux, uy.
SINGLE = (
    ((0, 3, 2), (1, 2, -2)), ((0, 0, -1),), ((1, 1, -1),), ((0, 1, -1), (1, 0, -1)),
    ((0, 2, -1),), ((1, 3, -1),), ((0, 3, -1), (1, 2, -1)), ((0, 4, 1), (1, 5, 1)),
)  # fmt: skip
DUAL = (
    ((0, 3, 2),), ((1, 2, -2),), ((0, 0, -1),), ((1, 1, -1),), ((0, 1, -1),), ((1, 0, -1),),
    ((0, 2, -1),), ((1, 3, -1),), ((0, 4, 1),), ((1, 5, 1),),
)  # fmt: skip


def influence(table, signals):
    """2 × n: acceleration of each axis per unit of each coefficient."""
    matrix = np.array([[signals[0] * 0] * len(table)] * 2)
    for column, terms in enumerate(table):
        for axis, signal, factor in terms:
            matrix[axis, column] = matrix[axis, column] + factor * signals[signal]
    return matrix


@dataclass
class Kalman:
    """`mean` and `covariance` over (motion, offsets, coefficients); everything else as in the thesis.

    `gauss` holds points and weights on [0, 1] of the rule for the coefficient columns of the Jacobian; `euler` asks for
    the thesis' own step. `fading` is a function (spread, innovation, variance) -> λ. A pick-off with a `curve` c of its
    axis shows q + c q².
    """

    table: tuple
    mean: np.ndarray
    covariance: np.ndarray
    scale: tuple
    signals: tuple[int, int]
    density: tuple
    h: object
    walk: np.ndarray
    gauss: tuple = ((0.5, 1.0),)
    euler: bool = False
    iterations: int = 1
    fading: object = None
    annealing: object = None
    curve: tuple = (0, 0)
    terms: int = 60
    nis: object = 0.0
    factor: object = field(default=1.0)

    def system(self, theta):
        """(A, B) of the motion under coefficients theta."""
        zero = theta[0] * 0
        unit = [[zero + (i == j) for j in range(6)] for i in range(6)]
        rows = np.stack([influence(self.table, u) @ theta for u in unit], axis=1)
        a = np.array([[zero] * 4] * 4)
        a[0, 2], a[1, 3], a[2:] = zero + 1, zero + 1, rows[:, :4]
        b = np.array([[zero] * 2] * 4)
        b[2:] = rows[:, 4:]
        return a, b

    def predicted(self, state, force):
        """The state a sample later and its Jacobian."""
        motion, theta = state[:4], state[6:]
        a, b = self.system(theta)
        kick = np.array([[theta[0] * 0] * 2] * 4)
        kick[2, 0] = kick[3, 1] = theta[0] * 0 + 1
        jacobian = np.array([[theta[0] * 0 + (i == j) for j in range(len(state))] for i in range(len(state))])
        if self.euler:
            full = jacobian[:4, :4] + a * self.h
            mean = motion + self.h * (a @ motion + b @ force)
            jacobian[:4, 6:] = self.h * kick @ influence(self.table, [*motion, *force])
        else:
            full, push = held(a, b, self.h, self.terms)
            mean = full @ motion + push @ force
            # The points are symmetric, so what remains after one is what was covered before another.
            parts = {point: held(a, b, point * self.h, self.terms) for point, _ in self.gauss}
            for (point, weight), (mirror, _) in zip(self.gauss, reversed(self.gauss), strict=True):
                reach, reach_push = parts[point]
                inside = reach @ motion + reach_push @ force
                rest, _ = parts[mirror]
                jacobian[:4, 6:] += weight * self.h * rest @ kick @ influence(self.table, [*inside, *force])
        jacobian[:4, :4] = full
        return np.concatenate([mean, state[4:]]), jacobian

    def step(self, measured, force, time):
        """Predict to `time` and correct with both channels at once."""
        size = len(self.mean)
        variance = [d**2 / (2 * self.h) * (self.annealing(time) if self.annealing else 1) for d in self.density]
        about = self.mean
        for _ in range(self.iterations):
            moved, jacobian = self.predicted(about, force)
            mean = moved + jacobian @ (self.mean - about)
            h_matrix, bend = np.array([[self.mean[0] * 0] * size] * 2), np.array([self.mean[0] * 0] * 2)
            for axis, (signal, curve) in enumerate(zip(self.signals, self.curve, strict=True)):
                h_matrix[axis, signal] = self.scale[axis] * (1 + 2 * curve * mean[signal])
                h_matrix[axis, 4 + axis] = self.mean[0] * 0 + 1
                bend[axis] = self.scale[axis] * curve * mean[signal] ** 2
            residual = np.array(measured) - (h_matrix @ mean - bend)
            prior = jacobian @ self.covariance @ jacobian.T
            factor = 1
            if self.fading:
                factor = self.fading(np.diag(h_matrix @ prior @ h_matrix.T), residual, variance)
            inflated = factor * prior + np.diag(self.walk * self.h)
            s = h_matrix @ inflated @ h_matrix.T + np.diag(np.array(variance))
            inverse = inverse2(s)
            gain = inflated @ h_matrix.T @ inverse
            new = mean + gain @ residual
            start = self.mean + factor * self.covariance @ jacobian.T @ h_matrix.T @ inverse @ residual
            about = np.concatenate([start[:4], new[4:]])
        self.mean = new
        covariance = inflated - gain @ s @ gain.T
        self.covariance = (covariance + covariance.T) / 2
        self.nis, self.factor = residual @ inverse @ residual, factor
        return self


def inverse2(s):
    """Inverse of a 2 × 2 matrix."""
    determinant = s[0, 0] * s[1, 1] - s[0, 1] * s[1, 0]
    return np.array([[s[1, 1], -s[0, 1]], [-s[1, 0], s[0, 0]]]) / determinant


class Xia:
    """Adaptive fading (4.16): averaged innovation power, less the noise, over what the filter expects."""

    def __init__(self, window, ceiling, h):
        self.keep = np.exp(-h / window)
        self.ceiling, self.ages, self.squares = ceiling, [], []

    def __call__(self, spread, innovation, variance):
        self.squares.append(float(innovation @ innovation))
        weights = self.keep ** np.arange(len(self.squares))[::-1]
        observed = weights @ np.array(self.squares) / weights.sum() - sum(variance)
        return min(max(1.0, observed / sum(spread)), self.ceiling)


class LinearKalman:
    """The textbook filter for `x' = F x + g`, z = H x + noise, in Joseph form."""

    def __init__(self, mean, covariance):
        self.mean, self.covariance = mean, covariance

    def step(self, f, shift, q, h, r, measured):
        mean, p = f @ self.mean + shift, f @ self.covariance @ f.T + q
        gain = np.linalg.solve(h @ p @ h.T + r, h @ p).T
        rest = np.eye(len(mean)) - gain @ h
        self.mean = mean + gain @ (measured - h @ mean)
        self.covariance = rest @ p @ rest.T + gain @ r @ gain.T
