"""Whether all records of a case were written with one sign of phase and of voltage: each beside the others.

A device fitted to the phasors of the other records predicts those of one; where they fit much better once conjugated
(a lock-in that turns with e^{-iωt}) or negated (a channel or a drive with its wires exchanged), that is said.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from memsgyro_jax.device.normalised import NormalisedDevice

from .experiments.base import Phasors
from .phasor_fit import device_of_phasors


BETTER = 0.1  # of the squared misfit as labelled, which another reading must come to
WITHIN = 0.5  # of the squared reading, which its misfit must stay within
_READINGS: tuple[tuple[Callable[[Any], Any], str, str], ...] = (
    (lambda x: x, "", ""),
    (np.conj, "recorded with e^{-iωt}", '`convention = "exp(-iwt)"`'),
    (np.negative, "inverted (180°)", "`inverted = true`"),
    (
        lambda x: -np.conj(x),
        "recorded with e^{-iωt} and inverted (180°)",
        '`convention = "exp(-iwt)"` and `inverted = true`',
    ),
)


def disagreements(records: Sequence[tuple[str, Phasors | None]]) -> list[str]:
    """A sentence for each record, by name, whose phasors fit the others once another sign convention is assumed.

    Of two records that contradict each other the later one is named, as nobody knows which is right.
    """
    rows = [(name, one) for name, one in records if one is not None and not one.modulus and one.axis is None]
    found: list[str] = []
    agreed: list[Phasors] = []
    for name, one in rows:
        device = device_of_phasors(agreed) if agreed else None
        said = "" if device is None else _reads_as(device, one)
        if said:
            found.append(f"experiment `{name}` reads as if {said}")
        else:
            agreed.append(one)
    return found


def _reads_as(device: NormalisedDevice, one: Phasors) -> str:
    """What the phasors read as beside what the device would show; empty where they are as labelled or fit nothing."""
    wanted = predicted(device, one)
    channels = [k for k in range(wanted.shape[1]) if _strong(one, k)]
    names = [""] if wanted.shape[1] == 1 else ["channel x ", "channel y "]
    said = []
    for channel in channels:
        seen, want = (part[:, channel] * one.weight for part in (one.motion, wanted))
        errors = [share_left(turn(seen), want) for turn, _, _ in _READINGS]
        best = int(np.argmin(errors))
        if best and errors[best] < min(BETTER * errors[0], WITHIN):
            _, how, remedy = _READINGS[best]
            said.append(f"{names[channel]}{how}; if so, give it {remedy}")
    return ", ".join(said)


def _strong(one: Phasors, channel: int) -> bool:
    """Whether the channel carries a good part of the motion: a small response depends on couplings."""
    size = np.linalg.norm(one.motion, axis=0)
    return bool(size[channel] > 0.3 * size.max())


def share_left(seen: np.ndarray, want: np.ndarray) -> float:
    """Share of the squared reading that a positive multiple of the prediction leaves."""
    gain = max(float(np.real(np.vdot(want, seen)) / max(np.linalg.norm(want) ** 2, 1e-300)), 0.0)
    return float(np.linalg.norm(seen - gain * want) ** 2 / np.linalg.norm(seen) ** 2)


def predicted(device: NormalisedDevice, one: Phasors) -> np.ndarray:
    """The motion (n, axes) [m] that a device has under the forces of a record."""
    stiffness, damping = np.asarray(device.stiffness_matrix), np.asarray(device.damping_matrix)
    turn = 1j * one.omega[:, None, None]
    operator = stiffness + turn**2 * np.eye(len(stiffness)) + turn * damping
    return np.linalg.solve(operator, float(device.mobility) * one.force[..., None])[..., 0]
