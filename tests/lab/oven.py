"""A linear resonator of one axis in an oven that is off its set points; no code of the package.

Stiffness and damping go with the temperature that the device has, the files tell the one that was set.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np


RESONANCE, QUALITY, MASS = 2 * np.pi * 32768.0, 5000.0, 2e-9
STIFFER, DAMPED = -7e-5, 3e-3  # 1/K
HIGHEST, NOISE = 1.0, 1e-3  # V
REFERENCE, SET_POINTS = 25.0, (-30.0, 0.0, 25.0, 55.0, 85.0)  # degC
OFF = 0.1  # K

_HEAD = """schema = "memsgyro-case/1"
name = "oven"
device = "resonator"

[readout]
quantity = "displacement"

[environment]
temperature = "25 degC"

"""


def phasors(frequency: np.ndarray, warming: float, stiffer: float, damped: float) -> np.ndarray:
    """Readings [V], without noise, of a device that is so much warmer than the reference [K] and stiffer by a share."""
    omega, width = 2 * np.pi * frequency, RESONANCE / QUALITY
    push = RESONANCE**2 * (1 + stiffer) - omega**2 + 1j * omega * width * (1 + damped * warming)
    return HIGHEST * RESONANCE * width / push


def oven(
    folder: Path,
    *,
    seed: int = 0,
    off: float = OFF,
    declared: float | None = OFF,
    stiffer: float = STIFFER,
    damped: float = DAMPED,
    further: Callable[[float], float] = lambda warming: 0.0,
    set_points: Sequence[float] = SET_POINTS,
    judge: float | None = None,
    rows: int = 41,
) -> Path:
    """A case of a sweep at each set point [degC], off by `off` [K] (1 sigma), of which the case says `declared`.

    One of the set points may be the `judge`, which no fit sees. The stiffness gains `stiffer` of itself per kelvin, and
    what is `further` of the warming.
    """
    random, sections = np.random.default_rng(seed), []
    folder.mkdir(parents=True, exist_ok=True)
    for point in set_points:
        warming = point - REFERENCE + off * random.standard_normal()
        width = RESONANCE / QUALITY / (2 * np.pi)
        centre = RESONANCE / (2 * np.pi) * np.sqrt(1 + stiffer * (point - REFERENCE))
        frequency = np.round(centre, 1) + np.linspace(-5 * width, 5 * width, rows)
        seen = phasors(frequency, warming, stiffer * warming + further(warming), damped)
        seen = seen + NOISE * (random.standard_normal(rows) + 1j * random.standard_normal(rows))
        table = np.column_stack([frequency, np.full(rows, point), seen.real, seen.imag])
        name, header = f"at_{point:g}", "f [Hz],T [degC],Vx_I [V],Vx_Q [V]"
        np.savetxt(folder / f"{name}.csv", table, "%.12g", ",", header=header, comments="")
        role = "validation" if point == judge else "fit"
        sections.append(
            f'[[experiment]]\nname = "{name}"\nkind = "frequency_sweep"\nfile = "{name}.csv"\nsettled = true\n'
            f'drive_axis = "x"\nrole = "{role}"\nnoise_std = "{NOISE} V"\n'
            + (f'temperature_std = {{ value = {declared}, unit = "K" }}\n' if declared else "")
        )
    (folder / "case.toml").write_text(_HEAD + "\n".join(sections))
    return folder
