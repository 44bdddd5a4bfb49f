"""What the rows of a record, its declarations and the design must say of each other, whatever the kind."""

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table


_TWO_PI = 2 * np.pi
_REACH = 2.0  # factor around the design's resonances within which a frequency is believed
_EXCHANGED = 3.0  # times the driven channel: more than a coupling within a design's tolerances makes


def near_resonance(low: float, high: float, resonances: tuple[float, float]) -> None:
    """Refuses a band [rad/s] that lies beyond any resonance of the design: a wrong unit, most likely."""
    if high * _REACH < resonances[0] or low > _REACH * resonances[1]:
        expected = f"{resonances[0] / _TWO_PI:.6g} and {resonances[1] / _TWO_PI:.6g} Hz"
        shown = f"{low / _TWO_PI:.6g}" if low == high else f"{low / _TWO_PI:.6g} to {high / _TWO_PI:.6g}"
        raise InputError(
            f"must come within a factor of {_REACH:g} of a resonance, which the design puts between "
            f"{expected}, but is {shown} Hz (is the unit right?)"
        )


def check_sampling(period: float, rows: int, resonances: tuple[float, float], table: Table) -> None:
    """Refuses samples too far apart, or a record too short, for a resonance of the design [rad/s]: a wrong unit."""
    slowest, rate = resonances[0] / _TWO_PI, 1 / period
    if rate < 2 * slowest:
        raise InputError(
            f"{table.path}, column `t`: the sampling must be faster than twice the resonance, which the design puts at "
            f"{slowest:.6g} Hz or above, but is at {rate:.6g} Hz; is the unit right?"
        )
    if rows * period * resonances[1] / _TWO_PI < 1:
        raise InputError(
            f"{table.path}, column `t`: the record must last for a cycle of the resonance, which the design puts at "
            f"{resonances[1] / _TWO_PI:.6g} Hz or below, but lasts {rows * period:.3g} s; is the unit right?"
        )


def exchanged(file: str, axis: int, readings: np.ndarray) -> list[str]:
    """A sentence where the electrode at rest moves much more than the driven one."""
    if readings.shape[1] < 2:
        return []
    peaks = np.max(np.abs(readings - readings.mean(axis=0)), axis=0)
    driven, other = peaks[axis], peaks[1 - axis]
    if other <= _EXCHANGED * driven:
        return []
    sentence = (
        f"{file}: axis {'xy'[axis]} is driven, but the other reads {other / driven:.0f} times as much; "
        "are the channels and `drive_axis` as labelled?"
    )
    return [sentence]
