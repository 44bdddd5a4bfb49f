"""The search over terms of the instrument, before any effect of the device is looked for, and once more after it."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from memsgyro_jax.effects import Effect, InstrumentTerm, Scanned
from memsgyro_jax.effects.instrument import FrequencyOffset

from .acceptance import BEYOND_LINEAR, excess, share_needed
from .best_single import Best, best_single
from .effort import NEARLY_ALL, exhausted, far_from_noise
from .exchange import stand_ins
from .fewer import SHARE, as_a_capacitance, as_late, cost, imitated
from .fit import beside_case
from .instrument import instrument_terms, knowledge
from .joint_residual import Joint
from .optimum import Optimum, optimise
from .oven import oven_offer
from .promise import Offer, Promise, offers_of, promised
from .search import GLANCE, INSTRUMENT, LOOK_AHEAD, Ranking, Search, always_free


FAINT, RIVAL = 0.5, 0.9  # of what effects of the device would explain: below it the instrument is not the cause
# Of the misfit beyond noise: a term that explains less may stand beside effects, not before them; or not at all.
MOSTLY, LITTLE = 0.5, 0.1
ROUGHLY = 1e-3  # of what is promised: linear estimates differ by so much where two say the same
AGAIN = 2  # times that terms are chosen, the second beside those found
EVIDENT = 10.0  # of the Bayesian information criterion by which an effect must be better than the instrument
PINNED = 0.98  # of a bound: a strength so near has been stopped by it


def instrument_first(
    search: Search,
    first: Ranking,
    effects: Sequence[Effect],
    go_on: Callable[[Search, Ranking], tuple[Search, Ranking]],
    done: Callable[[Search], bool],
) -> tuple[Search, Ranking, str]:
    """The end of a search that tries the instrument before the device, its ranking, and the label of an effect that the
    records cannot tell from what the instrument does, empty where there is none.

    Where terms of the instrument explain every record, they do, unless one effect of the device says the same in fewer
    numbers. Where they do not, effects are looked for beside them or without them, as is better, and the other way only
    if that leaves something, but not much: two searches at most.

    Args:
        search, first: at the base model, and the effects of the device beside it.
        effects: those of the device that are candidates.
        go_on: the search for effects of the device, from a search and its ranking.
        done: whether a search leaves nothing to explain.
    """
    best = best_single(search, first)
    alone = instrument_alone(search, first, best)
    rival, gain = ("", -np.inf) if alone is None else _rival(alone, best)

    def without() -> tuple[Search, Ranking]:
        return go_on(search, first)

    def beside() -> tuple[Search, Ranking]:
        return without() if alone is None else _beside(alone, search, effects, go_on)

    order = (beside, without) if gain < EVIDENT else (without, beside)
    whole, ranking = order[0]()
    if done(whole):
        only = alone is not None and gain < EVIDENT and not whole.accepted
        return whole, ranking, rival if only and gain > -EVIDENT else ""
    ends = [(whole, ranking)]
    # An effect that stands out may have hidden what the instrument does.
    later = instrument_alone(whole, ranking, None) if whole.accepted and not exhausted(whole) else None
    # What leaves most, far above noise, is no matter of which came first.
    if later is not None and not far_from_noise(later.optimum, search.optimum):
        ends.append(_beside(later, search, effects, go_on))
    elif later is None and alone is not None and _other_order(whole, search):
        ends.append(order[1]())
    return *min(ends, key=lambda end: (not done(end[0]), cost(end[0].optimum))), ""


def _other_order(whole: Search, search: Search) -> bool:
    """Whether more may come of the other order, after one ended: not where terms of the instrument took nearly all."""
    much = excess(whole.optimum) > NEARLY_ALL * excess(search.optimum)
    return not far_from_noise(whole.optimum, search.optimum) if whole.accepted else much and not exhausted(whole)


def _beside(alone: Search, search: Search, effects: Sequence[Effect], go_on) -> tuple[Search, Ranking]:
    """The search for effects of the device beside terms of the instrument, those taken out that it makes needless."""
    beside = beside_terms(alone, search, effects)
    return go_on(beside, beside.rank())


def _rival(alone: Search, best: Best | None) -> tuple[str, float]:
    """The best single effect of the device, and by how much it is better than the instrument."""
    return ("", -np.inf) if best is None else (best.label, cost(alone.optimum) - cost(best.optimum))


def instrument_alone(search: Search, first: Ranking, best: Best | None) -> Search | None:
    """The present model with the terms of the instrument that its records need; `None` where they need none, or where
    the device explains more: by what both promise, before anything is fitted.

    Args:
        search: its effects are given to the one returned.
        first: the further effects of the device beside it.
        best: one of them and a fit with it.
    """
    if not _is_of_interest(search, first):
        return None
    terms, promise = _offered(search)
    if promise is None or not _explains_more(search, first, promise, best):
        return None
    return _chosen_terms(search, terms, promise)


def _offered(search: Search) -> tuple[list[InstrumentTerm], Promise | None]:
    """Terms of the instrument that a search lacks, and what they promise; how far temperatures are off is one of them
    where there are effects that may depend on them.
    """
    held = _labels(search, search.given)
    terms = [term for term in instrument_terms(search.case) if term.label not in held]
    offers = offers_of(search.steps[-1].fit, terms)
    warm = oven_offer(search)
    if warm is not None:
        terms, offers = [*terms, warm[0]], [*offers, warm[1]]
        gains = promised(search.optimum, offers, SHARE * search.level).alone
        # Beside a drift a frequency that is off says in another unit what a temperature says of all that drifts.
        same = [isinstance(t, FrequencyOffset) and gains[-1] >= RIVAL * g for t, g in zip(terms, gains, strict=True)]
        terms = [term for term, one in zip(terms, same, strict=True) if not one]
        offers = [offer for offer, one in zip(offers, same, strict=True) if not one]
    return terms, promised(search.optimum, offers, SHARE * search.level) if terms else None


def _chosen_terms(
    search: Search, terms: Sequence[InstrumentTerm], promise: Promise, later: Sequence[int] = ()
) -> Search | None:
    """The present model with those of some terms that a fit favours, of those that are promised; `None` where none, or
    where they keep too little of what they promised. `later` are effects that will be tried beside them.
    """
    wanted = {terms[i].label for i in promise.worth_a_fit}
    for _ in range(AGAIN):
        search.tell(INSTRUMENT + ", ".join(sorted(wanted)))
        alone = _with_terms(search, [term for term in terms if term.label in wanted], later)
        if not alone.accepted:
            return None
        others = [term for term in terms if term.label not in wanted]
        more = promised(alone.optimum, offers_of(alone.steps[-1].fit, others), alone.level) if others else None
        if more is None or not more.chosen or more.gain < LITTLE * excess(alone.optimum):
            break
        wanted |= {others[i].label for i in more.worth_a_fit}
    return alone if search.optimum.chi2 - alone.optimum.chi2 >= LITTLE * excess(search.optimum) else None


def instrument_between(search: Search, ranking: Ranking) -> Search | None:
    """The same search beside terms of the instrument, where they are as good an answer to what the effects found so far
    leave as any further effects; `None` where they are not.

    An effect that stands out hides what the instrument does, and what imitates the instrument must not come before it.
    """
    terms, promise = _offered(search)
    if promise is None or not promise.chosen or promise.gain < LITTLE * excess(search.optimum):
        return None
    device = _promised_by_effects(search, ranking)
    price, roughly = float(np.log(search.optimum.residual.size)), EVIDENT + ROUGHLY * promise.gain
    single = max(device.alone) - price if device is not None else 0.0
    # One by one, as the next effect would be taken: what several promise together is far from what they keep.
    if max(g - price * t.strength.size for g, t in zip(promise.alone, terms, strict=True)) < single - roughly:
        return None
    alone = _chosen_terms(search, terms, promise, stand_ins(search, ranking))
    if alone is None:
        return None
    if device is not None and device.chosen and device.worth > promise.worth - roughly:
        rival = search.refit([*search.accepted, *(ranking.places[i] for i in device.chosen)])
        if cost(rival) + EVIDENT < cost(alone.optimum):
            return None
    effects = [search.joint.model.effects[i] for i in search.candidates()]
    return beside_terms(alone, search, [effect for effect in effects if not isinstance(effect, Scanned)])


def _with_terms(search: Search, terms: Sequence[InstrumentTerm], later: Sequence[int] = ()) -> Search:
    """A search to which the effects of another are given, with those of some terms that help beyond chance."""
    model, own = search.joint.at(search.optimum.vector), len(search.given)
    before, behind = ([model.effects[i] for i in some] for some in (search.given, search.accepted))
    # In the order that they have beside further effects, so that it is the same program.
    joint = Joint(
        model.with_only((*before, *terms, *behind)), (*search.joint.readings, *knowledge(terms)), search.joint.programs
    )
    given = (*range(own), *range(own + len(terms), len(joint.model.effects)))
    free = always_free(joint, given)
    optimum = optimise(joint, joint.start, free, joint.fitted, known=_as_before(search, joint, free), max_evaluations=0)
    alone = Search(beside_case(search.case, joint, optimum), SHARE * search.level, given, search.tell)
    alone.steps = list(search.steps)
    # One program for the ranking, for all fits, and for what comes after them.
    joint.together(range(len(joint.model.effects)), search.joint.named(later))
    add_terms(alone, alone.rank())
    _simplify(alone)
    return alone


def _as_before(search: Search, joint: Joint, free: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Residual and Jacobian by `free` of a model that has further terms at zero, as a search knows them: no program is
    needed. `None` where it has another set of parameters free.
    """
    before, more = search.optimum, sum(r.size for r in joint.fitted) - search.optimum.residual.size
    names, known = [p.name for p in joint.parameters], [search.joint.parameters[i].name for i in before.free]
    if sorted(names[i] for i in free) != sorted(known) or len(set(known)) < len(known):
        return None
    jacobian = before.jacobian[:, [known.index(names[i]) for i in free]]
    return np.pad(before.residual, (0, more)), np.pad(jacobian, ((0, more), (0, 0)))


def _simplify(alone: Search) -> None:
    """Give all records one number again where each got its own while more was missing, if that costs nothing now."""
    effects = alone.joint.model.effects
    for place in [i for i in alone.accepted if effects[i].where]:
        same = [i for i in alone.candidates() if effects[i].name == effects[place].name and not effects[i].where]
        for other in same:
            instead = [other if i == place else i for i in alone.accepted]
            fewer = alone.refit(instead, start=alone.without(place))
            if cost(fewer) <= cost(alone.optimum):
                alone.exchange(place, other, fewer)


def _explains_more(search: Search, first: Ranking, promise: Promise, best: Best | None) -> bool:
    """Whether terms of the instrument are worth a fit before the effects of the device.

    Beside an effect that leaves noise alone they must be as good, number by number; beside effects that together
    explain nearly all, nearly as good; else they must explain most of what is missing, and much of what effects would.
    """
    missing = excess(search.optimum)
    if not promise.chosen or search.accepted:  # then effects have had their turn
        return bool(promise.chosen) and promise.gain >= LITTLE * missing
    device = _promised_by_effects(search, first)
    if device is None or not device.chosen:
        return True
    if best is not None and best.optimum.leaves_noise:
        single = max(device.alone[best.number], cost(search.optimum) - cost(best.optimum))
        return promise.worth >= single - np.log(search.optimum.residual.size) - EVIDENT - ROUGHLY * single
    share = RIVAL if device.gain >= RIVAL * missing else FAINT
    return promise.gain >= max(share * device.gain, MOSTLY * missing)


def _promised_by_effects(search: Search, ranking: Ranking) -> Promise | None:
    """What further effects of the device promise; `None` where there is none."""
    low, high = search.joint.bounds
    blocks = [search.joint.of_effect(i) for i in ranking.places]
    offers = [Offer(s, low[b], high[b], np.full(b.size, np.inf)) for s, b in zip(ranking.slopes, blocks, strict=True)]
    return promised(search.optimum, offers, search.level) if offers else None


def add_terms(search: Search, ranking: Ranking) -> None:
    """Rounds over terms of the instrument, from a ranking of them, until none helps beyond chance."""
    stopped: set[int] = set()
    while (found := _best(search, ranking, stopped)) is not None:
        search.take(*found)
        ranking = search.rank()


def _is_of_interest(search: Search, first: Ranking) -> bool:
    """Whether an effect would be added, or a record is not explained."""
    tempted = bool(first.places) and first.p_values[first.order[0]] <= search.level
    return tempted or not all(e.explained for e in search.steps[-1].fit.errors)


def _best(search: Search, ranking: Ranking, stopped: set[int]) -> tuple[int, Optimum] | None:
    """The term that a refit favours of those that help beyond chance and explain part of what is left, and that refit;
    none whose strength its prior or the instrument excludes, which `stopped` remembers.
    """
    least = share_needed(0) * excess(search.optimum)
    promising = [
        i
        for i in ranking.order
        if ranking.p_values[i] <= search.level
        and ranking.places[i] not in stopped
        and BEYOND_LINEAR * ranking.scores[i].statistic >= least
    ][:LOOK_AHEAD]
    glances = {}
    search.joint.together((*search.given, *search.accepted, *(ranking.places[i] for i in promising)))
    for i in promising:
        places = [*search.accepted, ranking.places[i]]
        glances[ranking.places[i]] = search.refit(places, slopes=ranking.slopes[i], evaluations=GLANCE)
    for place, glance in sorted(glances.items(), key=lambda pair: pair[1].chi2 + 2.0 * pair[1].free.size):
        end = glance.converged or _is_pinned(search, place, glance)
        refit = glance if end else search.refit([*search.accepted, place], start=glance.vector)
        if _is_pinned(search, place, refit):
            stopped.add(place)
        elif refit.chi2 < search.optimum.chi2 - least:
            return place, refit
    return None


def _is_pinned(search: Search, place: int, optimum: Optimum) -> bool:
    low, high = (bound[search.joint.of_effect(place)] for bound in search.joint.bounds)
    value = optimum.vector[search.joint.of_effect(place)]
    return bool(np.any((value >= PINNED * high) | ((low < 0) & (value <= PINNED * low))))


def beside_terms(alone: Search, search: Search, effects: Sequence[Effect]) -> Search:
    """A search for effects of the device beside the terms that were found, which are given to it; effects that `search`
    was not given, but those terms stand beside, count as found.
    """
    model = alone.joint.at(alone.optimum.vector)
    kept = [model.effects[i] for i in sorted((*alone.given, *alone.accepted))]  # in the order of the signal
    own = len(search.given)
    found = [effect for effect in kept[own:] if not effect.of_instrument]
    terms = [effect for effect in kept[own:] if effect.of_instrument]
    others = [effect for effect in effects if effect.label not in {one.label for one in found}]
    plain = [r for r in alone.joint.readings if r.record.max(initial=-1) >= 0]
    given = [*kept[:own], *terms]
    known = knowledge([effect for effect in given if effect.of_instrument])
    joint = Joint(model.with_only((*given, *found, *others)), (*plain, *known), search.joint.programs)
    accepted = list(range(len(given), len(given) + len(found)))
    free = always_free(joint, range(len(given) + len(found)))
    optimum = optimise(joint, joint.start, free, joint.fitted, max_evaluations=0)
    out = Search(beside_case(alone.case, joint, optimum), search.level, range(len(given)), alone.tell)
    # The last step is of this model, which what is known beforehand of the terms left out is not part of.
    out.steps = [*alone.steps[:-1], replace(alone.steps[-1], fit=out.base)]
    out.base, out.accepted, out.keep = search.base, accepted, search.keep
    out.looked = search.looked
    out.own = tuple(i for i, e in enumerate(joint.model.effects) if e.label in _labels(search, search.own))
    out.keep(out)
    imitated(out)
    as_a_capacitance(out)
    return as_late(out)


def _labels(search: Search, places: Sequence[int]) -> set[str]:
    return {search.joint.model.effects[i].label for i in places}
