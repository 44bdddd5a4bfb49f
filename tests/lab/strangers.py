"""Physics and faults that no catalogue lists, sized for a device: each changes its largest sweep well beyond noise."""

from dataclasses import replace

import numpy as np
from lab.die import Hidden, Outside
from lab.protocol import Sweep


INNER_QUALITY = 1000.0


def strangers(device):
    """By name: what is hidden in the die, and the bench it is measured on."""
    die, bench = device.die, device.protocol
    sweep = next(e for e in bench.experiments if isinstance(e, Sweep))
    force = max(sweep.values)
    motion = force / (die.damping[0] * np.sqrt(die.kxx / die.mass))
    loss = die.damping[0] * np.sqrt(die.kxx / die.mass)  # N/m: of the same size as a spring that moves half a width
    steep = np.sqrt(loss / die.kxx / INNER_QUALITY)
    width = loss / die.kxx
    inner = {"internal_quality": INNER_QUALITY}
    outside = {
        "hysteresis": Outside(bouc_wen_x=0.3 * loss, bouc_wen_yield=0.3 * motion),
        "stop": Outside(stop_x=2.0 * loss, stop_gap=0.6 * motion),
        "relaxation": Outside(maxwell_x=2.0 * loss, maxwell_time=float(np.sqrt(die.mass / die.kxx))),
        "inner mode 1:2": Outside(internal_x=1.5 * steep * die.kxx / motion, internal_ratio=2 * (1 + 0.2 * width), **inner),
        "inner mode 1:3": Outside(
            internal_x=4.0 * steep * die.kxx / motion**2, internal_order=3, internal_ratio=3 * (1 + 0.2 * width), **inner
        ),
        "warming drive": Outside(drive_heating_x=0.03, drive_heating_force=force),
    }
    faults = {
        "phase jump": {"phase_jump": 0.03}, "lost row": {"lost_row": True}, "wandering resonance": {"wander": 0.1 * width},
    }  # fmt: skip
    found = {name: (Hidden(outside=strange), bench) for name, strange in outside.items()}
    return found | {
        name: (Hidden(), replace(bench, faults=replace(bench.faults, **fault))) for name, fault in faults.items()
    }
