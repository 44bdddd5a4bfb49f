"""The first effect of a device that is driven hard: found at its lowest drive and followed up to the highest.

Where a resonance has bent over, a fit to all drives at once has no valley to the truth: the base model flees from its
resonance, and what an effect would do to first order says nothing. At the lowest drive both are nearly right, and what
is found there starts a fit with the next drive.
"""

import numpy as np

from memsgyro_jax.effects import ForceEffect

from .acceptance import excess
from .drives import FAR, stages, up
from .joint_residual import Joint
from .optimum import Optimum, optimise
from .score import basis, overlap, score, within_bounds
from .search import LOOK_AHEAD, TWINS, Ranking, Search, always_free


STRENGTHS = np.geomspace(1e-2, 1e2, 25)  # of the size of a strength, that are tried: a width of the resonance apart
TENTH = 0.1  # of the misfit that the best single effect leaves: what a climb must come to


def climbed(search: Search, first: Ranking) -> Search:
    """The search with the effect that a climb over the drives finds, where the base model is far off and no effect in
    one step leaves less than ten times as much; the same search else. `first` ranks effects beside the base model.
    """
    steps = stages(search.case, search.joint.fitted)
    if len(steps) < 2 or not first.places or search.optimum.chi2 < FAR * search.optimum.dof:
        return search
    search.tell(f"climb from the lowest of {len(steps)} drives")
    base = _lowest(search.joint, search.given, steps[0])
    tempting = _tempting(search, base, steps[0])
    ends = [(i, _up(search.joint, base, i, size, search.given, steps)) for i, size in tempting.items()]
    if not ends:
        return search
    place, end = min(ends, key=lambda one: one[1].chi2)
    best = first.order[0]
    usual = search.refit([first.places[best]], slopes=first.slopes[best])
    if excess(end) > TENTH * excess(usual) or search.refuses(place, end):
        return search
    search.take(place, end)
    return search


def _lowest(joint: Joint, given: tuple[int, ...], lowest: tuple) -> Optimum:
    """The base model at the lowest drive; where even that bends the resonance over, the linear device it started as."""
    free = always_free(joint, given)
    fitted = optimise(joint, joint.start, free, lowest)
    return fitted if fitted.chi2 < FAR * fitted.dof else optimise(joint, joint.start, free, lowest, max_evaluations=0)


def _tempting(search: Search, base: Optimum, lowest: tuple) -> dict[int, float]:
    """Effects that the lowest drive asks for most, no two of which say the same, and the size of a strength of each
    that changes the readings as much as they are missed.
    """
    joint, places = search.joint, [i for i in search.candidates() if search.joint.of_effect(i).size == 1]
    if not places:
        return {}
    columns = np.concatenate([joint.of_effect(i) for i in places])
    _, slopes = joint.linearise(base.vector, np.eye(joint.start.size)[columns], lowest)
    slopes, q = np.where(np.isfinite(slopes), slopes, 0.0), basis(base.jacobian)
    scores = [
        within_bounds(score(base.residual, q, s[:, None]), base.residual, s[:, None], low[None], high[None])
        for s, low, high in zip(slopes.T, *(bound[columns] for bound in joint.bounds), strict=True)
    ]
    chosen: list[int] = []
    for k in sorted(range(len(places)), key=lambda k: -scores[k].statistic):
        if len(chosen) < LOOK_AHEAD and scores[k].size and all(overlap(scores[k], scores[j]) < TWINS for j in chosen):
            chosen.append(k)
    missed = float(np.linalg.norm(base.residual))
    sizes = {places[k]: missed / float(np.linalg.norm(slopes[:, k])) for k in range(len(places)) if scores[k].size}
    if base.chi2 < FAR * base.dof:
        return {places[k]: sizes[places[k]] for k in chosen}
    # What effects would do to first order says nothing here: each is tried at its best strength.
    forces = [i for i in sizes if isinstance(joint.model.effects[i], ForceEffect)]
    joint.together((*search.given, *forces))
    left = {i: _best_strength(joint, base, i, sizes[i], lowest)[1] for i in forces}
    return {i: sizes[i] for i in sorted(forces, key=left.__getitem__)[:LOOK_AHEAD]}


def _up(joint: Joint, base: Optimum, place: int, size: float, given: tuple[int, ...], steps: list[tuple]) -> Optimum:
    """A fit with one effect that starts at the lowest drive, without it or where some strength of it fits best."""
    free = always_free(joint, (*given, place))
    end = optimise(joint, base.vector, free, steps[0])
    if end.chi2 > FAR * end.dof:
        begin, _ = _best_strength(joint, base, place, size, steps[0])
        end = min(end, optimise(joint, begin, free, steps[0]), key=_chi2)
    return up(joint, end.vector, free, steps[1:])


def _best_strength(joint: Joint, base: Optimum, place: int, size: float, lowest: tuple) -> tuple[np.ndarray, float]:
    """Base parameters with the strength of one effect that leaves least of the lowest drive, and χ²."""
    low, high = (bound[joint.of_effect(place)] for bound in joint.bounds)

    def with_strength(strength: float) -> np.ndarray:
        vector = base.vector.copy()
        vector[joint.of_effect(place)] = np.clip(strength, low, high)
        return vector

    def misfit(vector: np.ndarray) -> float:
        left = np.concatenate(joint.residual(vector, lowest))
        return float(left @ left) if np.isfinite(left).all() else np.inf

    tried = [with_strength(sign * size * part) for part in STRENGTHS for sign in (-1.0, 1.0)]
    left = [misfit(vector) for vector in tried]
    best = int(np.argmin(left))
    return tried[best], left[best]


def _chi2(optimum: Optimum) -> float:
    return optimum.chi2
