"""Sweeps of a gyro whose two axes both bend over, one up and one down, by several widths; no code of the package.

Each axis is followed along the branch of its own sweep, on to the other at a fold; a weak spring and a weak damper
couple the two to the first order.
"""

from pathlib import Path

import numpy as np


MASS, SCALE, NOISE = 3e-8, 2e5, 2e-4  # kg, V/m, V
NATURAL, QUALITY, CUBIC = (11.3e3, 11.6e3), (3000.0, 2500.0), (4.5e9, -6.0e9)  # Hz, 1, N/m³
COUPLING = 1e-4 * MASS * (2.0 * np.pi * NATURAL[0]) ** 2  # N/m
LEVELS = (50, 200, 700)  # nN
HEAD = """schema = "memsgyro-case/1"
name = "both bent"
device = "single_mass"
[design]
mass = { value = 3e-8, unit = "kg", tolerance = 0.1 }
frequency_x = { value = 11.3, unit = "kHz", tolerance = 0.05 }
frequency_y = { value = 11.6, unit = "kHz", tolerance = 0.05 }
[readout]
scale = { value = 0.2, unit = "V/um" }
"""
RECORD = """
[[experiment]]
name = "{axis}"
kind = "frequency_sweep"
file = "{axis}.csv"
drive_axis = "{axis}"
"""


def along(axis: int, frequency: np.ndarray, force: float) -> np.ndarray:
    """Displacement phasors [m] of one axis alone, upwards in frequency."""
    damping, before, found = MASS * 2.0 * np.pi * NATURAL[axis] / QUALITY[axis], None, []
    for omega in 2.0 * np.pi * frequency:
        away, bend = MASS * ((2.0 * np.pi * NATURAL[axis]) ** 2 - omega**2), 0.75 * CUBIC[axis]
        roots = np.roots([bend**2, 2.0 * away * bend, away**2 + (damping * omega) ** 2, -(force**2)])
        squares = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0.0)]
        before = squares.min() if before is None else squares[np.argmin(np.abs(squares - before))]
        found.append(force / (away + bend * before + 1j * damping * omega))
    return np.array(found)


def both_bent(folder: Path, levels: tuple[int, ...] = LEVELS, rows: int = 52) -> Path:
    """The case: each axis swept upwards at some drives [nN] through both resonances."""
    generator = np.random.default_rng(5)
    low, high = NATURAL
    frequency = np.concatenate([low + np.linspace(-25.0, 90.0, rows), high + np.linspace(-90.0, 25.0, rows)])
    omega = 2.0 * np.pi * frequency
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "case.toml").write_text(HEAD + "".join(RECORD.format(axis=axis) for axis in "xy"))
    for driven, axis in enumerate("xy"):
        lines = [f"F_{axis} [nN],f [Hz],Vx_I [V],Vx_Q [V],Vy_I [V],Vy_Q [V]"]
        for level in levels:
            motion = np.empty((2, len(frequency)), complex)
            motion[driven] = along(driven, frequency, 1e-9 * level)
            other, width = 1 - driven, MASS * 2.0 * np.pi * NATURAL[1 - driven] / QUALITY[1 - driven]
            still = MASS * ((2.0 * np.pi * NATURAL[other]) ** 2 - omega**2) + 1j * omega * width
            motion[other] = -COUPLING * motion[driven] / still
            noise = NOISE * generator.standard_normal((2, 2, len(frequency)))
            volts = SCALE * motion + noise[0] + 1j * noise[1]
            columns = [frequency, volts[0].real, volts[0].imag, volts[1].real, volts[1].imag]
            lines += [",".join([str(level), *(repr(float(v)) for v in row)]) for row in zip(*columns, strict=True)]
        (folder / f"{axis}.csv").write_text("\n".join(lines))
    return folder
