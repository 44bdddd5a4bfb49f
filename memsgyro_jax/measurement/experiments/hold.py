"""How a sampled force runs between its rows."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from ..declared import Declared
from ..phasor_fit import misfit
from .base import Phasors


if TYPE_CHECKING:
    from .record import AbstractRecord

Hold = Literal["zero_order", "linear", "band_limited"]
FEWEST = 10  # spectral lines from which a record tells
SURELY, FAR = 0.5, 0.1  # of the squared misfit that another way must come to; where it leaves more than noise, too
NOISE = 3.0  # squared misfit that is about noise
CLEAR = 40.0  # of χ², in units of the misfit that is left, by which it must be better
SAID = {
    "zero_order": "the force was held from row to row (`hold` is zero_order)",
    "band_limited": "the force was sampled as it ran (`hold` is band_limited)",
}


class NearestHold(NamedTuple):
    """The way in which the force of a record ran: another `hold` where its rows lie far nearer to a device then, and a
    sentence on it; with its phasors, and their misfit, infinite where they are too few to tell.
    """

    hold: Literal["zero_order", "band_limited"] | None
    told: str
    phasors: Phasors | None
    misfit: float = np.inf


def better_hold(hold: Hold, held: "Callable[[Hold], AbstractRecord]", declared: Declared) -> NearestHold:
    """What the rows of a record say of its `hold`; `held` is the record with another. Straight lines are not told from
    a band-limited force.
    """
    other: Literal["zero_order", "band_limited"] = "band_limited" if hold == "zero_order" else "zero_order"
    here, there = (held(one).starting_phasors(declared) for one in (hold, other))
    if here is None or there is None or here.omega.size < FEWEST:
        return NearestHold(None, "", here)
    now, then = misfit(here), misfit(there)
    if not is_far_nearer(now, then, here.motion.size):
        return NearestHold(None, "", here, now)
    times = f"{np.sqrt(now / then):.2g} times" if np.isfinite(now) else "far"
    return NearestHold(other, f"its rows lie {times} nearer to a device where {SAID[other]}", there, then)


def is_far_nearer(now: float, then: float, size: int) -> bool:
    """Whether the squared misfit of `size` phasors is so much smaller that nothing else is less wrong by chance: a
    latency, too, may be less wrong with half a row more.
    """
    nearer = then < (SURELY if then < NOISE else FAR) * now
    return nearer and (now / max(then, 1.0) - 1.0) * 2 * size > CLEAR


def between(forces: np.ndarray, substeps: int, hold: Hold) -> np.ndarray:
    """Input on a grid `substeps` times finer: on straight lines, or as a band-limited signal.

    The integration takes the fine grid as straight lines, which weakens a sine by (ωh)²/12; the band-limited signal is
    strengthened by as much.
    """
    count = forces.shape[0]
    if hold == "linear" or substeps == 1:
        place = np.arange(count * substeps) / substeps
        return np.stack([np.interp(place, np.arange(count), column) for column in forces.T], axis=1)
    from scipy import signal

    fine = signal.resample_poly(forces, substeps, 1, axis=0, window=("kaiser", 12.0), padtype="line")
    curvature = np.zeros_like(fine)
    curvature[1:-1] = fine[2:] - 2 * fine[1:-1] + fine[:-2]
    return fine - curvature / 12
