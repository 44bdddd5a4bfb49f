"""An effect of chance at the end of a search: the readings that were fitted ask for it, those that were not deny it."""

from collections.abc import Callable, Sequence

from .fit import CaseFit
from .search import Search


def without_spoiler(search: Search, explained: Callable[[CaseFit, Sequence[int]], bool]) -> bool:
    """Whether the effect that a search took last was dropped, as it leaves records unexplained that were so before it.

    Some of many candidates always fit the noise of the readings that choose; records at other drives then tell.
    """
    before, last = search.steps[-2:] if len(search.steps) > 1 else (None, search.steps[-1])
    places = [i for i in search.accepted if search.joint.model.effects[i].label == last.added]
    if before is None or not places or places[0] in search.own:
        return False
    others = [i for i in search.accepted if i not in places]
    if explained(last.fit, search.accepted) or not explained(before.fit, others):
        return False
    search.optimum = search.refit(others, start=search.without(places[0]))
    search.accepted.remove(places[0])
    search.tell(f"dropped {last.added}, as records that were not fitted get worse by it")
    search.steps.pop()
    return True
