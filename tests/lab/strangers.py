"""Physics and faults that no catalogue lists, sized for a device: each changes its largest sweep well beyond noise."""

from dataclasses import replace

import numpy as np
from lab.die import Hidden, Outside
from lab.protocol import Sweep


def strangers(device):
    """By name: what is hidden in the die, and the bench it is measured on."""
    die, bench = device.die, device.protocol
    sweep = next(e for e in bench.experiments if isinstance(e, Sweep))
    force = max(sweep.values)
    motion = force / (die.damping[0] * np.sqrt(die.kxx / die.mass))
    loss = die.damping[0] * np.sqrt(die.kxx / die.mass)  # N/m: of the same size as a spring that moves half a width
    width = loss / die.kxx  # relative
    outside = {
        "hysteresis": Outside(bouc_wen_x=0.3 * loss, bouc_wen_yield=0.3 * motion),
        "stop": Outside(stop_x=2.0 * loss, stop_gap=0.6 * motion),
        "relaxation": Outside(maxwell_x=2.0 * loss, maxwell_time=float(np.sqrt(die.mass / die.kxx))),
        "inner mode 1:2": _inner(2, 1.5 * loss / motion, width),
        "inner mode 1:3": _inner(3, 4.0 * loss / motion**2, width),
        "warming drive": Outside(drive_heating_x=0.03, drive_heating_force=force),
    }
    faults = {
        "phase jump": {"phase_jump": 0.03},
        "lost row": {"lost_row": True},
        "wandering resonance": {"wander": 0.1 * width},
    }
    found = {name: (Hidden(outside=strange), bench) for name, strange in outside.items()}
    return found | {
        name: (Hidden(), replace(bench, faults=replace(bench.faults, **fault))) for name, fault in faults.items()
    }


def _inner(order, strength, width):
    """A mode as wide as the one that drives it, a fifth of that width off the multiple."""
    ratio = order * (1 + 0.2 * width)
    return Outside(internal_x=strength, internal_order=order, internal_ratio=ratio, internal_quality=order / width)
