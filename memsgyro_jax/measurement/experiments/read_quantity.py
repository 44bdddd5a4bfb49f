"""What the read-out of a capture shows of the motion: displacement, velocity or acceleration."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..declared import QUANTITIES, Declared
from ..phasor_fit import misfit
from .hold import FEWEST, is_far_nearer


if TYPE_CHECKING:
    from .record import AbstractRecord


def better_quantity(record: "AbstractRecord", declared: Declared) -> tuple[str, str]:
    """Another quantity of the read-out, where the rows of a record lie far nearer to a device then, whichever way its
    force ran, and a sentence on it; both empty where none is.

    A read-out that is late by a quarter of a period at resonance looks the same: that much is for people to know.
    """
    left, size = {}, 0
    for order, quantity in enumerate(QUANTITIES):
        shown: Any = replace(declared, readout=replace(declared.readout, order=order))
        phasors = replace(record, **record.better_keys(shown)[0]).starting_phasors(shown)
        if phasors is None or phasors.omega.size < FEWEST:
            return "", ""
        size = phasors.motion.size
        whole = float(np.sum(np.abs(phasors.weight[:, None] * phasors.motion) ** 2)) / (2.0 * size)
        left[quantity] = min(misfit(phasors), whole)  # no device is as good as none
    now, best = left[QUANTITIES[declared.readout.order]], min(left, key=lambda quantity: left[quantity])
    if not is_far_nearer(now, left[best], size):
        return "", ""
    times = f"{np.sqrt(now / left[best]):.2g} times nearer to a device"
    return best, f"its rows lie {times} where the read-out shows {best} (`quantity` of `[readout]`)"
