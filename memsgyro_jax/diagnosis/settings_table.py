"""What the device is in each of its surroundings, as the records there show it by themselves: a table to print."""

import numpy as np

from memsgyro_jax.base.text import aligned
from memsgyro_jax.measurement.case import Case

from .settings_apart import in_each_place


DIGITS = 2  # of a resonance, beyond those of its width


def settings_table(case: Case) -> str:
    """Resonance, quality factor and gain, against the first, in each of several surroundings; empty where there are not
    several. What goes with temperature and bias voltage stands there whatever its law is.
    """
    every = sorted(in_each_place(case), key=lambda one: (one.axis, one.temperature, one.bias_voltage))
    if len({(one.temperature, one.bias_voltage) for one in every}) < 2:
        return ""
    warm = np.ptp([one.temperature for one in every]) > 0
    biased = np.ptp([one.bias_voltage for one in every]) > 0
    driven = not np.isnan([one.gain for one in every]).all()
    first = {one.axis: one for one in reversed(every)}
    gain = {one.axis: one.gain for one in reversed(every) if not np.isnan(one.gain)}
    rows = [("axis", "T [°C]", "V_bias [V]", "resonance [Hz]", "moved [ppm]", "quality factor", "gain")]
    for one in every:
        omega, start = np.sqrt(one.stiffness), np.sqrt(first[one.axis].stiffness)
        quality = omega / one.damping
        digits = max(0, int(np.ceil(np.log10(quality))) + DIGITS - int(np.ceil(np.log10(omega / (2 * np.pi)))))
        rows.append(
            (
                "xy"[one.axis],
                f"{round(one.temperature - 273.15, 3) + 0.0:.4g}",
                f"{one.bias_voltage:.4g}",
                f"{omega / (2 * np.pi):.{digits}f}",
                f"{1e6 * (omega / start - 1.0):+.4g}",
                f"{quality:.4g}",
                "-" if np.isnan(one.gain) else f"x {one.gain / gain[one.axis]:.4g}",
            )
        )
    kept = [k for k, shown in enumerate((case.channels > 1, warm, biased, True, True, True, driven)) if shown]
    return aligned([tuple(row[k] for k in kept) for row in rows])
