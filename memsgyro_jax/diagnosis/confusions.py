"""Which candidates could stand in place of an effect that was accepted: what these records cannot tell apart."""

import numpy as np

from memsgyro_jax.effects import CubicStiffness, QuadraticStiffness

from .joint_residual import Joint
from .optimum import Optimum
from .score import basis, score, separation
from .search import CONFUSED, Ranking, Search


NEARLY = 2e-3  # of what an effect explains: sensitivities are no nearer to the truth than that
UNEVEN = 10.0 / 9.0  # s²/k of a spring s·q² that softens as the cubic spring −UNEVEN·s²/k does: 5/12 over 3/8


def confusions(search: Search, ranking: Ranking) -> dict[int, dict[int, Optimum]]:
    """Per accepted effect the candidates that could stand in its place, and fits with them.

    Sensitivities only propose: taken with the effect present, they hold some for alike that are not (a change of the
    pick-off's scale on one axis changes the strength of a nonlinearity), and they know nothing of what shows to second
    order alone. A fit with the candidate instead decides.
    """
    out: dict[int, dict[int, Optimum]] = {}
    for place in search.accepted:
        mine = search.own_score(place)
        q = basis(search.jacobian_without(place))
        out[place] = {}
        for other, block in zip(ranking.places, ranking.slopes, strict=True):
            start = uneven_instead(search.joint, search.optimum.vector, place, other)
            theirs = score(search.optimum.residual, q, block)
            starts = [] if start is None else [start]
            near = max(CONFUSED, NEARLY * mine.statistic)
            if start is None and separation(mine.statistic, mine, theirs) < near:
                instead = _as_strong(search, place, other, block)
                # One that would need a sign that it cannot have stands for nothing: a fit would keep it at zero.
                possible = np.any(instead[search.joint.of_effect(other)] != 0)
                starts = [instead, search.without(place)] if possible else []
            for start in starts:
                places, most = [other if i == place else i for i in search.accepted], search.optimum.chi2 + CONFUSED
                fit = search.refit(places, start=start, beat=most)
                if fit.chi2 < most:
                    out[place][other] = fit
                    break
    return out


def _as_strong(search: Search, place: int, other: int, block: np.ndarray) -> np.ndarray:
    """The parameters with another effect in place of an accepted one, so strong that readings change as much: without
    either, a fit may be far from its valley.
    """
    vector, (low, high) = search.without(place), search.joint.bounds
    theirs = search.joint.of_effect(other)
    strength = -np.linalg.lstsq(block, search.taken_by(place))[0]
    vector[theirs] = np.clip(vector[theirs] + strength, low[theirs], high[theirs])
    return vector


def uneven_instead(joint: Joint, vector: np.ndarray, place: int, other: int) -> np.ndarray | None:
    """The parameters with an uneven spring in place of a cubic one that softens as much; None for all other pairs.

    A lock-in sees of an uneven spring its softening alone, by 5·s²·a²/(12·k²), and so no slope at zero.
    """
    cubic, uneven = (joint.model.effects[i] for i in (place, other))
    if not (isinstance(cubic, CubicStiffness) and isinstance(uneven, QuadraticStiffness) and cubic.axis == uneven.axis):
        return None
    softens = -float(vector[joint.of_effect(place)][0])
    if not softens > 0.0:
        return None
    device, start = joint.at(vector).device, vector.copy()
    stiffness = float(device.stiffness_matrix[cubic.axis, cubic.axis]) * abs(float(device.mass(cubic.axis)))
    start[joint.of_effect(place)], start[joint.of_effect(other)] = 0.0, np.sqrt(softens * stiffness / UNEVEN)
    return start
