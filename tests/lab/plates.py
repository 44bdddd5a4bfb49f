"""Sweeps of a resonator between plates at several bias voltages and drives, on the branches of its first harmonic."""

from pathlib import Path

import numpy as np


F0, Q, MASS, CUBIC = 9000.0, 5000.0, 5e-9, 0.0  # Hz, 1, kg, N/m³
PLATES, GAP = 8.854e-12 * 2e-9, 2e-6  # F·m, m
SOFTENS, BENDS = 2.0 * PLATES / GAP**3, 4.0 * PLATES / GAP**5  # by each V²: N/m, N/m³; one plate on each side
FORCE, SCALE, NOISE = 1.8e-9, 2e4, 2e-5  # N by V of bias and V of drive, V by m and V of bias, V
BIASES, LEVELS = (5.0, 10.0, 15.0), (2, 6, 16)  # V, mV
CASE = """schema = "memsgyro-case/1"
name = "plates"
device = "resonator"
[readout]
quantity = "displacement"
[environment]
bias_voltage = { value = 5, unit = "V" }
[design]
[[experiment]]
name = "sweeps"
kind = "frequency_sweep"
file = "sweeps.csv"
settled = true
"""


def response(frequency: np.ndarray, bias: float, drive: float, cubic: float) -> np.ndarray:
    """Phasors [V] at a bias and a drive [V], each on the branch of the row before."""
    stiffness = MASS * (2.0 * np.pi * F0) ** 2 - SOFTENS * bias**2
    bend, force, before, found = 0.75 * (cubic - BENDS * bias**2), FORCE * bias * drive, 0.0, []
    for omega in 2.0 * np.pi * frequency:
        away, lost = stiffness - MASS * omega**2, 2.0 * np.pi * F0 * MASS / Q * omega
        roots = np.roots([bend**2, 2.0 * away * bend, away**2 + lost**2, -(force**2)])
        squares = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0.0)]
        before = squares[np.argmin(np.abs(squares - before))]
        found.append(force / (away + bend * before + 1j * lost))
    return SCALE * bias * np.array(found)


def plates(folder: Path, rows: int, biases=BIASES, levels=LEVELS, cubic: float = CUBIC) -> Path:
    """A case of one record that holds a sweep upwards at each bias and each level."""
    generator, lines = np.random.default_rng(5), ["V_bias [V],F_x [mV],f [Hz],Vx_I [V],Vx_Q [V]"]
    for bias in biases:
        resonance = np.sqrt(F0**2 - SOFTENS * bias**2 / MASS / (2.0 * np.pi) ** 2)
        frequency = np.round(resonance + np.linspace(-12.0, 12.0, rows), 2)
        for level in levels:
            volts = response(frequency, bias, 1e-3 * level, cubic)
            volts = volts + NOISE * (generator.standard_normal(rows) + 1j * generator.standard_normal(rows))
            lines += [
                f"{bias},{level},{f!r},{v.real!r},{v.imag!r}"
                for f, v in zip(frequency.tolist(), volts.tolist(), strict=True)
            ]
    (folder / "sweeps.csv").write_text("\n".join(lines))
    (folder / "case.toml").write_text(CASE)
    return folder
