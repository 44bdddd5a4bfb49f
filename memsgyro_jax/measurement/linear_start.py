"""A start for the fit of a linear device that needs no guess: its equation of motion is linear in its parameters.

Every phasor obeys (K − ω² + iωD)·X = σ·F. Least squares on this equation, weighted with the response it implies
(Sanathanan and Koerner, IEEE Trans. Autom. Control 8 (1963) 56), lands near the optimum from any distance.
"""

import numpy as np

from memsgyro_jax.device.normalised import NormalisedDevice

from .case import Case
from .experiments import FreeDecayRecord


ROUNDS = 12
PAIRS = {1: ((0, 0),), 2: ((0, 0), (1, 1), (0, 1))}


def starting_device(case: Case) -> NormalisedDevice:
    """The linear device that explains the case's phasors best, in coordinates per mass.

    Where no record drives it in a known way, the device as designed.
    """
    offered = [record.starting_phasors(case) for record in case.records if record.role != "validation"]
    rows = [row for row in offered if row is not None]
    if not rows:
        return _as_heard(case)
    omega, motion, force, weight = (np.concatenate(part) for part in zip(*rows, strict=True))
    device = _solve(omega, motion, force, weight / omega**2)
    for _ in range(ROUNDS):
        device = _solve(omega, motion, force, weight * _response_weight(device, omega, motion.shape[1]))
    if not (np.all(np.linalg.eigvalsh(_matrix(device[0])) > 0) and np.all(np.diag(_matrix(device[1])) > 0)):
        return design_device(case)
    return NormalisedDevice(*device)


def _as_heard(case: Case) -> NormalisedDevice:
    """The device as designed, each axis at the frequency and damping of what vibrates most in its free decays."""
    device, heard = design_device(case), [r.free_modes(case) for r in case.records if isinstance(r, FreeDecayRecord)]
    stiffness, damping = np.array(device.stiffness), np.array(device.damping)
    for axis, modes in enumerate(zip(*heard, strict=True)):
        _, omega, decay = max(modes)
        stiffness[axis] = omega**2
        damping[axis] = 2.0 * decay if decay > 0.0 else damping[axis]
    if not np.all(np.linalg.eigvalsh(_matrix(stiffness)) > 0):
        return device
    return NormalisedDevice(stiffness, damping, device.mobility)


def design_device(case: Case) -> NormalisedDevice:
    """The device as designed."""
    d = {name: entry.value for name, entry in case.design.items()}
    if case.device == "resonator":
        w = d["resonance"]
        return NormalisedDevice(np.array([w**2]), np.array([w / d["quality_factor"]]), d["static_gain"] * w**2)
    m = d["mass"]
    stiffness = np.array([d["kxx"], d["kyy"], d["kxy"]]) / m
    return NormalisedDevice(stiffness, np.array([d["dxx"], d["dyy"], d["dxy"]]) / m, 1 / m)


def _response_weight(device, omega: np.ndarray, axes: int) -> np.ndarray:
    """Size of the displacement per equation error at each frequency."""
    turn = 1j * omega[:, None, None]
    operator = _matrix(device[0]) + turn**2 * np.eye(axes) + turn * _matrix(device[1])
    return np.linalg.norm(np.linalg.inv(operator), axis=(1, 2))


def _solve(omega, motion, force, weight) -> tuple[np.ndarray, np.ndarray, float]:
    """Weighted least squares for (stiffness, damping, mobility) per mass."""
    axes = motion.shape[1]
    pairs = PAIRS[axes]
    columns = np.zeros((omega.size, axes, 2 * len(pairs) + 1), complex)
    for place, (i, j) in enumerate(pairs):
        for row, column in {(i, j), (j, i)}:
            columns[:, row, place] = motion[:, column]
            columns[:, row, len(pairs) + place] = 1j * omega * motion[:, column]
    columns[:, :, -1] = -force
    target = omega[:, None] ** 2 * motion
    left = (columns * weight[:, None, None]).reshape(-1, columns.shape[-1])
    right = (target * weight[:, None]).ravel()
    left, right = np.concatenate([left.real, left.imag]), np.concatenate([right.real, right.imag])
    size = np.linalg.norm(left, axis=0)
    size = np.where(size > 0, size, 1.0)
    found = np.linalg.lstsq(left / size, right, rcond=1e-12)[0] / size
    return found[: len(pairs)], found[len(pairs) : -1], float(found[-1])


def _matrix(entries: np.ndarray) -> np.ndarray:
    if len(entries) == 1:
        return np.asarray(entries)[None]
    return np.array([[entries[0], entries[2]], [entries[2], entries[1]]])
