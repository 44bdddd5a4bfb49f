"""Sweeps whose phase at resonance is +90°: a displacement with an inverted sign, or an acceleration.

Over a band the two differ by ω², which rows far from resonance show where nothing else adds to the response: one then
lies far nearer to a device than the other. A constant beside the response, as of a feedthrough, makes one of the other.
"""

from collections.abc import Sequence
from dataclasses import replace

from memsgyro_jax.base.text import listed

from .declared import QUANTITIES, Declared
from .experiments import AbstractRecord
from .experiments.hold import is_far_nearer
from .phasor_fit import device_of_phasors, misfit
from .records_apart import axis_driven_alone, seen_along


_OTHER = {0: 2, 2: 0}  # order of the read-out: that of which the response differs by ω² and the sign


def opposite_phase(records: Sequence[AbstractRecord], declared: Declared) -> tuple[list[str], str]:
    """Records of which the phase at resonance is the opposite of that of the declared quantity, by name, and the
    quantity that their rows show; empty where they do not tell.
    """
    names, now, then, size = [], 0.0, 0.0, 0
    other = _OTHER.get(declared.readout.order)
    for record in records if other is not None else ():
        each = [_left(record, declared, order) for order in (declared.readout.order, other)]
        if each[0] is None or each[1] is None or not each[0][0]:
            continue
        names.append(record.name)
        size += each[0][2]
        now, then = (total + one[1] * one[2] for total, one in zip((now, then), each, strict=True) if one is not None)
    if not names or other is None:
        return [], ""
    now, then = now / size, then / size
    if is_far_nearer(now, then, size):
        return names, QUANTITIES[other]
    return names, QUANTITIES[declared.readout.order] if is_far_nearer(then, now, size) else ""


def _left(record: AbstractRecord, declared: Declared, order: int) -> tuple[bool, float, int] | None:
    """Whether the phase of a sweep is the opposite of that of a read-out of some order, the squared misfit of a device,
    and of how many phasors; `None` for what is no sweep with a phase.
    """
    seen = replace(declared, readout=replace(declared.readout, order=order))
    whole = record.starting_phasors(seen) if hasattr(record, "sweeps") else None
    axis = None if whole is None or whole.modulus else axis_driven_alone(whole)
    if whole is None or axis is None:
        return None
    row = seen_along(whole, axis)
    device = device_of_phasors([row])
    return None if device is None else (float(device.mobility) < 0.0, misfit(row), row.motion.size)


def said_of_phase(records: Sequence[AbstractRecord], declared: Declared) -> list[str]:
    """The sentence of `check`: what they may read otherwise, or do, by their rows; none where these tell that the
    quantity is right, and the sign alone inverted.
    """
    names, shown = opposite_phase(records, declared)
    now, order = QUANTITIES[declared.readout.order], declared.readout.order
    if not names or shown == now:
        return []
    other, who = QUANTITIES[_OTHER[order]], f"experiment{'s' * (len(names) > 1)} {listed(names, '`')}"
    does, their = ("reads", "its") if len(names) == 1 else ("read", "their")
    key = f'`quantity = "{other}"` in `[readout]`'
    if shown:
        return [f"{who} {does} {other}, as {their} rows lie far nearer to a device then: {key} says it."]
    phase = "90°" if order == 0 else "-90°"
    said = f"{who} {does} {now} with an inverted sign, or {other}: at resonance the phase is about {phase}"
    return [f"{said}, and the rows do not tell which; {key}, or `inverted = true` of the experiment, says it."]
