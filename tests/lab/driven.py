"""A hardening resonator of one axis on a lock-in, by the balance of its first harmonic; no code of the package.

The reference of the lock-in is turned and late, and what the drive couples into the read-out has a phase of its own.
"""

import numpy as np


RESONANCE, QUALITY, MASS, CUBIC = 2 * np.pi * 41.3e3, 8000.0, 2.4e-9, 2.2e13
PICK_OFF, ELECTRODE = 0.31e6, 1.6e-9  # V/m, N/V
PHASE, DELAY, COUPLING, NOISE = 0.03, 0.4e-6, 2e-5 + 1e-5j, 6e-7
LEVELS = (0.05, 0.2, 0.5)  # V


def displacement(force, omega, upwards):
    """Phasors [m] of a slow sweep, on the branch that it follows."""
    bend, width = 0.75 * CUBIC / MASS, RESONANCE * omega / QUALITY
    found, before = np.zeros(len(omega), complex), 0.0
    for k in range(len(omega)) if upwards else reversed(range(len(omega))):
        apart = RESONANCE**2 - omega[k] ** 2
        squares = np.roots([bend**2, 2 * apart * bend, apart**2 + width[k] ** 2, -((force / MASS) ** 2)])
        real = squares[np.abs(squares.imag) < 1e-9 * np.abs(squares).max()].real
        before = real[np.argmin(np.abs(real - before))]
        found[k] = force / MASS / (apart + bend * before + 1j * width[k])
    return found


def phasors(level, frequency, upwards, rng):
    """Readings [V] at one drive [V]."""
    omega = 2 * np.pi * frequency
    seen = PICK_OFF * displacement(ELECTRODE * level, omega, upwards) + COUPLING * level
    noise = rng.normal(0.0, NOISE, (2, len(frequency)))
    return seen * np.exp(-1j * (PHASE + omega * DELAY)) + noise[0] + 1j * noise[1]


def write(folder, rows=31, seed=0):
    """The case: every level swept up and down, the noise declared."""
    rng, sections = np.random.default_rng(seed), []
    frequency = np.linspace(41275.0, 41335.0, rows)
    for level in LEVELS:
        for way in ("up", "down"):
            name = f"{way}_{1e3 * level:.0f}mV"
            seen = phasors(level, frequency, way == "up", rng)
            table = np.column_stack([frequency, seen.real, seen.imag])[:: 1 if way == "up" else -1]
            header = "f [Hz],Vx_I [V],Vx_Q [V]"
            np.savetxt(folder / f"{name}.csv", table, "%.12g", ",", header=header, comments="")
            sections.append(
                f'[[experiment]]\nname = "{name}"\nkind = "frequency_sweep"\nfile = "{name}.csv"\nsettled = true\n'
                f'drive_axis = "x"\ndrive_force = "{level} V"\nnoise_std = "{NOISE} V"\n'
            )
    (folder / "case.toml").write_text(_HEAD + "\n".join(sections))
    return folder


_HEAD = """schema = "memsgyro-case/1"
name = "driven"
device = "resonator"

[readout]
scale = { value = 0.31, unit = "V/um", tolerance = 0.03 }

[design]
mass = { value = 2.4e-9, unit = "kg", tolerance = 0.05 }
resonance = { value = 41.3, unit = "kHz", tolerance = 0.01 }
quality_factor = { value = 8000, unit = "1", tolerance = 0.3 }

[drive]
unit = "V"
scale = { value = 1.6, unit = "nN/V", tolerance = 0.05 }

"""
