"""Records of one device in one place that read too much or too little, or resonate elsewhere: each beside the others.

A device fitted to one record predicts the next but for a factor. Where the factor is not one although the width of the
resonance is the same, no law of the device makes it: a law that changes the peak changes the width.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from memsgyro_jax.base.text import listed, spoken
from memsgyro_jax.device.normalised import NormalisedDevice

from .experiments.base import Phasors
from .phasor_fit import device_of_phasors


_OFF = 0.2  # of a gain: more than levels and ranges are off by, and than a search lets them be
_ALIKE = 0.03  # of a gain, and of a width: the same
_CLEAR = 0.02  # of the squared reading, which a linear device of the record alone leaves at most
_COUPLED = 0.1  # the same along one axis of two: the other moves too
_MOVED = 0.5  # of a resonance's width
_FACTORS = {  # what readings are too large by, and why
    1 / np.sqrt(2.0): "as effective values beside amplitudes do",
    np.sqrt(2.0): "as amplitudes beside effective values do",
    2.0: "as values from peak to peak do",
    1e3: "as millivolts taken for volts do",
    1e-3: "as volts taken for millivolts do",
}


class _Told(NamedTuple):
    """A record, its device by itself, and the largest force."""

    name: str
    row: Phasors
    device: NormalisedDevice
    level: float


def out_of_line(records: Sequence[tuple[str, Phasors | None]]) -> list[str]:
    """A sentence for each record, by name, that reads so many times what most do at its drive, or resonates elsewhere
    than records at higher and at lower drives do: of those that were driven along one axis, each by its answer there.

    Args:
        records: of a device, in one place; those without phasors, or of another course along their axis than that of a
            linear device of one axis, are passed over.
    """
    told: dict[int, list[_Told]] = {}
    for name, row in records:
        axis = None if row is None else axis_driven_alone(row)
        if row is not None and axis is not None and (one := _told(name, row, axis)) is not None:
            told.setdefault(axis, []).append(one)
    return [sentence for axis in sorted(told) for sentence in _of_one_axis(told[axis])]


def axis_driven_alone(row: Phasors) -> int | None:
    """The one axis that is driven and read all the time; `None` where there is none."""
    driven = np.flatnonzero(np.any(row.force, axis=0))
    return int(driven[0]) if len(driven) == 1 and row.axis is None else None


def seen_along(row: Phasors, axis: int) -> Phasors:
    """What a record says of one axis."""
    return row._replace(motion=row.motion[:, [axis]], force=row.force[:, [axis]], beside=None)


def _of_one_axis(told: list[_Told]) -> list[str]:
    """The sentences of records along one axis."""
    if len(told) < 2:
        return []
    most = max(told, key=lambda one: sum(_is_shared(one, other) for other in told))
    group = [one for one in told if _is_shared(most, one)]
    said = [_said_of(one, group) for one in told if one not in group]
    return [sentence for sentence in said if sentence]


def _told(name: str, whole: Phasors, axis: int) -> _Told | None:
    """The record with its device along an axis; `None` where none shows it clearly."""
    row, most = seen_along(whole, axis), _CLEAR if whole.force.shape[1] == 1 else _COUPLED
    if row.modulus or row.slope is not None:
        return None
    device = device_of_phasors([row])
    if device is None or float(device.mobility) == 0.0 or not np.any(row.force):
        return None
    gain, left = _gain(device, row)
    return _Told(name, row, device, float(np.max(np.abs(row.force)))) if left < most and gain > 0.0 else None


def _gain(device: NormalisedDevice, row: Phasors) -> tuple[float, float]:
    """The factor by which a record reads what a device predicts, and the share of the square that it leaves."""
    stiffness, damping = float(device.stiffness[0]), float(device.damping[0])
    want = float(device.mobility) * row.force[:, 0] / (stiffness - row.omega**2 + 1j * row.omega * damping) * row.weight
    seen = row.motion[:, 0] * row.weight
    size, whole = float(np.linalg.norm(want)), float(np.linalg.norm(seen))
    gain = float(np.real(np.vdot(want, seen))) / max(size**2, 1e-300)
    return gain, (float(np.linalg.norm(seen - gain * want)) / max(whole, 1e-300)) ** 2


def _numbers(one: _Told) -> np.ndarray:
    """Resonance [rad/s], its width [rad/s] and the gain."""
    return np.array([np.sqrt(float(one.device.stiffness[0])), float(one.device.damping[0]), float(one.device.mobility)])


def _is_shared(one: _Told, other: _Told) -> bool:
    """Whether two records show one device."""
    (w, d, g), (omega, damping, gain) = _numbers(one), _numbers(other)
    return abs(omega - w) < _MOVED * d and abs(damping / d - 1.0) < _OFF and abs(gain / g - 1.0) < _OFF


def _said_of(one: _Told, group: list[_Told]) -> str:
    """What sets a record apart from those that agree; empty for what a law of the device may be."""
    omega, damping, gain = _numbers(one)
    w, d, g = np.median([_numbers(other) for other in group], axis=0)
    others = listed([other.name for other in group], "`")
    if abs(damping / d - 1.0) > _ALIKE + 0.1 * abs(np.log(abs(gain / g))):
        return ""
    moved, scaled = abs(omega - w) > _MOVED * d, gain / g
    if scaled <= 0.0:  # of a sign that is wrong the signs tell
        return ""
    if not moved and abs(scaled - 1.0) >= _OFF:
        why = next((f", {words}" for f, words in _FACTORS.items() if abs(scaled / f - 1.0) < _ALIKE), "")
        times, does = f"{float(f'{scaled:.3g}'):g}", "do" if group[1:] else "does"
        return (
            f"experiment `{one.name}` reads {times} times what {others} {does} at the drive that it declares{why}: "
            "its drive level, or the range or unit of its readings, is not as declared"
        )
    levels = [other.level for other in group]
    if moved and abs(scaled - 1.0) < _OFF and min(levels) <= one.level <= max(levels):
        hertz, usual = (spoken(value / (2 * np.pi), "Hz", 8) for value in (omega, w))
        return (
            f"experiment `{one.name}` resonates at {hertz}, where {others} at lower and at higher drives "
            f"resonate at {usual}: was it taken at another temperature or bias voltage, or on another day?"
        )
    return ""
