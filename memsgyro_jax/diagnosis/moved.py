"""The first effects of a device that its surroundings move: found from the linear device that each setting shows."""

from collections.abc import Sequence

import numpy as np

from memsgyro_jax.effects import Effect

from .acceptance import excess
from .climb import TENTH, Climb, as_found, beside_lock_in, followed
from .drives import FAR, stages
from .fewer import by_itself
from .fit import beside_case
from .optimum import Optimum, optimise
from .programs import SPARE
from .search import GLANCE, Ranking, Search, always_free
from .settings_apart import Surrounded, begun, in_each_place, moves, put_beside, twins_of, with_strengths


WHENCE = "the base model is that of the surroundings at which its numbers hold, as the device moves with them"


def moved(search: Search, first: Ranking, effects: Sequence[Effect]) -> tuple[Search, Climb | None]:
    """The search with the effects that tell how the device differs from one of its surroundings to another, where the
    base model is far off, as it is with the best effect in one step, and the resonance moves by more than its width;
    the same search and `None` else.

    Args:
        search, first: at the base model, and the effects of the device beside it.
        effects: those of the device that are candidates.
    """
    if search.optimum.chi2 < FAR * search.optimum.dof or not first.places:
        return search, None
    every = in_each_place(search.case)
    if not moves(every):
        return search, None
    beside = beside_lock_in(search)
    begin, chosen = begun(beside.joint, every, beside.candidates())
    if not chosen:
        return search, None
    _announce(beside, chosen, [search.joint.model.effects[first.places[i]].label for i in first.order[:SPARE]])
    # A glance tells: a fit that is still far off by then has a long way to go, and what follows goes it faster.
    usual = search.refit([first.places[first.order[0]]], slopes=first.slopes[first.order[0]], evaluations=GLANCE)
    if usual.chi2 < FAR * usual.dof:
        return search, None
    tried = [beside.joint.model.effects[i] for i in chosen]
    search.tell(f"the resonance moves from setting to setting: try {', '.join(effect.label for effect in tried)}")
    steps = stages(search.case, beside.joint.fitted) or [tuple(beside.joint.fitted)]
    ends = _at_the_lowest(beside, begin, chosen, steps[0])
    if not ends:
        return search, None
    joint = beside.joint
    whole = [end if len(steps) == 1 else optimise(joint, end.vector, end.free, joint.fitted) for end in ends]
    for place, end in zip(chosen, whole, strict=True):
        beside.take(place, end)
    bent = excess(whole[-1]) > TENTH * excess(search.optimum)
    if bent or whole[-1].chi2 > FAR * whole[-1].dof:  # what bends the resonance over is still missing
        low = _with_twins(climbing := by_itself(beside), every, chosen, steps[0], ends[-1].vector)
        usual = search.optimum if bent else whole[-1]
        found, climb = followed(climbing, search, effects, steps, usual, low)
        if bent or climb is not None:
            return found, climb
    still = with_strengths(joint, begin, dict.fromkeys(chosen, 0.0))
    straight = optimise(joint, still, always_free(joint, beside.given), joint.fitted, max_evaluations=0)
    base = beside_case(search.case, joint, straight)
    left = [end.chi2 for end in whole]
    return as_found(beside, search, effects), Climb(base, tuple(zip(tried, left, strict=True)), WHENCE)


def _with_twins(
    beside: Search, every: list[Surrounded], chosen: Sequence[int], lowest: tuple, start: np.ndarray
) -> np.ndarray:
    """Takes the effects that a linear device cannot tell from the chosen ones, half and half, and returns parameters of
    the lowest drive with them; `start` where there are none.
    """
    joint = beside.joint
    twins = twins_of(joint, every, chosen, beside.candidates())
    if not twins:
        return start
    begin = put_beside(joint, every, [*chosen, *twins])
    end = optimise(joint, begin, always_free(joint, (*beside.given, *chosen, *twins)), lowest)
    whole = optimise(joint, end.vector, end.free, joint.fitted)
    for place in twins:
        beside.take(place, whole)
    return end.vector


def _announce(beside: Search, chosen: Sequence[int], first: Sequence[str]) -> None:
    """One program for all that is going to be asked for: the first effects by slopes, the chosen ones, what a lock-in
    does, and what that imitates.
    """
    effects = beside.joint.model.effects
    places = {effect.label: i for i, effect in enumerate(effects)}
    labels = *(getattr(effects[i], "imitates", "") for i in beside.given), *first
    beside.joint.together((*beside.given, *chosen, *(places[label] for label in labels if label in places)))


def _at_the_lowest(search: Search, begin: np.ndarray, chosen: Sequence[int], lowest: tuple) -> list[Optimum]:
    """Fits of the lowest drive with the first of the effects, the first two, and so on, each from where the settings
    put it; none where all of them leave more than a tenth of what the base model does.
    """
    joint, given = search.joint, search.given
    base = optimise(joint, joint.start, always_free(joint, given), lowest)
    ends = []
    for count in range(1, len(chosen) + 1):
        vector = with_strengths(joint, begin, dict.fromkeys(chosen[count:], 0.0))
        ends.append(optimise(joint, vector, always_free(joint, (*given, *chosen[:count])), lowest))
    return ends if excess(ends[-1]) <= TENTH * excess(base) else []
