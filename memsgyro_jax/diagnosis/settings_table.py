"""What the device is in each of its surroundings, as the records there show it by themselves: a table to print."""

import numpy as np

from memsgyro_jax.base.text import aligned
from memsgyro_jax.measurement.case import Case

from .settings_apart import in_each_place


PARTS = 8  # of the rows of a setting, of which each is left out once
DIGITS = 2  # of a resonance, beyond those of its width


def settings_table(case: Case) -> str:
    """Resonance, quality factor and gain, against the first, of each axis by itself, which in a coupled device is no
    mode, in each of several surroundings; empty where there are not several. What goes with temperature and bias
    voltage stands there whatever its law is.
    """
    every = sorted(in_each_place(case), key=lambda one: (one.axis, one.temperature, one.bias_voltage))
    if len({(one.temperature, one.bias_voltage) for one in every}) < 2:
        return ""
    warm = np.ptp([one.temperature for one in every]) > 0
    biased = np.ptp([one.bias_voltage for one in every]) > 0
    driven = not np.isnan([one.gain for one in every]).all()
    held = _uncertain(case)
    first = {one.axis: one for one in reversed(every)}
    gain = {one.axis: one.gain for one in reversed(every) if not np.isnan(one.gain)}
    rows = [("axis", "T [°C]", "V_bias [V]", "resonance [Hz]", "moved [ppm]", "quality factor", "gain")]
    for one in every:
        omega, start = np.sqrt(one.stiffness), np.sqrt(first[one.axis].stiffness)
        quality, moved = omega / one.damping, 1e6 * (omega / start - 1.0)
        std = held.get((one.axis, one.temperature, one.bias_voltage), np.zeros(3))
        digits = max(0, int(np.ceil(np.log10(quality))) + DIGITS - int(np.ceil(np.log10(omega / (2 * np.pi)))))
        rows.append(
            (
                "xy"[one.axis],
                f"{round(one.temperature - 273.15, 3) + 0.0:.4g}",
                f"{one.bias_voltage:.4g}",
                f"{omega / (2 * np.pi):.{digits}f}",
                _rounded(moved, 1e6 * std[0], "+"),
                _rounded(quality, quality * std[1], said=True),
                "-"
                if np.isnan(one.gain)
                else f"x {_rounded(one.gain / gain[one.axis], std[2] * (one.gain != gain[one.axis]))}",
            )
        )
    kept = [k for k, shown in enumerate((case.channels > 1, warm, biased, True, True, True, driven)) if shown]
    return aligned([tuple(row[k] for k in kept) for row in rows])


def _uncertain(case: Case) -> dict[tuple[int, float, float], np.ndarray]:
    """Standard deviations (3,) of resonance, quality factor and gain as shares of them, by axis and surroundings: how
    they move without one row of some each (jackknife). None where these do not tell.
    """
    found: dict[tuple[int, float, float], list[np.ndarray]] = {}
    for k in range(PARTS):
        for one in in_each_place(case, (k, PARTS)):
            omega = np.sqrt(one.stiffness)
            numbers = np.log(np.abs([omega, omega / one.damping, one.gain]))
            found.setdefault((one.axis, one.temperature, one.bias_voltage), []).append(numbers)
    return {key: np.sqrt((PARTS - 1) * np.var(some, axis=0)) for key, some in found.items() if len(some) == PARTS}


def _rounded(value: float, std: float, form: str = "", said: bool = False) -> str:
    """A number to the digit in which it is uncertain, four digits at most, with its ± where that is `said`."""
    if value == 0.0 or not std > 10.0 ** (np.floor(np.log10(abs(value))) - 3):
        return f"{value:{form}.4g}"
    place = int(np.floor(np.log10(std)))
    digits = f".{max(0, -place)}f"
    return f"{round(value, -place):{form}{digits}}" + (f" ± {round(std, -place):{digits}}" if said else "")
