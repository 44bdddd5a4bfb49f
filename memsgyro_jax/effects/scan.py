"""What cannot be found by a gradient: fields that must be tried on a grid, because the likelihood is not smooth or not
informative there.
"""

import abc
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .base import Effect


@dataclass(frozen=True)
class Coverage:
    """What the records of a case cover.

    Args:
        band: lowest and highest frequency [rad/s] in the records.
        volts: largest amplitude [V] of any recorded voltage.
        durations: length [s] of each record in the case's order; zero for one without a clock, such as a sweep.
        sweep_rate: fastest [rad/s²] at which the frequency of a sweep moves by the clocks of the records; infinite
            where a sweep has none.
    """

    band: tuple[float, float]
    volts: float
    durations: tuple[float, ...] = ()
    sweep_rate: float = float("inf")


class Scanned(Effect):
    """An effect of which `scanned` fields have to be tried on a grid before a fit may start."""

    scanned: ClassVar[tuple[str, ...]] = ()

    @abc.abstractmethod
    def grid(self, coverage: Coverage) -> "tuple[Scanned, ...]":
        """The same effect at every point worth a try, given what was recorded; may be empty.

        All have the same structure and shapes, so that they can be stacked and evaluated side by side.
        """

    def carried(self, motion: np.ndarray, frequency: np.ndarray) -> np.ndarray | None:
        """Fourier coefficients (r, h + 1, axes) of the acceleration per unit of strength that it adds at zero to a
        settled vibration `motion` (r, h + 1, axes) [m] at `frequency` (r,) [rad/s]; `None`, as by default, where there
        is no closed form.
        """
        return None
