"""Damping that changes at once: a leak, a particle, a valve."""

import numpy as np
from jaxtyping import Array

from memsgyro_jax.base.arguments import number
from memsgyro_jax.base.linalg import product

from .base import ForceEffect, Moment, Scalar, strength
from .scan import Coverage, Scanned


class DampingStep(Scanned, ForceEffect):
    """All dampings times 1 + s from `time` [s] to the end of the record number `record`, s above −1. Zero: damping
    stays.

    Shows as an amplitude and a phase that move to another level within a record. `time` and `record` are scanned: the
    likelihood is not smooth in them.

    Candler et al., "Long-term and accelerated life testing of a novel single-wafer vacuum encapsulation for MEMS
    resonators", J. Microelectromech. Syst. 15 (2006) 1446.
    """

    name, unit, law = "damping_step", "1", "all dampings · (1 + s) after time t0 of one record"
    reference = "Candler et al., J. Microelectromech. Syst. 15 (2006) 1446"
    scanned = ("record", "time")
    strength: Scalar = strength(low=-1.0)
    time: Scalar = number("s", default=0.0)
    record: Scalar = number("1", default=0.0)

    def force(self, now: Moment) -> Array:
        since = (now.time >= self.time) & (now.record == self.record)
        device = now.device
        return -self.strength * since * product(device.damping_matrix, now.velocity) / device.mobility

    def grid(self, coverage: Coverage) -> "tuple[DampingStep, ...]":
        """Twenty-three moments inside each record that has a clock."""
        moments = np.arange(1, 24) / 24
        return tuple(
            DampingStep(self.strength, time=float(part * duration), record=float(number))
            for number, duration in enumerate(coverage.durations)
            for part in moments
            if duration > 0
        )
