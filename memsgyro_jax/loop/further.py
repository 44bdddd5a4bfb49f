"""Where a response over frequency is looked at further: between frequencies that bracket half its power, around a peak
between others, and at the split of the modes.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from memsgyro_jax.base.concrete import is_concrete, settled
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import AbstractGyro, Inertial
from memsgyro_jax.device.modes import natural_frequencies

from .loop import ClosedLoop
from .stability import at_lock


_COUNT = 12  # frequencies of each further look
_EACH, _LOOKS = 6, 4
_NARROW = 1.01  # ratio of the two frequencies of a bracket that is not looked into any more
_FLAT = 0.99  # share of a peak that both its neighbours have where it is resolved
_WIDTHS = np.array([-3.0, -1.0, 0.0, 1.0, 3.0])

Response = tuple[Float[np.ndarray, " some"], Complex[np.ndarray, " some"], Float[np.ndarray, " some"]]


def around_split(gyro: AbstractGyro, low: float, high: float) -> Float[np.ndarray, " some"]:
    """Frequencies [Hz] between `low` and `high` about the split of the modes of a device, which an open sense axis
    answers most, in widths of the more damped mode; none of numbers that are not known.
    """
    dynamics = settled(gyro).dynamics(Inertial())
    if not is_concrete(dynamics) or np.ndim(dynamics.stiffness[0][0]):
        return np.zeros(0)
    width = 0.5 * max(float(dynamics.damping[i][i]) for i in (0, 1)) / (2.0 * np.pi)
    found = float(np.ptp(natural_frequencies(dynamics.stiffness))) + width * _WIDTHS
    return found[(found > low) & (found < high)]


def expected_half_power(loop: ClosedLoop) -> float | None:
    """About where [Hz] a loop in classic control answers a rate by half the power of a constant one, of its linearised
    loops averaged over the drive's periods and its output filter; None of another loop, and where it does not.
    """
    try:
        closed, *_, turned, told, omega = at_lock(loop)
    except (InputError, np.linalg.LinAlgError):
        return None
    along = omega * np.geomspace(1e-6, 0.5, 2001)
    if not np.all(np.isfinite(closed)):
        return None
    moved = np.linalg.solve(1j * along[:, None, None] * np.eye(len(closed)) - closed, turned[:, None] + 0j)
    gain = np.abs(moved[..., 0] @ told)
    k = half_power_bracket(gain / gain[0])
    edges = () if loop.filter is None else (float(np.min(edge)) for edge in loop.filter.edges())
    return None if k is None else min([float(along[k]) / (2.0 * np.pi), *edges])


def half_power_bracket(gain: Float[np.ndarray, " some"]) -> int | None:
    """Place of the first frequency whose power is below half, of gains over that of a constant; None of none, where it
    is the first of all, and where a gain is no number.
    """
    below = np.flatnonzero(gain**2 < 0.5)
    return int(below[0]) if np.all(np.isfinite(gain)) and below.size and below[0] > 0 else None


def looked_further(
    answers: Callable[[Float[np.ndarray, " some"]], tuple[Any, Any]], known: Response, whole: Any, first: np.ndarray
) -> Response:
    """`known` frequencies, responses and rests with further ones by `answers`, at `first` and where they are needed;
    `whole` is the response to a constant. Those asked for stay.
    """
    wanted = first
    for look in range(_LOOKS):
        gain = np.abs(np.asarray(settled(known[1]))) / abs(complex(settled(whole)))
        wanted = np.concatenate([wanted if look == 0 else _about_peak(known[0], gain), _about_half(known[0], gain)])
        wanted = np.setdiff1d(wanted, known[0])
        if not wanted.size:
            break
        known = _merged(known, wanted, *answers(np.append(wanted, np.full(_COUNT - wanted.size, wanted[-1]))))
    return known


def _merged(known: Response, wanted: np.ndarray, found: Any, rest: Any) -> Response:
    frequency = np.concatenate([known[0], wanted])
    order, xp = np.argsort(frequency), np if is_concrete(known[1]) else jnp
    response, rests = (
        xp.concatenate([old, new[: wanted.size]])[order] for old, new in zip(known[1:], (found, rest), strict=True)
    )
    return frequency[order], response, rests


def _about_half(frequency: np.ndarray, gain: np.ndarray) -> np.ndarray:
    k = half_power_bracket(gain)
    if k is None or frequency[k] < _NARROW * frequency[k - 1]:
        return np.zeros(0)
    return np.geomspace(frequency[k - 1], frequency[k], _EACH + 2)[1:-1]


def _about_peak(frequency: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """About the highest of all that is higher than what is on both sides of it, and than a constant."""
    k = int(np.argmax(gain))
    if not np.all(np.isfinite(gain)) or k in (0, len(gain) - 1) or gain[k] ** 2 < 2.0:
        return np.zeros(0)
    if min(gain[k - 1], gain[k + 1]) > _FLAT * gain[k]:
        return np.zeros(0)
    half = _EACH // 2 + 2
    sides = np.linspace(frequency[k - 1], frequency[k], half), np.linspace(frequency[k], frequency[k + 1], half)
    return np.concatenate([side[1:-1] for side in sides])
