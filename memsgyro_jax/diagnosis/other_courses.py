"""Effects in whose place another course with temperature and bias may stand, as no setting is left to judge theirs."""

from collections.abc import Sequence
from dataclasses import replace

from .findings import Accepted
from .search import Search
from .sentence import COURSE
from .settings_apart import as_many_as_settings, in_each_place


def beside_other_courses(search: Search, accepted: Sequence[Accepted]) -> tuple[Accepted, ...]:
    """What was accepted; those effects that settings at which both vary are too few to bear out are confused with a
    course of another kind.
    """
    if len(accepted) < 2:
        return tuple(accepted)
    loose = as_many_as_settings(search.joint, in_each_place(search.case), search.accepted)
    labels = {search.joint.model.effects[i].label for i in loose}
    return tuple(replace(a, confused_with=(*a.confused_with, COURSE)) if a.label in labels else a for a in accepted)
