"""How long a search goes on that comes near nothing: by what it has taken and not by the clock, so that it ends alike
on every machine.
"""

from .acceptance import excess
from .optimum import POOR, Optimum
from .search import Search


MOST = 1200  # predictions of single experiments, after which a search that is far from noise begins nothing new
LONGER = 1.5  # times as many, after which one that is near does not either; what is found took 130 to 1100
NEARLY_ALL = 0.1  # of the misfit: where no more is left, a search is near, however long it took


def far_from_noise(found: Optimum, before: Optimum) -> bool:
    """Whether what a fit leaves is far above noise, and most of what was left before."""
    return found.chi2 > POOR * found.dof and excess(found) > NEARLY_ALL * excess(before)


def exhausted(search: Search) -> bool:
    """Whether a search has taken its share and leaves more than noise; that it was told so is remembered."""
    effort, found = search.joint.programs.effort, search.optimum
    share = effort.most * (1.0 if far_from_noise(found, search.base.optimum) else LONGER)
    if effort.spent <= share or found.leaves_noise:
        return False
    if not effort.ended:
        search.tell("look no further, as much has been tried")
    effort.ended = True
    return True


def of_effort(ended: bool) -> str:
    """A sentence on a search that was ended; empty for another."""
    return " The search was ended as much had been tried; `--thorough` lets it try the rest." if ended else ""
