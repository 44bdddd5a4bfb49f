"""The search over terms of the instrument, before any effect of the device is looked for, and once more after it."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy import stats

from memsgyro_jax.effects import Effect

from .fit import CaseFit, beside_case
from .instrument import instrument_terms, knowledge
from .joint_residual import Joint
from .optimum import Optimum, optimise
from .score import Score
from .search import GLANCE, LOOK_AHEAD, Ranking, Search, SearchStep, always_free


SHARE = 0.2  # of the level for terms of the instrument
FAINT = 0.2  # of what the best effect of the device would explain: below it the instrument is not the cause
EVIDENT = 10.0  # of the Bayesian information criterion by which an effect must be better than the instrument
PINNED = 0.98  # of a bound: a strength so near has been stopped by it


def instrument_first(
    search: Search,
    first: Ranking,
    effects: Sequence[Effect],
    go_on: Callable[[Search, Ranking], tuple[Search, Ranking]],
    done: Callable[[Search], bool],
) -> tuple[Search, Ranking]:
    """The end of a search that tries the instrument before the device.

    Where terms of the instrument explain every record, they do, unless one effect of the device says the same in fewer
    numbers. Where they do not, effects are looked for both beside them and without them, and the less wins.

    Args:
        search, first: at the base model, and the effects of the device beside it.
        effects: those of the device that are candidates.
        go_on: the search for effects of the device, from a search and its ranking.
        done: whether a search leaves nothing to explain.
    """
    alone = instrument_alone(search, first)
    if alone is None:
        return go_on(search, first)
    beside = beside_terms(alone, search.base, search.level, effects)
    whole, ranking = go_on(beside, beside.rank())
    if whole.accepted:
        take_out(whole)
    if done(whole) and not whole.accepted and not _one_effect_says_it(search, first, whole):
        return whole, ranking
    bare, its_ranking = go_on(search, first)
    better = (not done(bare), _cost(bare)) <= (not done(whole), _cost(whole))
    return (bare, its_ranking) if better else (whole, ranking)


def _one_effect_says_it(search: Search, first: Ranking, whole: Search) -> bool:
    """Whether one effect of the device, in fewer numbers, explains as much as the instrument does."""
    best = first.order[0] if first.places else None
    if best is None or first.p_values[best] > search.level:
        return False
    rival = search.refit([first.places[best]], slopes=first.slopes[best])
    return rival.chi2 + rival.free.size * float(np.log(rival.residual.size)) + EVIDENT < _cost(whole)


def instrument_alone(search: Search, first: Ranking) -> Search | None:
    """The base model with the terms of the instrument that its records need; `None` where they need none, or where an
    effect of the device explains far more.

    Args:
        search: at its base model.
        first: the effects of the device beside it.
    """
    terms = instrument_terms(search.case)
    if not terms or not _is_of_interest(search, first):
        return None
    search.tell("try what the instrument may have done")
    model = search.joint.at(search.optimum.vector)
    model = model.with_only((*(model.effects[i] for i in search.given), *terms))
    joint = Joint(model, (*search.joint.readings, *knowledge(terms)))
    given = range(len(search.given))
    optimum = optimise(joint, joint.start, always_free(joint, given), joint.fitted, max_evaluations=0)
    alone = Search(beside_case(search.case, joint, optimum), SHARE * search.level, given, search.tell)
    ranking = alone.rank()
    if ranking.scores[ranking.order[0]].statistic < FAINT * _most(first.scores):
        return None
    while (found := _best(alone, ranking)) is not None:
        alone.take(*found)
        ranking = alone.rank()
    return alone if alone.accepted else None


def _is_of_interest(search: Search, first: Ranking) -> bool:
    """Whether an effect would be added, or a record is not explained."""
    tempted = bool(first.places) and first.p_values[first.order[0]] <= search.level
    return tempted or not all(e.explained for e in search.base.errors)


def _most(scores: Sequence[Score]) -> float:
    return max((s.statistic for s in scores), default=0.0)


def _best(search: Search, ranking: Ranking) -> tuple[int, Optimum] | None:
    """The term that a refit favours of those that help beyond chance, and that refit; none whose strength its prior or
    the instrument excludes.
    """
    promising = [i for i in ranking.order if ranking.p_values[i] <= search.level][:LOOK_AHEAD]
    refits = []
    for i in promising:
        places = [*search.accepted, ranking.places[i]]
        glance = search.refit(places, slopes=ranking.slopes[i], evaluations=GLANCE)
        refits.append((ranking.places[i], glance if glance.converged else search.refit(places, start=glance.vector)))
    good = [(place, o) for place, o in refits if o.chi2 < search.optimum.chi2 and not _is_pinned(search, place, o)]
    return min(good, key=lambda pair: pair[1].chi2 + 2.0 * pair[1].free.size, default=None)


def _is_pinned(search: Search, place: int, optimum: Optimum) -> bool:
    low, high = (bound[search.joint.of_effect(place)] for bound in search.joint.bounds)
    value = optimum.vector[search.joint.of_effect(place)]
    return bool(np.any((value >= PINNED * high) | ((low < 0) & (value <= PINNED * low))))


def beside_terms(alone: Search, base: CaseFit, level: float, effects: Sequence[Effect]) -> Search:
    """A search for effects of the device beside the terms that were found, which are given to it."""
    given = [*alone.given, *alone.accepted]
    model = alone.joint.at(alone.optimum.vector)
    kept = tuple(model.effects[i] for i in given)
    terms = [effect for effect in kept if effect.of_instrument]
    plain = [r for r in alone.joint.readings if r.record.max(initial=-1) >= 0]
    joint = Joint(model.with_only((*kept, *effects)), (*plain, *knowledge(terms)))
    places = range(len(kept))
    optimum = optimise(joint, joint.start, always_free(joint, places), joint.fitted, max_evaluations=0)
    out = Search(beside_case(alone.case, joint, optimum), level, places, alone.tell)
    out.base, out.steps = base, [SearchStep("", base), *alone.steps[1:]]
    return out


def take_out(search: Search) -> None:
    """Take terms of the instrument out again that the effects found since explain as well."""
    for place in [i for i in search.given if search.joint.model.effects[i].of_instrument]:
        size = search.joint.of_effect(place).size
        kept, search.given = search.given, tuple(i for i in search.given if i != place)
        fewer = search.refit(search.accepted, start=search.without(place))
        if stats.chi2.sf(fewer.chi2 - search.optimum.chi2, size) <= SHARE * search.level:
            search.given = kept
            continue
        search.optimum = fewer
        label = search.joint.model.effects[place].label
        search.tell(f"dropped {label}, which the others explain")
        search.steps.append(SearchStep(f"without {label}", beside_case(search.case, search.joint, fewer)))


def _cost(search: Search) -> float:
    """χ² and what each free number would cost at least: the Bayesian information criterion."""
    return search.optimum.chi2 + search.optimum.free.size * float(np.log(search.optimum.residual.size))
