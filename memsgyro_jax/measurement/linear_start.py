"""Linear devices to start a fit from: as designed, or as the records show it."""

from collections.abc import Iterable

import numpy as np

from memsgyro_jax.device.normalised import NormalisedDevice

from .case import AbstractRecord, Case
from .declared import design_device as design_device
from .experiments.base import Phasors
from .one_place import in_one_place
from .phasor_fit import device_of_phasors, is_shared, most_linear


def starting_device(case: Case) -> NormalisedDevice:
    """The linear device that explains the case's phasors best, in coordinates per mass.

    Where no record drives it in a known way, the device as designed.
    """
    fitted = [record for record in case.records if record.role != "validation"]
    rows = _offered(case, fitted)
    if not rows:
        return _as_heard(case, in_one_place(case.environment, case.records))
    device = _of_rows(case, rows)
    if not is_shared(device, rows):  # as where the surroundings move it
        rows = _offered(case, in_one_place(case.environment, fitted))
        device = _of_rows(case, rows)
    return device if (calm := most_linear(rows, device)) is rows else _of_rows(case, calm)


def _offered(case: Case, records: Iterable[AbstractRecord]) -> list[Phasors]:
    return [row for row in (record.starting_phasors(case) for record in records) if row is not None]


def _of_rows(case: Case, rows: list[Phasors]) -> NormalisedDevice:
    whole = [row for row in rows if row.axis is None]
    found = device_of_phasors(whole) if whole else None
    device = design_device(case) if found is None else found
    for axis in sorted({row.axis for row in rows if row.axis is not None}):
        if not any(np.any(row.force[:, axis]) for row in whole):
            device = _with_axis(device, axis, [row for row in rows if row.axis == axis], found is None)
    return device


def _with_axis(device: NormalisedDevice, axis: int, rows: list[Phasors], gain: bool) -> NormalisedDevice:
    """The device with one axis, and its gain, as phasors of that axis alone show it."""
    seen = device_of_phasors(rows)
    if seen is None:
        return device
    stiffness, damping = np.array(device.stiffness), np.array(device.damping)
    stiffness[axis], damping[axis] = float(seen.stiffness[0]), float(seen.damping[0])
    mobility = abs(float(seen.mobility)) if gain else device.mobility
    moved = NormalisedDevice(stiffness, damping, mobility)
    return moved if moved.is_held else device


def _as_heard(case: Case, records: Iterable[AbstractRecord]) -> NormalisedDevice:
    """The device as designed, each axis at the frequency and damping of what vibrates most in free decays."""
    device, heard = design_device(case), [m for r in records if (m := r.free_modes(case)) is not None]
    stiffness, damping = np.array(device.stiffness), np.array(device.damping)
    for axis, modes in enumerate(zip(*heard, strict=True)):
        _, omega, decay = max(modes)
        stiffness[axis] = omega**2
        damping[axis] = 2.0 * decay if decay > 0.0 else damping[axis]
    gain = device.mobility / device.stiffness[0]
    moved = NormalisedDevice(stiffness, damping, gain * stiffness[0] if case.holds_gain else device.mobility)
    return moved if moved.is_held else device
