"""What the read-out of a capture shows of the motion: displacement, velocity or acceleration."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..declared import QUANTITIES, Declared
from .hold import FEWEST, NearestHold, is_far_nearer


class ShownQuantity(NamedTuple):
    """Another quantity of the read-out and a sentence on it, both empty where none is, and a sentence on how the force
    ran where what is declared stays.
    """

    quantity: str = ""
    told: str = ""
    of_hold: str = ""

    @property
    def said(self) -> str:
        """The sentence to say: that on the quantity, where there is one."""
        return self.told or self.of_hold


def better_quantity(nearest_hold: Callable[[Declared], NearestHold], declared: Declared) -> ShownQuantity:
    """Another quantity of the read-out, where the rows of a record lie far nearer to a device then, whichever way its
    force ran, which `nearest_hold` tells.

    A read-out that is late by a quarter of a period at resonance looks the same: that much is for people to know.
    """
    left, size, of_hold = {}, 0, ""
    for order, quantity in enumerate(QUANTITIES):
        nearest = nearest_hold(replace(declared, readout=replace(declared.readout, order=order)))
        phasors = nearest.phasors
        if phasors is None or phasors.omega.size < FEWEST:
            return ShownQuantity(of_hold=nearest_hold(declared).told)
        size = phasors.motion.size
        whole = float(np.sum(np.abs(phasors.weight[:, None] * phasors.motion) ** 2)) / (2.0 * size)
        left[quantity] = min(nearest.misfit, whole)  # no device is as good as none
        of_hold = nearest.told if order == declared.readout.order else of_hold
    now, best = left[QUANTITIES[declared.readout.order]], min(left, key=lambda quantity: left[quantity])
    if not is_far_nearer(now, left[best], size):
        return ShownQuantity(of_hold=of_hold)
    times = f"{np.sqrt(now / left[best]):.2g} times nearer to a device"
    return ShownQuantity(
        best, f"its rows lie {times} where the read-out shows {best} (`quantity` of `[readout]`)", of_hold
    )
