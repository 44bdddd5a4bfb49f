"""Sweeps of a device of two axes, both channels read, as a lock-in saves them."""

import re

import numpy as np


FREQUENCY = np.linspace(7900.0, 8300.0, 81)
STIFFNESS = np.array([[8000.0**2, 4e5], [4e5, 8200.0**2]])
WIDTHS = np.array([[20.0, 0.0], [0.0, 25.0]])
PARTS = {"x": lambda z: z.real, "y": lambda z: z.imag, "r": abs, "theta": lambda z: np.angle(z, deg=True)}


def moved(axis, level=1.0):
    """(rows, 2) phasors of both channels while one axis is driven; all in cycles."""
    f = FREQUENCY[:, None, None]
    answer = np.linalg.inv(STIFFNESS - f**2 * np.eye(2) + 1j * f * WIDTHS)[:, :, "xy".index(axis)]
    noise = np.random.default_rng(3).normal(size=(2, *answer.shape))
    return 1e6 * level * answer + 1e-3 * (noise[0] + 1j * noise[1])


def wrote(path, axis, level=1.0, header="Frequency (Hz)\tX1 (V)\tY1 (V)\tX2 (V)\tY2 (V)", parts="xy", further=()):
    """A file as a lock-in saves it, with more columns of one number each."""
    z = moved(axis, level)
    columns = [FREQUENCY, *(PARTS[p](z[:, c]) for c in (0, 1) for p in re.findall("theta|.", parts))]
    columns += [np.full(len(z), number) for number in further]
    mark = "\t" if "\t" in header else ";"
    rows = (mark.join(f"{value:.9g}" for value in row) for row in np.column_stack(columns))
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def demodulator(path, number, z, frequency=FREQUENCY):
    """As LabOne's sweeper saves one demodulator of a lock-in: a row per field."""
    fields = {
        "frequency": frequency,
        "x": z.real,
        "y": z.imag,
        "r": abs(z),
        "phase": np.angle(z),
        "settling": 0 * z.real,
    }
    rows = [f"0;0;{len(frequency)};{name};" + ";".join(f"{v:.12g}" for v in row) for name, row in fields.items()]
    path = path / f"dev1234_demods_{number}_sample_00000.csv"
    path.write_text("\n".join(["chunk;timestamp;size;fieldname", *rows]) + "\n")
    return path
