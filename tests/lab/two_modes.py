"""An independent laboratory: two coupled modes swept in frequency, by 2 × 2 linear algebra in NumPy alone."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import solve_ivp


@dataclass(frozen=True)
class Gyro:
    """Physical parameters in SI; the defaults are the reference device of the sweep paper."""

    mass: float = 3e-7
    fx: float = 8014.3
    fy: float = 8014.3 + 21.0
    qx: float = 45_000.0
    qy: float = 42_000.0
    cxy: float = -6.96e-8
    kxy: float = 0.103
    lam_yx: float = -0.000374
    lam_xy: float = 0.0002
    rate: float = 0.0

    def matrices(self):
        """Mass, damping (with Coriolis) and stiffness matrices, and the force matrix (columns: electrodes)."""
        wx, wy, m = 2 * np.pi * self.fx, 2 * np.pi * self.fy, self.mass
        stiffness = np.array([[m * wx**2, self.kxy], [self.kxy, m * wy**2]])
        damping = np.array(
            [[m * wx / self.qx, self.cxy - 2 * m * self.rate], [self.cxy + 2 * m * self.rate, m * wy / self.qy]]
        )
        return np.eye(2) * m, damping, stiffness, np.array([[1.0, self.lam_xy], [self.lam_yx, 1.0]])


@dataclass(frozen=True)
class Instrument:
    """Complex gains of the read-out, and constant leaks per drive of the driven electrode."""

    gain: complex = 2.5e9 * np.exp(0.4j)
    ratio: float = 1.0
    asymmetry: float = 0.0
    drive_ratio: complex = 1.0
    leak: tuple = (0.0, 0.0)


def steady(gyro, frequency, axis=0):
    """Displacement phasors (n, 2) per newton on one electrode at frequencies [Hz]."""
    mass, damping, stiffness, force = gyro.matrices()
    w = 2 * np.pi * np.asarray(frequency)[:, None, None]
    return np.linalg.solve(stiffness - w**2 * mass + 1j * w * damping, force[:, axis])


def chirped(gyro, frequency, speed, axis=0):
    """As `steady`, for a sweep at `speed` [Hz/s] that starts settled at the first frequency: the equations integrated
    in the rotating frame.
    """
    mass, damping, stiffness, force = gyro.matrices()
    f0 = frequency[0]
    sign = np.sign(frequency[-1] - f0)
    beta = 2 * np.pi * speed * sign

    inverse = np.linalg.inv(mass)
    own, damped, stiff = inverse @ force[:, axis], inverse @ damping, inverse @ stiffness

    def slope(t, state):
        # x = Z e^{iφ(t)} with φ' = w: Z'' = M⁻¹(F − K Z − D (Z' + iwZ)) − 2iw Z' + (w² − iβ) Z
        w = 2 * np.pi * f0 + beta * t
        z, v = state[:2], state[2:]
        acceleration = own - stiff @ z - damped @ (v + 1j * w * z) - 2j * w * v + (w**2 - 1j * beta) * z
        return np.concatenate([v, acceleration])

    z0 = steady(gyro, [f0], axis)[0]
    times = np.abs(np.asarray(frequency) - f0) / speed
    solution = solve_ivp(
        slope, (0, times[-1]), np.concatenate([z0, 0 * z0]), t_eval=times, method="DOP853", rtol=1e-10, atol=1e-22
    )
    return solution.y[:2].T


def record(gyro, instrument, frequency, axis=0, motion=None):
    """Phasors (n, 2) that the instrument would read without noise."""
    motion = steady(gyro, frequency, axis) if motion is None else motion
    channels = np.array([1.0, instrument.ratio * np.exp(1j * instrument.asymmetry)])
    drive = instrument.drive_ratio if axis else 1.0
    return gyro.mass * instrument.gain * drive * motion * channels + np.asarray(instrument.leak)


def noisy(phasors, amplitude, phase_deg, rng):
    """Uniform relative amplitude and phase noise, both peak to peak."""
    a = 1 + 0.5 * amplitude * rng.uniform(-1, 1, phasors.shape)
    return phasors * a * np.exp(0.5j * np.radians(phase_deg) * rng.uniform(-1, 1, phasors.shape))


def write_polar(path, frequency, phasors, extra=None, digits=17):
    """CSV in the measurement format, amplitude [1] and phase [deg]."""
    columns = {"f [Hz]": frequency}
    for i, a in enumerate("xy"):
        columns[f"V{a}_amp [1]"] = np.abs(phasors[:, i])
        columns[f"V{a}_phase [deg]"] = np.degrees(np.angle(phasors[:, i]))
    write(path, {**(extra or {}), **columns}, digits)


def write_cartesian(path, frequency, phasors, extra=None, digits=17):
    """CSV in the measurement format, I and Q [V]."""
    columns = {"f [Hz]": frequency}
    for i, a in enumerate("xy"):
        columns[f"V{a}_I [V]"], columns[f"V{a}_Q [V]"] = phasors[:, i].real, phasors[:, i].imag
    write(path, {**(extra or {}), **columns}, digits)


def write(path, columns, digits=17):
    rows = np.column_stack([np.broadcast_to(c, np.shape(columns["f [Hz]"])) for c in columns.values()])
    lines = [",".join(columns), *(",".join(f"{v:.{digits}g}" for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")


WIDE = np.linspace(8004.3, 8045.3, 1001)
NARROW = np.linspace(8009.3, 8019.3, 1001)
RAW = (1e-3, 3.0)
FILTERED = (1e-3 / 165, 3.0 / 165)

__all__ = ["FILTERED", "NARROW", "RAW", "WIDE", "Gyro", "Instrument", "chirped", "noisy", "record", "replace", "steady"]
