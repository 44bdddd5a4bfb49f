"""What readings of a sweep stand for: temperatures without the noise of their thermometer, motion behind amplitudes."""

from collections.abc import Sequence

import numpy as np

from memsgyro_jax.base.text import spoken
from memsgyro_jax.device.normalised import NormalisedDevice

from .deviation import Known


_SLOW, _BENT = 12, 10.0  # rows of a sweep that show what scatters in it; F of a parabola that is clearly nearer


def steadied(values: np.ndarray, sweeps: Sequence[slice]) -> tuple[np.ndarray, float]:
    """Readings (n,) of something slow, a temperature, without what scatters from row to row in every sweep: their mean
    there, or a parabola where that is clearly nearer; and the standard deviation of what scatters, zero where nothing
    does.
    """
    out, squares, count = np.array(values, float), 0.0, 0
    for rows in sweeps:
        mine, place = out[rows], np.linspace(-1.0, 1.0, rows.stop - rows.start)
        if len(mine) < _SLOW or not np.ptp(mine) > 0:
            continue
        mean, bent = np.full(len(mine), mine.mean()), np.polyval(np.polyfit(place, mine, 2), place)
        left, less = np.sum((mine - mean) ** 2), np.sum((mine - bent) ** 2)
        course = bent if left - less > _BENT * less / (len(mine) - 3) else mean
        off, usual = mine - course, 2.0 - 6.0 / np.sqrt(len(mine))  # of white noise, three standard deviations below
        if np.mean(np.diff(off) ** 2) > usual * np.mean(off**2):  # else what is left runs smoothly
            out[rows], squares, count = course, squares + float(off @ off), count + len(mine)
    return out, float(np.sqrt(squares / count)) if count else 0.0


def motion_of_amplitudes(
    motion: np.ndarray, frequency: np.ndarray, drive: np.ndarray, axis: int, device: NormalisedDevice,
    sweeps: Sequence[slice],
) -> np.ndarray:  # fmt: skip
    """(n, axes) displacement phasors of a resonator of which amplitudes were read, with the phase at which the drive
    replaces what the damping takes, before or past the peak of each sweep.
    """
    size, mobility = np.abs(motion), float(device.mobility)
    taken = frequency * float(device.damping[axis]) * size[:, axis]
    lag = np.arcsin(np.minimum(1.0, taken / np.abs(mobility * drive)))
    for rows in sweeps:
        past = frequency[rows] > frequency[rows][np.argmax(size[rows, axis])]
        lag[rows] = np.where(past, np.pi - lag[rows], lag[rows])
    return size * (np.exp(-1j * lag) * np.sign(mobility))[:, None]


def scattered(file: object, thermometer: float) -> list[str]:
    """A sentence where a temperature was steadied; none where it was not."""
    said = f"column `T` scatters by {thermometer:.2g} K from row to row, as no device does"
    return [f"{file}: {said}: what it is on the whole was taken."] if thermometer else []


def varied(known: Sequence[Known], sweeps: Sequence[slice]) -> str:
    """What was varied from sweep to sweep of what is known of them, for a caption."""
    said = []
    for one in known:
        levels = [spoken(float(np.mean(one.values[rows])), one.unit, 3) for rows in sweeps] if one.set else []
        if len(levels := list(dict.fromkeys(levels))) > 1:
            said.append(f"; {one.name} {', '.join(levels)}")
    return "".join(said)
