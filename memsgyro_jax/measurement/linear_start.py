"""Linear devices to start a fit from: as designed, or as the records show it."""

import numpy as np

from memsgyro_jax.device.normalised import NormalisedDevice

from .case import Case
from .declared import design_device as design_device
from .phasor_fit import device_of_phasors


def starting_device(case: Case) -> NormalisedDevice:
    """The linear device that explains the case's phasors best, in coordinates per mass.

    Where no record drives it in a known way, the device as designed.
    """
    offered = [record.starting_phasors(case) for record in case.records if record.role != "validation"]
    rows = [row for row in offered if row is not None]
    if not rows:
        return _as_heard(case)
    found = device_of_phasors(rows)
    return design_device(case) if found is None else found


def _as_heard(case: Case) -> NormalisedDevice:
    """The device as designed, each axis at the frequency and damping of what vibrates most in its free decays."""
    device, heard = design_device(case), [m for r in case.records if (m := r.free_modes(case)) is not None]
    stiffness, damping = np.array(device.stiffness), np.array(device.damping)
    for axis, modes in enumerate(zip(*heard, strict=True)):
        _, omega, decay = max(modes)
        stiffness[axis] = omega**2
        damping[axis] = 2.0 * decay if decay > 0.0 else damping[axis]
    moved = NormalisedDevice(stiffness, damping, device.mobility)
    return moved if np.all(np.linalg.eigvalsh(np.asarray(moved.stiffness_matrix)) > 0) else device
