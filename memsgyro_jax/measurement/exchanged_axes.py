"""Whether the channels or the drives of x and y were exchanged in some record of a device of two axes, or in all.

A device fitted to the records in which the driven axis moves more predicts the others; where one fits it much better
with its channels or its drives exchanged, that is said.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import listed

from .experiments.base import Phasors
from .phasor_fit import device_of_phasors
from .sign_conventions import BETTER, WITHIN, predicted, share_left


_MUCH = 3.0  # times the driven axis: more than a coupling within a design's tolerances makes


class _Reading(NamedTuple):
    """What may have been exchanged in a record, and what that is called."""

    channels: bool
    drives: bool
    words: str


_READINGS = (
    _Reading(False, False, ""),
    _Reading(True, False, "its channels x and y were exchanged (give the columns of each the other's name)"),
    _Reading(False, True, "the other axis was driven (`drive_axis`; `memsgyro import --axis`)"),
    _Reading(True, True, "x and y were exchanged in both its channels and its drive"),
)


def exchanged_axes(records: Sequence[tuple[str, Phasors | None]]) -> dict[str, str]:
    """By the name of each record that fits the others once x and y are exchanged in it, a sentence that says so."""
    told = [(name, one) for name, one in records if one is not None and _shows_both(one)]
    right = [one for _, one in told if not _other_moves(one)]
    device = device_of_phasors(right) if right else None
    if device is None:
        return {}
    found = {}
    for name, one in told:
        if not _other_moves(one):
            continue
        errors = [_misfit(predicted(device, _read_as(one, reading)), one, reading) for reading in _READINGS]
        best = int(np.argmin(errors))
        if best and errors[best] < min(BETTER * errors[0], WITHIN):
            found[name] = f"experiment `{name}` reads as if {_READINGS[best].words}"
    return found


def surely_exchanged(records: Sequence[tuple[str, Phasors | None]]) -> list[str]:
    """What `exchanged_axes` and `all_exchanged` say of sweeps that nothing else explains: those of all where each axis
    was driven in some, as near the resonance of the other one a device that is driven along one axis alone moves so.
    """
    swept = [(name, one) for name, one in records if one is not None and np.ptp(one.omega) > 0.0]
    axes = {_driven(one) for _, one in swept if _shows_both(one)}
    every = all_exchanged(swept) if len(axes) == 2 else ""
    return [*exchanged_axes(swept).values(), *([every] if every else [])]


def refuse(sentences: Sequence[str]) -> None:
    """**Raises:** `InputError` with what is wrong with some records, if anything is: what no device explains beside the
    others is not looked for among effects.
    """
    if said := "; ".join(sentences):
        rest = "put that right first, or leave it out: no device and no effect explains these records together"
        raise InputError(f"{said[0].upper()}{said[1:]}; {rest}.")


def all_exchanged(records: Sequence[tuple[str, Phasors | None]]) -> str:
    """A sentence where in all records of two axes, two or more, the axis moves that is not driven; else empty."""
    told = [(name, one) for name, one in records if one is not None and _shows_both(one)]
    if len(told) < 2 or not all(_other_moves(one) for _, one in told):
        return ""
    return (
        f"in {listed([name for name, _ in told], '`')} the axis moves that is not driven: x and y of the channels are "
        "exchanged, or of the drives (`drive_axis`; `memsgyro import --axis` gives each file its own)"
    )


def phasors_of_sweep(omega: np.ndarray, readings: np.ndarray, axis: int, drive: np.ndarray) -> Phasors:
    """Of a sweep of both channels (n, 2) at frequencies (n,) [rad/s] under the drive (n,) of one axis."""
    force = drive[:, None] * np.eye(2)[axis] + 0j
    return Phasors(omega, readings, force, np.full(len(omega), 1.0 / max(np.max(np.abs(readings)), 1e-300)))


def _shows_both(one: Phasors) -> bool:
    """Whether a record tells the steady motion of both axes under the drive of one."""
    if one.modulus or one.axis is not None or one.slope is not None or one.motion.shape[1] != 2:
        return False
    return int(np.count_nonzero(np.any(one.force, axis=0))) == 1


def _driven(one: Phasors) -> int:
    return int(np.argmax(np.any(one.force, axis=0)))


def _other_moves(one: Phasors) -> bool:
    driven = _driven(one)
    peaks = np.max(np.abs(one.motion - one.motion.mean(axis=0)), axis=0)
    return bool(peaks[1 - driven] > _MUCH * peaks[driven])


def _read_as(one: Phasors, reading: _Reading) -> Phasors:
    return one._replace(force=one.force[:, ::-1]) if reading.drives else one


def _misfit(want: np.ndarray, one: Phasors, reading: _Reading) -> float:
    """Share of the squared motion that a positive multiple of the prediction leaves."""
    seen = one.motion[:, ::-1] if reading.channels else one.motion
    return share_left((seen * one.weight[:, None]).ravel(), (want * one.weight[:, None]).ravel())
