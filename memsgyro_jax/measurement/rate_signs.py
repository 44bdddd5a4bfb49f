"""Whether the rate of a record has the unit and the sign that it is labelled with."""

import numpy as np
from jaxtyping import Complex, Float

from memsgyro_jax.device.normalised import NormalisedDevice


FASTEST = np.radians(4000.0)  # rad/s: no rate table turns faster
_FACING = -0.7  # cosine, in the complex plane, from which a slope points the other way
_TOLD = 0.5  # of the scatter of the readings, which what follows the rate must exceed
_ALIKE = 3.0  # factor between the sizes seen and expected, beyond which another cause is likelier


def fast_rates(name: str, rate: Float[np.ndarray, " n"]) -> list[str]:
    """A sentence where a rate [rad/s] is none that a table turns at."""
    most = float(np.max(np.abs(rate), initial=0.0))
    if most <= FASTEST:
        return []
    return [
        f"experiment `{name}`: the rate goes up to {np.degrees(most):.4g} deg/s; is it in deg/s, and labelled rad/s?"
    ]


def turned_rate(
    name: str, device: NormalisedDevice, omega: float, axis: int, motion: Complex[np.ndarray, "n 2"],
    rate: Float[np.ndarray, " n"],
) -> list[str]:  # fmt: skip
    """A sentence where the axis that is not driven answers to the rate the other way round.

    Args:
        name: of the record.
        device: as all records show it.
        omega: of the drive [rad/s].
        axis: that is driven.
        motion: phasors of both displacements [m].
        rate: [rad/s].
    """
    swing, seen = rate - rate.mean(), motion[:, 1 - axis] - motion[:, 1 - axis].mean()
    if not np.any(swing):
        return []
    slope = swing @ seen / (swing @ swing)
    stiffness, damping = np.asarray(device.stiffness_matrix), np.asarray(device.damping_matrix)
    answers = np.linalg.inv(stiffness - omega**2 * np.eye(2) + 1j * omega * damping)
    coriolis = (-2j if axis == 0 else 2j) * omega * motion[:, axis].mean()
    expected = answers[1 - axis, 1 - axis] * coriolis
    clear = abs(slope) * np.linalg.norm(swing) > _TOLD * np.linalg.norm(seen)
    facing = (slope * np.conj(expected)).real / (abs(slope) * abs(expected) + 1e-300)
    if not clear or facing > _FACING or not 1 / _ALIKE < abs(slope) / abs(expected) < _ALIKE:
        return []
    said = "what answers to the rate has the other sign; was the device mounted upside down, or is a channel inverted?"
    return [f"experiment `{name}`: {said} If the rate is, negate its column"]
