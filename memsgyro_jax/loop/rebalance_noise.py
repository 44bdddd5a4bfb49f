"""What the noise of a rebalanced loop is where it reaches beyond the split of the modes."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Array

from .controllers.classic import ClassicControl
from .controllers.sense import ForceRebalance
from .loop import ClosedLoop


_POINTS = 200
_TENTH = 0.1  # of the drive's frequency, up to where a loop is looked at
_RISES = 2.0  # times the density at rest, from which it is told
_DEGREES = 180.0 / np.pi


def beyond_the_split(
    loop: ClosedLoop, resistance: Callable[[Array], Array], omega: float, split: float, density: float, rest: float
) -> str:
    """A sentence on the noise at the crossover of a loop that is rebalanced beyond the split and not filtered behind,
    where that is far above the one of slow rates; else empty. `resistance` is Δ of a frequency [rad/s], `omega` the
    drive's and `split` how far it is from the sense mode [rad/s]; `density` is that of a slow rate by the noise of the
    displacement, `rest` by all else [rad/s/√Hz].

    Forces that hold the sense axis still, in both its phases, answer noise of the displacement by Δ at each sideband of
    the drive: beyond the split it grows with the distance.
    """
    control = loop.controller
    if not isinstance(control, ClassicControl) or not isinstance(control.sense, ForceRebalance) or loop.filter:
        return ""
    at_rest = complex(resistance(np.asarray(omega)))
    speeds = np.geomspace(max(split, 1e-9 * omega), _TENTH * omega, _POINTS)
    above, below = (np.asarray(resistance(omega + sign * speeds)) for sign in (1.0, -1.0))
    width, turned = 2.0 * np.pi * float(control.sense.demodulator.bandwidth), 1j * speeds
    gain = float(control.sense.gain) + float(control.sense.integral) / turned
    reached = np.flatnonzero(np.abs(gain * width / (turned + width) * at_rest / above) >= 1.0)
    if not reached.size:
        return ""
    last = int(reached[-1])
    grown = np.hypot(np.abs(above[last]), np.abs(below[last])) / (np.sqrt(2.0) * abs(at_rest))
    there = float(np.hypot(density * grown, rest))
    if there < _RISES * np.hypot(density, rest):
        return ""
    return (
        f"These are figures of slow rates. The loop is rebalanced up to about {speeds[last] / (2.0 * np.pi):.3g} Hz, "
        f"beyond the {split / (2.0 * np.pi):.3g} Hz between the modes, where the electronics' noise grows with the "
        f"frequency: to {_DEGREES * there:.3g} °/s/√Hz there, which only an output filter takes away."
    )
