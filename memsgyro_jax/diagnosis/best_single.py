"""The one effect that explains most by itself, by fits and not by slopes alone."""

from itertools import takewhile
from typing import NamedTuple

from .acceptance import excess
from .fewer import cost
from .optimum import Optimum
from .search import Ranking, Search


LOOKED = 3  # effects of a ranking that are fitted, one by one
MOST = 0.9  # of the misfit: what explains so much is not looked beyond


class Best(NamedTuple):
    """The best single effect of the device: its number in the ranking, its label, and a fit with it."""

    number: int
    label: str
    optimum: Optimum


def best_single(search: Search, first: Ranking, then: int = 0) -> Best | None:
    """The best single effect of the device, if one helps beyond chance: of the first few of the ranking the one that
    fits best, as a large strength is not told by its slope (a channel eight times as sensitive as the other). One of so
    many that come `then` will be tried beside it.
    """
    found: list[Best] = []
    looked = list(takewhile(lambda number: first.p_values[number] <= search.level, first.order[:LOOKED]))
    others = [first.places[number] for number in first.order[LOOKED : LOOKED + then]]
    search.joint.together((*search.given, *(first.places[number] for number in looked)), search.joint.named(others))
    for number in looked:
        fit = search.refit([first.places[number]], slopes=first.slopes[number])
        found.append(Best(number, search.joint.model.effects[first.places[number]].label, fit))
        if excess(fit) <= (1.0 - MOST) * excess(search.optimum):
            break
    return min(found, key=lambda one: cost(one.optimum), default=None)
