"""Sweeps of one axis driven hard, as a lock-in's files: upwards along a resonance that bends beyond the band."""

from pathlib import Path

import numpy as np


F0, Q, MASS, CUBIC = 23417.6, 3100.0, 3.2e-9, 6.5e12  # Hz, 1, kg, N/m³
SCALE, FORCE = 1.8e5, 2.4e-7  # V/m, N/V
PHASE, BACKGROUND, NOISE = -0.06, 3e-5 + 2e-5j, 3e-5  # rad, V/V, V
DWELL = 4.0  # s from row to row
CASE = """schema = "memsgyro-case/1"
name = "bent"
device = "resonator"
[readout]
quantity = "displacement"
scale = { value = 0.18, unit = "V/um", tolerance = 0.05 }
[drive]
unit = "V"
scale = { value = 0.24, unit = "uN/V", tolerance = 0.1 }
[design]
mass = { value = 3.2e-9, unit = "kg", tolerance = 0.1 }
resonance = { value = 23.4, unit = "kHz", tolerance = 0.005 }
"""
RECORD = """[[experiment]]
name = "at_{level}mV"
kind = "frequency_sweep"
file = "at_{level}mV.csv"
settled = true
drive_force = {{ value = {level}, unit = "mV" }}
drive_axis = "x"
"""


def response(frequency: np.ndarray, force: float, shift: np.ndarray) -> np.ndarray:
    """Displacement phasors [m] of a Duffing resonator by its first harmonic, along the branch that a sweep follows; the
    linear resonance moves by `shift` of itself from row to row.
    """
    damping, before, found = MASS * 2.0 * np.pi * F0 / Q, None, []
    for omega, natural in zip(2.0 * np.pi * frequency, 2.0 * np.pi * F0 * (1.0 + shift), strict=True):
        stiffness = MASS * natural**2
        away, bend, lost = stiffness - MASS * omega**2, 0.75 * CUBIC, damping * omega
        roots = np.roots([bend**2, 2.0 * away * bend, away**2 + lost**2, -(force**2)])
        squares = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0.0)]
        square = squares.min() if before is None else squares[np.argmin(np.abs(squares - before))]
        before = square
        found.append(force / (away + bend * square + 1j * lost))
    return np.array(found)


def bent_sweeps(
    folder: Path, levels: tuple[int, ...], rows: int = 161, phase: float = PHASE, delay: float = 0.0,
    drift: float = 0.0,
) -> Path:  # fmt: skip
    """A case of one sweep in a file at each drive level in mV, the strongest first, read late by `delay` [s]; with a
    `drift` [1/s] of the resonance, relative, they follow each other in time as their levels do.
    """
    clock = DWELL * np.arange(rows)
    generator, frequency = np.random.default_rng(77), F0 + np.linspace(-40.0, 60.0, rows)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "case.toml").write_text(CASE + "".join(RECORD.format(level=level) for level in sorted(levels)[::-1]))
    for level in levels:
        turn = np.exp(1j * (phase - 2.0 * np.pi * frequency * delay))
        volts = SCALE * response(frequency, FORCE * 1e-3 * level, drift * clock) * turn + BACKGROUND * 1e-3 * level
        volts = volts + NOISE * (generator.standard_normal(rows) + 1j * generator.standard_normal(rows))
        columns = {"f [Hz]": frequency, "Vx_I [V]": volts.real, "Vx_Q [V]": volts.imag}
        columns |= {"t [s]": clock} if drift else {}
        lines = [
            ",".join(map(repr, row)) for row in zip(*(column.tolist() for column in columns.values()), strict=True)
        ]
        (folder / f"at_{level}mV.csv").write_text("\n".join([",".join(columns), *lines]))
        clock = clock + DWELL * (rows + 10)
    return folder


def add_soak(folder: Path, level: int, rows: int, shift: float) -> None:
    """Adds to such a case sweeps at 25 °C and at 65 °C, where the resonance has moved by `shift` of itself."""
    generator, frequency, lines = np.random.default_rng(78), F0 + np.linspace(-40.0, 60.0, rows), []
    for temperature, moved in ((25.0, 0.0), (65.0, shift)):
        seen = response(frequency, FORCE * 1e-3 * level, np.full(rows, moved)) * np.exp(1j * PHASE)
        volts = SCALE * seen + BACKGROUND * 1e-3 * level
        volts = volts + NOISE * (generator.standard_normal(rows) + 1j * generator.standard_normal(rows))
        rows_of = zip(frequency.tolist(), volts.tolist(), strict=True)
        lines += [f"{temperature},{f!r},{v.real!r},{v.imag!r}" for f, v in rows_of]
    (folder / "soak.csv").write_text("\n".join(["T [degC],f [Hz],Vx_I [V],Vx_Q [V]", *lines]))
    record = RECORD.format(level=level).replace(f"at_{level}mV", "soak")
    (folder / "case.toml").write_text((folder / "case.toml").read_text() + record)
