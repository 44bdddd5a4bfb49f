"""A candidate in the place of an effect that was accepted: one that was roughly right makes room for the exact one."""

from .confusions import uneven_instead
from .score import basis, score
from .search import CONFUSED, WORTH_A_LOOK, Ranking, Search


EXCHANGES = 4  # refits with one effect in the place of another, the most promising first


def exchange_one(search: Search, ranking: Ranking) -> bool:
    """Put a candidate in the place of an effect that was roughly right, where a fit with it is better.

    The first effect of a search takes what it can of all that is missing; the exact one, beside it, gains little.
    """
    tried = _pairs(search, ranking)
    if not tried:
        return False
    effects = search.joint.model.effects
    search.tell("try in the place of others: " + ", ".join(dict.fromkeys(effects[i].label for _, i in tried)))
    search.joint.together((*search.given, *search.accepted, *_with_uneven(search, ranking, tried)))
    for place, other in tried:
        instead = [other if i == place else i for i in search.accepted]
        least = search.optimum.chi2 - CONFUSED * (other not in search.own)
        refit = search.refit(instead, start=search.without(place), beat=least)
        if refit.chi2 < least and not search.refuses(other, refit):
            search.exchange(place, other, refit)
            return True
    return False


def stand_ins(search: Search, ranking: Ranking) -> list[int]:
    """Candidates that will be tried in the place of accepted effects before a search ends, the likeliest first."""
    return _with_uneven(search, ranking, _pairs(search, ranking))


def _with_uneven(search: Search, ranking: Ranking, pairs: list[tuple[int, int]]) -> list[int]:
    """The candidates of some pairs, and springs that `confusions` tries in the place of cubic ones."""
    uneven = [
        other
        for place in search.accepted
        for other in ranking.places
        if uneven_instead(search.joint, search.optimum.vector, place, other) is not None
    ]
    return list(dict.fromkeys((*(other for _, other in pairs), *uneven)))


def _pairs(search: Search, ranking: Ranking) -> list[tuple[int, int]]:
    """Accepted effects and candidates that may be better in their place, the most promising first."""
    pairs = []
    for place in search.accepted:
        mine, q = search.own_score(place), basis(search.jacobian_without(place))
        left = search.optimum.residual + search.taken_by(place)  # without the effect, to the first order
        for other, slopes in zip(ranking.places, ranking.slopes, strict=True):
            theirs = score(left, q, slopes).statistic
            if theirs >= WORTH_A_LOOK * mine.statistic or other in search.own:
                pairs.append((other not in search.own, mine.statistic - theirs, place, other))
    return [(place, other) for *_, place, other in sorted(pairs)[:EXCHANGES]]
