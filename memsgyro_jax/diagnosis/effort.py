"""How long a search goes on that comes near nothing: by what it has taken and not by the clock, so that it ends alike
on every machine.
"""

from .acceptance import excess
from .optimum import POOR, Optimum
from .search import Search


MOST = 1000  # predictions of single experiments, after which a search that is far from noise begins nothing new
NEARLY_ALL = 0.1  # of the misfit: where no more is left, a search is near, however long it took


def far_from_noise(found: Optimum, before: Optimum) -> bool:
    """Whether what a fit leaves is far above noise, and most of what was left before."""
    return found.chi2 > POOR * found.dof and excess(found) > NEARLY_ALL * excess(before)


def exhausted(search: Search) -> bool:
    """Whether a search has taken its share and is far from noise; that it was told so is remembered."""
    effort = search.joint.programs.effort
    if effort.spent <= effort.most or not far_from_noise(search.optimum, search.base.optimum):
        return False
    if not effort.ended:
        search.tell("look no further, as nothing has come near what was read")
    effort.ended = True
    return True


def of_effort(ended: bool) -> str:
    """A sentence on a search that was ended; empty for another."""
    if not ended:
        return ""
    return " The search was ended where nothing had come near what was read; `--thorough` lets it try the rest."
