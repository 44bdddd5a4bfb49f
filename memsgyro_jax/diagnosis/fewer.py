"""Terms of the instrument that a model can do without, or with fewer numbers."""

from copy import copy
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy import special

from memsgyro_jax.effects import InstrumentTerm
from memsgyro_jax.effects.lock_in_terms import (
    CapacitiveFeedthrough,
    LateReadings,
    LockInFeedthrough,
    ReferencePhase,
)
from memsgyro_jax.effects.readout_delay import ReadoutDelay

from .acceptance import BEYOND_LINEAR, excess, too_late
from .estimates import unseen_terms
from .fit import beside_case
from .instrument import declared_terms, every_term, instrument_terms
from .joint_residual import Joint
from .optimum import Optimum, optimise
from .promise import offers_of, promised
from .score import basis, score
from .search import CONFUSED, WORTH_A_LOOK, Search, SearchStep, always_free


SHARE = 0.2  # of the level for terms of the instrument
MOST = 0.5  # of the misfit beyond noise, which must go with what comes late as a whole, or the lock-in's filter
SAME = 0.1  # of χ²: two fits that differ by less are one


def terms_of(search: Search) -> list[int]:
    """Places of the terms of the instrument that a search was given and its records show."""
    unseen = unseen_terms(search.joint, search.optimum)
    return [i for i, _ in _terms(search) if i not in unseen]


def _terms(search: Search) -> list[tuple[int, InstrumentTerm]]:
    effects = search.joint.model.effects
    return [(i, effect) for i in search.given if isinstance(effect := effects[i], InstrumentTerm)]


def take_out(search: Search) -> None:
    """Take terms of the instrument out again that the effects found since explain as well; not those that the case
    declares, which every ± is to hold.
    """
    upright(search)
    declared = {term.label for term in declared_terms(search.case)}
    for place in [i for i, term in _terms(search) if term.label not in declared]:
        size = search.joint.of_effect(place).size
        kept, search.given = search.given, tuple(i for i in search.given if i != place)
        most = search.optimum.chi2 + special.chdtri(size, SHARE * search.level)
        fewer = search.refit(search.accepted, start=search.without(place), beat=most)
        if fewer.chi2 >= most:
            search.given = kept
            continue
        search.optimum = fewer
        search.drop(search.joint.model.effects[place].label)


def imitated(search: Search) -> None:
    """Put what a term of the instrument imitates over a narrow band in its place, where that explains as much in fewer
    numbers: a phase that grows with the frequency looks like a part in proportion to the drive.
    """
    effects = search.joint.model.effects
    for place, term in _terms(search):
        for other in [i for i in search.candidates() if effects[i].label == term.imitates]:
            kept, search.given = search.given, tuple(i for i in search.given if i != place)
            search.joint.together((*kept, *search.accepted, other))  # the same program for the next of them
            if not _may_stand_for(search, other, place):
                search.given = kept
                continue
            start = search.without(place)
            fewer = search.refit([*search.accepted, other], start=start)
            worse = too_late(search.joint, other, fewer, search.case) or cost(fewer) > cost(search.optimum)
            if worse or cost(fewer) > cost(search.refit(search.accepted, start=start)):
                search.given = kept
                continue
            search.tell(f"dropped {term.label} for what it imitates")
            search.take(other, fewer)


def _may_stand_for(search: Search, other: int, place: int) -> bool:
    """Whether an effect would explain much of what another one at `place` does, to the first order."""
    units = np.eye(search.joint.start.size)[search.joint.of_effect(other)]
    slopes = search.joint.linearise(search.optimum.vector, units, search.joint.fitted)[1]
    left = search.optimum.residual + search.taken_by(place)
    theirs = score(left, basis(search.jacobian_without(place)), slopes)
    return theirs.statistic >= WORTH_A_LOOK * search.own_score(place).statistic


def as_a_capacitance(search: Search) -> None:
    """Put a feed-through that grows with the frequency in the place of one that does not, where the sweeps tell that it
    does: a wrong one moves the quality factor, and what it leaves passes for slow noise.
    """
    joint, fit = search.joint, search.steps[-1].fit
    # Where more is missing, what the two differ by may stand for that.
    least = CONFUSED * max(1.0, search.optimum.chi2 / search.optimum.dof)
    for place, term in [one for one in _terms(search) if isinstance(one[1], LockInFeedthrough)]:
        (twin,) = [t for t in every_term(search.case) if isinstance(t, CapacitiveFeedthrough)]
        # To the first order and beside the other, before a program of its own is made.
        if promised(search.optimum, offers_of(fit, [twin]), SHARE * search.level).gain < least:
            continue
        model = joint.at(search.optimum.vector)
        middle = np.median(np.concatenate([np.ravel(getattr(r.experiment, "frequency", [])) for r in joint.fitted]))
        twin = eqx.tree_at(lambda t: t.strength, twin, model.effects[place].strength / middle)
        effects = [twin if i == place else effect for i, effect in enumerate(model.effects)]
        whole = Joint(model.with_only(effects), joint.readings, joint.programs)
        optimum = optimise(whole, whole.start, always_free(whole, (*search.given, *search.accepted)), whole.fitted)
        if optimum.chi2 > search.optimum.chi2 - least:
            continue
        said = f"{twin.label} in place of {term.label}"
        fit = beside_case(search.case, whole, optimum)
        search.joint, search.optimum, search.unseen = whole, optimum, None
        search.steps = [*search.steps, SearchStep(said, fit)]
        search.tell(f"put {said}: χ²/dof {fit.chi2_per_dof:.4g}")


def as_late(search: Search) -> Search:
    """The search with what comes late as a whole beside a turned reference, where the sweeps tell that its angle runs
    with the frequency and this takes most of what is missing; the same search else.

    A late read-out of many periods is found by no step from none: its angle has turned often before its slope shows,
    and what leaks past the device is turned as well.
    """
    effects = search.joint.model.effects
    present = [effects[i] for i in (*search.given, *search.accepted)]
    late = [t for t in every_term(search.case) if isinstance(t, LateReadings)]
    if not late or any(isinstance(effect, ReadoutDelay | LateReadings) for effect in present):
        return search
    if not any(isinstance(effect, ReferencePhase) and not effect.where for effect in present):
        return search
    missing = excess(search.optimum)
    offer = promised(search.optimum, offers_of(search.steps[-1].fit, late), SHARE * search.level)
    if not offer.chosen or BEYOND_LINEAR * offer.gain < MOST * missing:
        return search
    out = with_given(search, late[0], search.optimum.vector)
    if excess(out.optimum) > (1.0 - MOST) * missing:
        return search
    search.tell(f"added {late[0].label}: χ²/dof {out.optimum.chi2 / out.optimum.dof:.4g}")
    return out


def with_given(search: Search, term: InstrumentTerm, vector: np.ndarray) -> Search:
    """The search to which a term of the instrument is given as well, behind those it was given, and fitted from a
    vector of its parameters on.
    """
    own = len(search.given)
    model = search.joint.at(vector)
    model = model.with_only((*model.effects[:own], term, *model.effects[own:]))
    whole = Joint(model, search.joint.readings, search.joint.programs)
    accepted = [i + 1 for i in search.accepted]
    optimum = optimise(whole, whole.start, always_free(whole, (*range(own + 1), *accepted)), whole.fitted)
    out = Search(search.base, search.level, range(own + 1), search.tell)
    out.joint, out.optimum, out.accepted, out.keep = whole, optimum, accepted, search.keep
    out.own, out.looked = tuple(i + 1 for i in search.own), search.looked
    out.steps = [*search.steps, SearchStep(term.label, beside_case(search.case, whole, optimum))]
    return out


def as_a_phase(search: Search) -> Search:
    """The search with a turned reference of the lock-in in the place of a late read-out, where the records cannot tell
    them apart: over a narrow band a delay is a phase, which says less of the device. Else the same search.
    """
    joint, effects = search.joint, search.joint.model.effects
    late = [i for i in search.accepted if isinstance(effects[i], ReadoutDelay)]
    turned = [t for t in instrument_terms(search.case) if isinstance(t, ReferencePhase) and not t.where]
    if not late or not turned or any(isinstance(effects[i], ReferencePhase) for i in search.given):
        return search
    model = joint.at(search.optimum.vector)
    angle = -float(np.sqrt(model.device.stiffness[0]) * model.effects[late[0]].strength)
    prompt = model.prompt.with_effect(eqx.tree_at(lambda term: term.strength, turned[0], jnp.array([angle])))
    given = (*search.given, len(prompt.effects) - 1)
    accepted = [i for i in search.accepted if i not in late]
    whole = Joint(prompt, joint.readings, joint.programs)
    optimum = optimise(whole, whole.start, always_free(whole, (*given, *accepted)), whole.fitted)
    if optimum.chi2 > search.optimum.chi2 + CONFUSED:
        return search
    said = f"{turned[0].label} in place of {effects[late[0]].label}"
    search.tell(f"put {said}, which these records cannot tell apart")
    out = Search(search.base, search.level, given, search.tell)
    out.joint, out.optimum, out.accepted, out.own, out.keep = whole, optimum, accepted, search.own, search.keep
    out.looked = search.looked
    out.steps = [*search.steps, SearchStep(said, beside_case(search.case, whole, optimum))]
    upright(out)
    return out


def upright(search: Search) -> None:
    """Take whole turns off angles of the instrument, and half ones where a channel may be turned round instead."""
    joint, vector = search.joint, search.optimum.vector.copy()
    (gain,) = [i for i, parameter in enumerate(joint.parameters) if parameter.name == "1/m"]
    for angles in [joint.of_effect(i) for i, term in _terms(search) if term.turns]:
        halves = np.round(vector[angles] / np.pi)
        if joint.bounds[0][gain] < 0 and np.all(halves % 2 == 1):
            vector[gain] = -vector[gain]
        else:
            halves = 2.0 * np.round(vector[angles] / (2.0 * np.pi))
        vector[angles] -= np.pi * halves
    if np.array_equal(vector, search.optimum.vector):
        return
    turned = search.refit(search.accepted, start=vector)
    if turned.chi2 <= search.optimum.chi2 + SAME:
        search.optimum = turned
        last = replace(search.steps[-1], fit=beside_case(search.case, joint, turned))
        search.steps = [*search.steps[:-1], last]


def cost(optimum: Optimum) -> float:
    """χ² and what each free number that the records hold must gain: the Bayesian information criterion."""
    held = optimum.free.size - len(optimum.frozen)
    return optimum.chi2 + held * float(np.log(optimum.residual.size))


def by_itself(search: Search) -> Search:
    """The same search, which may go on by itself."""
    out = copy(search)
    out.accepted, out.steps = list(search.accepted), list(search.steps)
    return out
