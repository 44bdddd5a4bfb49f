"""The rounds of a diagnosis: what a gradient finds and what needs a scan compete, and a rough effect makes room.

Everything here looks at fitted readings alone: those that validate are kept for the verdict.
"""

from dataclasses import replace

from memsgyro_jax.effects.lock_in_poles import LockInFilter
from memsgyro_jax.measurement.model import Model

from .acceptance import excess, hopeless, share_needed
from .effort import exhausted, far_from_noise
from .exchange import exchange_one
from .fewer import as_a_phase, take_out
from .fit import beside_case
from .joint_residual import Joint
from .nuisances import instrument_between
from .optimum import Optimum
from .resolved import sharpened, still_apart
from .rows_before import behind_filter, with_poles_chosen
from .scans import refined, scan, scans
from .search import ROUNDS, Ranking, Search
from .slow_noise import is_slow_noise


DECIDED = 25.0  # expected Δχ² from which an experiment counts as deciding
MOST = 0.9  # of the misfit: an effect that takes so much needs no rival from a scan


def search_on(search: Search, ranking: Ranking) -> tuple[Search, Ranking]:
    """Rounds from a ranking of the present model until nothing more stays; returns the last search and its ranking."""
    scanned: set[tuple[int, ...]] = set()
    if search.accepted:  # by a climb, which predicts at the first resolution
        coarse = search.joint
        _resolve(search)
        ranking = ranking if search.joint is coarse else search.rank()
    for _ in range(ROUNDS):
        if is_slow_noise(search, ranking) or (scanned and exhausted(search)):
            break
        if not is_noise(search):
            before = search.optimum
            search = behind_filter(search, ranking)
            ranking = ranking if search.optimum is before else search.rank()
        beside = instrument_between(search, ranking) if search.accepted and not is_noise(search) else None
        if beside is not None:
            search, ranking = beside, beside.rank()
        found, model = search.best(ranking), tuple(search.accepted)
        open_ = not is_noise(search) and model not in scanned
        if found is None and model and exhausted(search):
            break
        if open_ and (found is None or not (model or _takes_most(search, found[1]))):
            scanned.add(model)
            grown = _with_scan(search, search.optimum if found is None else found[1])
            if grown is not None:
                search = grown
                _resolve(search)
                ranking = search.rank()
                continue
        if found is not None:
            search.take(*found)
        elif is_noise(search) or not exchange_one(search, ranking):
            break
        _resolve(search)
        ranking = search.rank()
    with_poles_chosen(search)
    kept = list(search.accepted)
    if far_from_noise(search.optimum, search.base.optimum) and exhausted(search):
        return search, ranking
    search.prune()
    if search.accepted or any(isinstance(search.joint.model.effects[i], LockInFilter) for i in search.given):
        take_out(search)
    search = as_a_phase(search)
    return search, ranking if kept == search.accepted else search.rank()


def _resolve(search: Search) -> None:
    """Predict more finely from here on, where the effect just taken needs it."""
    model = search.joint.at(search.optimum.vector)
    readings, apart = sharpened(model, search.joint.readings, search.optimum.residual)
    if readings is not search.joint.readings:
        search.tell("predict more finely")
        search.joint, search.unseen = Joint(model, readings, search.joint.programs), None
        search.optimum = search.refit(search.accepted)
        apart = still_apart(search.joint.at(search.optimum.vector), readings) if apart else apart
        fit = beside_case(search.case, search.joint, search.optimum, apart)
        search.steps[-1] = replace(search.steps[-1], fit=fit)


def is_noise(search: Search) -> bool:
    """Whether noise alone explains what the fit leaves of every record that it saw."""
    return search.steps[-1].fit.leaves_noise


def _takes_most(search: Search, other: Optimum) -> bool:
    return excess(other) <= (1.0 - MOST) * excess(search.optimum)


def _with_scan(search: Search, rival: Optimum) -> Search | None:
    """The search with the best effect that needs a scan, if it explains more than the rival fit does."""
    bare, programs, best = _bare(search), search.joint.programs, None
    for grid in scans(search.case):
        search.tell(f"scan {grid[0].label}, {len(grid)} points")
        found = scan(bare, search.optimum, search.joint.fitted, grid, programs)
        if found and found.score.p_value * found.points <= search.level:
            finer = scan(bare, search.optimum, search.joint.fitted, refined(found.effect, grid), programs)
            found = finer if finer and finer.score.statistic > found.score.statistic else found
            if best is None or found.score.statistic > best.score.statistic:
                best = found
    if best is None or best.score.statistic <= search.optimum.chi2 - rival.chi2:
        return None
    if hopeless(best.score.statistic, search.optimum, len(search.accepted)):
        return None
    model = search.joint.at(search.optimum.vector).with_effect(best.effect)
    least = share_needed(len(search.accepted)) * excess(search.optimum)
    gain = max(DECIDED, search.optimum.chi2 - rival.chi2, least)
    joint = Joint(model, search.joint.readings, search.joint.programs)
    return search.grown(joint, len(model.effects) - 1, gain)


def _bare(search: Search) -> Model:
    """The fitted model with the accepted effects alone: smaller, and quicker to scan."""
    model = search.joint.at(search.optimum.vector)
    return model.with_only(model.effects[i] for i in sorted((*search.given, *search.accepted)))
