"""Classic control by linear algebra: the sampled periodic steady state, transfer functions and stability, in NumPy.

In phasors of the sample the loop is linear at a fixed drive frequency: the plant under held force by the matrix
exponential, the tracking demodulator and the integrals by their z-transforms, both sidebands and both images apart.
"""

import numpy as np
from scipy import linalg, optimize, signal


class Plant:
    """Mass-normalised matrices of a one-mass or two-mass gyro at a rate."""

    def __init__(self, gyro, rate=0.0):
        two = hasattr(gyro, "mass_x")
        mx, my = (float(gyro.mass_x), float(gyro.mass_y)) if two else (float(gyro.mass),) * 2
        kyx = gyro.kyx if two else gyro.kxy
        dxy = 0.0 if two else float(gyro.dxy)
        dyx = 0.0 if two else dxy + float(gyro.cross_damping_asymmetry)
        share = my / mx if two else 1.0
        self.k = np.array([[gyro.kxx / mx, gyro.kxy / mx], [kyx / my, gyro.kyy / my]], float)
        self.d = np.array([[gyro.dxx / mx, dxy / mx - 2 * share * rate], [dyx / my + 2 * rate, gyro.dyy / my]], float)
        self.gain = np.array([1 / mx, 1 / my])

    def sampled(self, period):
        """Transition of (x, y, vx, vy) and what held forces add."""
        a = np.zeros((6, 6))
        a[:2, 2:4], a[2:4, :2], a[2:4, 2:4], a[2:4, 4:] = np.eye(2), -self.k, -self.d, np.diag(self.gain)
        e = linalg.expm(a * period)
        return e[:4, :4], e[:4, 4:]

    def sense(self, omega):
        """Dynamic stiffness of y."""
        return self.k[1, 1] - omega**2 + 1j * omega * self.d[1, 1]


def hold(omega, period):
    """Of a force that is raised by what holding takes away, evaluated half a sample ahead."""
    half = 0.5 * omega * period
    return half / np.sin(half) * np.exp(1j * half)


def steady(gyro, rate, period, amplitude, conversion, nulled, near, velocity):
    """(frequency in Hz, drive force, rate, quadrature) where x = A cos φ and the force is -F sin φ; y free or nulled.

    Where the read-out is of `velocity`, the displacement is that over jω: held forces make the samples of both differ.
    """
    transition, push = Plant(gyro, rate).sampled(period)

    def response(omega):
        solved = np.linalg.solve(np.exp(1j * omega * period) * np.eye(4) - transition, push * hold(omega, period))
        solved = solved[2:] / (1j * omega) if velocity else solved[:2]
        forces = np.array([1j, 0.0])
        if nulled:
            forces[1] = -solved[1, 0] * 1j / solved[1, 1]
        return solved @ forces, forces

    def lead(omega):
        (x, _), _ = response(omega)
        return x.imag / abs(x)

    near = 2 * np.pi * near
    omega = optimize.brentq(lead, 0.999 * near, 1.001 * near, xtol=1e-12 * near, rtol=1e-15)
    (x, y), forces = response(omega)
    force = amplitude / abs(x)
    per_rate = 2j * near * amplitude / Plant(gyro).gain[1]
    found = force * (forces[1] / per_rate if nulled else y * conversion)
    return omega / (2 * np.pi), force, found.real, -found.imag


def demodulated(zeta, turn, share):
    """z-transform of the tracked phasor (in the stationary frame) per volt."""
    loop = turn / (zeta - turn) + turn.conjugate() / (zeta - turn.conjugate()) + 1.0 / (zeta - 1.0)
    return 2.0 * share * zeta / (zeta - turn) / (1.0 + share * loop)


def rate_response(gyro, omega, period, control, frequency):
    """Phasor of the rate given out per rate at `frequency` [Hz], of a design without quadrature and cross damping.

    The rate is held over a sample.
    """
    total = 0.0
    for delta in (2 * np.pi * frequency, -2 * np.pi * frequency):
        found = _sideband(gyro, omega, period, control, delta)
        total = total + 0.5 * (found if delta >= 0 else np.conj(found))
    return total * np.sinc(frequency * period)


def _sideband(gyro, omega, period, control, delta):
    plant, sense = Plant(gyro), control.sense
    amplitude, share = float(control.drive.amplitude), 2 * np.pi * float(sense.demodulator.bandwidth) * period
    conversion = complex(*map(float, sense.balanced))
    turn, zeta = np.exp(1j * omega * period), np.exp(1j * (omega + delta) * period)
    coriolis = -2j * omega * amplitude / plant.sense(omega + delta)  # y per rate, as a phasor of the upper sideband
    upper, lower = demodulated(zeta, turn, share), demodulated(zeta.conjugate(), turn, share)
    if not hasattr(sense, "gain"):
        return 0.5 * upper * coriolis * conversion
    transition, push = plant.sampled(period)
    per_force = np.linalg.solve(zeta * np.eye(4) - transition, push[:, 1])[1]

    def law(z):
        controller = float(sense.gain) + float(sense.integral) * period * z / (z - turn)
        return conversion * controller

    force = 1j * float(sense.force_per_rate) * hold(omega, period)
    # A force is the real part of its phasor, so that both images of y come back at the sideband.
    back = 0.5 * (force * law(zeta) * upper + np.conj(force * law(zeta.conjugate()) * lower))
    y = coriolis / (1.0 - per_force * back)
    return 0.5 * upper * law(zeta) * y


def _sampled_axis(gyro, omega, period, sense):
    """The sense axis under its loops, (y, vy), the constant, the tracked and the summed phasor in the stationary frame,
    over a sample; and the two rows whose product with it is the phasor given out."""
    transition, push = Plant(gyro).sampled(period)
    transition, push = transition[1::2, 1::2], push[1::2, 1]  # y alone: the axes must not couple
    share, turn = 2 * np.pi * float(sense.demodulator.bandwidth) * period, np.exp(1j * omega * period)
    conversion, shut = complex(*map(float, sense.balanced)), hasattr(sense, "gain")
    gain, integral = (float(sense.gain), float(sense.integral)) if shut else (1.0, 0.0)
    force = 1j * float(sense.force_per_rate) * hold(omega, period) if shut else 0.0

    def step(state):
        y, constant = state[:2], state[2]
        tracked, summed = complex(*state[3:5]), complex(*state[5:])
        y = transition @ y + push * (force * (summed + gain * conversion * tracked)).real
        tracked, summed = turn * tracked, turn * summed
        missed = y[0] - tracked.real - constant
        tracked = tracked + 2 * share * missed
        summed = summed + integral * period * conversion * tracked
        return [*y, constant + share * missed, tracked.real, tracked.imag, summed.real, summed.imag]

    given = np.array([0.0, 0.0, 0.0, gain * conversion, 1j * gain * conversion, 1.0, 1j])
    return np.array([step(column) for column in np.eye(7)]).T, given


def rebalance_growth(gyro, omega, period, sense):
    """Greatest size of an eigenvalue of the sampled rebalance loop, the drive turning with `omega`."""
    return np.abs(np.linalg.eigvals(_sampled_axis(gyro, omega, period, sense)[0])).max()


def step_response(gyro, omega, period, control, count):
    """The rate given out over `count` samples after a step of the rate, over it, without what turns at twice the drive:
    the step response of `rate_response`, as of a linear system in phasors that turn with the drive (scipy).
    """
    plant, matrix = Plant(gyro), np.zeros((3, 3), complex)
    matrix[:2, :2] = [[0.0, 1.0], [-plant.k[1, 1], -plant.d[1, 1]]]
    matrix[1, 2], matrix[2, 2] = -2j * omega * float(control.drive.amplitude), 1j * omega  # of vx, e^{jωt}
    pushed = np.zeros(7, complex)
    pushed[:2] = linalg.expm(matrix * period)[:2, 2]
    axis, given = _sampled_axis(gyro, omega, period, control.sense)
    # The force enters y at the end of the sample, the demodulator sees it there: as `axis` sees a motion already moved.
    seen = axis @ np.linalg.solve(linalg.block_diag(plant.sampled(period)[0][1::2, 1::2], np.eye(5)), pushed)
    back = np.exp(-1j * omega * period)
    real = lambda z: np.block([[z.real, -z.imag], [z.imag, z.real]])  # noqa: E731  # scipy simulates real numbers
    moved, entering = back * axis, (back * seen)[:, None]
    given = 0.5 * given[None]
    system = [real(part) for part in (moved, entering, given @ moved, given @ entering)]
    steps = np.column_stack([np.ones(count), np.zeros(count)])
    return signal.dlsim(signal.dlti(*system), steps)[1][:, 0]


def margins(gyro, control):
    """Least |1 + L| of phase, amplitude, rate and quadrature on a grid, for axes that do not couple, averaged."""
    plant, drive, sense = Plant(gyro), control.drive, control.sense
    omega, pole, width = 2 * np.pi * np.array(
        [drive.frequency, drive.demodulator.bandwidth, sense.demodulator.bandwidth], float
    )  # fmt: skip
    decay, split = 0.5 * plant.d[0, 0], np.sqrt(plant.k[1, 1]) - omega
    fine = np.sinh(np.linspace(-14.0, 14.0, 20_000))
    s = 1j * np.concatenate(
        [0.01 * pole * fine, split + 0.5 * plant.d[1, 1] * fine, -split + 0.5 * plant.d[1, 1] * fine]
    )
    grow = plant.gain[0] / (2 * omega)

    def least(gain, integral, after):
        return np.abs(1.0 + (float(gain) + float(integral) / s) * after).min()

    swing = pole / (s + pole) / (s + decay)
    per_rate = -2j * omega * float(drive.amplitude)  # y times Δ per rate
    still = width / (s + width) * per_rate * complex(*map(float, sense.balanced)) / plant.sense(omega - 1j * s)
    return [
        least(drive.phase_gain, drive.phase_integral, swing),
        least(drive.force_gain, drive.force_integral, grow * swing),
        least(sense.gain, sense.integral, still),
        least(sense.quadrature_gain, sense.quadrature_integral, still),
    ]
