"""The first effect of a device that is driven hard: found at its lowest drive and followed up to the highest.

Where a resonance has bent over, a fit to all drives at once has no valley to the truth: the base model flees from its
resonance, and what an effect would do to first order says nothing. At the lowest drive both are nearly right, and what
is found there starts a fit with the next drive.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from memsgyro_jax.base.runtime import usable_cores
from memsgyro_jax.base.threads import in_threads
from memsgyro_jax.effects import Effect, ForceEffect
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.drive_levels import clear_drives
from memsgyro_jax.measurement.least_squares import Information

from .acceptance import THIRD, excess
from .best_single import best_single
from .drives import FAR, calm, driven_axes, past_the_brink, stages
from .fewer import take_out, terms_of
from .fit import CaseFit, beside_case
from .instrument import instrument_terms
from .joint_residual import Joint
from .nuisances import beside_terms
from .optimum import Optimum, optimise
from .programs import SPARE
from .score import basis
from .search import LOOK_AHEAD, Ranking, Search, always_free


STRENGTHS = np.geomspace(1e-2, 1e2, 25)  # of the size of a strength, that are tried: a width of the resonance apart
COARSE = 3  # every so many of them above a drive at which the base model is near: a fit from there is tried as well
LOWEST = "the base model is that of the lowest drive, as what is missing grows with the drive"
BEGINNING = "the base model is that with which the search began, as none is near all records"
WORSE = 2.0  # times what is left without an effect: strengths beyond two of which leave that are not tried
TENTH = 0.1  # of the misfit that the best single effect leaves: what a climb must come to


@dataclass(frozen=True, eq=False)
class Climb:
    """Where a climb began, and what it tried.

    Args:
        base: the base model at the lowest drive, beside every record.
        ends: effects that were followed up to the highest drive, each with the χ² that is left there beside those of
            before; the one that stays first.
        whence: a sentence on what the base model is that of.
    """

    base: CaseFit
    ends: tuple[tuple[Effect, float], ...]
    whence: str


def climbed(search: Search, first: Ranking, effects: Sequence[Effect]) -> tuple[Search, Climb | None]:
    """The search with the effect that a climb over the drives finds, beside what the lock-in does to every phasor,
    where the base model is far off, as it is with the best effect in one step, which leaves ten times as much, and how
    it went; the same search and `None` else.

    Args:
        search, first: at the base model, and the effects of the device beside it.
        effects: those of the device that are candidates.
    """
    steps = stages(search.case, search.joint.fitted)
    if not steps or not first.places or search.optimum.chi2 < FAR * search.optimum.dof:
        return search, None
    if by_surroundings(search, steps):
        return search, None
    usual = _in_steps(search, first)
    if usual.chi2 < FAR * usual.dof:
        return search, None
    beside = beside_lock_in(search)
    terms = ", ".join(beside.joint.model.effects[i].label for i in beside.given if i not in search.given)
    search.tell("climb from the lowest drive, one effect after the other" + (f", beside {terms}" if terms else ""))
    return followed(beside, search, effects, steps, usual, beside.joint.start)


def _in_steps(search: Search, first: Ranking) -> Optimum:
    """The fit with the best effect in one step, or where that is far off and the device has two axes, with another."""
    found, step = best_single(search, first, then=SPARE), copy(search)
    best = first.order[0] if found is None else found.number
    step.optimum = search.refit([first.places[best]], slopes=first.slopes[best])
    step.accepted = [first.places[best]]
    if step.optimum.chi2 < FAR * step.optimum.dof or search.joint.model.axes == 1:
        return step.optimum
    second = step.rank()
    if not second.places:
        return step.optimum
    best = second.order[0]
    return step.refit([*step.accepted, second.places[best]], slopes=second.slopes[best])


def followed(
    beside: Search, search: Search, effects: Sequence[Effect], steps: list[tuple], usual: Optimum, start: np.ndarray
) -> tuple[Search, Climb | None]:
    """The search with one effect more that was followed over the drives, or one for each axis, and how; `search` and
    `None` where that does not leave a tenth of what another fit does.

    Args:
        beside: has what is free from the lowest drive on: what the lock-in does, effects that were found there.
        search: to go on with, and the effects of the device that are candidates.
        effects: those.
        steps: the readings from stage to stage, as `stages` gives them.
        usual: the other fit.
        start: parameters from which the lowest drive is fitted.
    """
    base = _lowest(beside, steps[0], start)
    first = _first_far(beside, base, steps)
    if first is None:  # the lock-in alone was off
        return search, None
    tried: list[tuple[Effect, float]] = []
    straight, before = None, np.inf
    most = len(beside.accepted) + beside.joint.model.axes  # one of each axis
    while len(beside.accepted) < most:
        ends = _ends(beside, base, steps, len(steps) - 1 if first is None else first)
        if not ends:
            break
        place, end = min(ends, key=lambda one: one[1].chi2)
        if straight is None:
            straight = _as_it_is(beside.joint, base, always_free(beside.joint, (*_held(beside), place)))
            before = excess(straight)
        enough = excess(end) <= TENTH * excess(usual)
        if beside.refuses(place, end) or not (enough or excess(end) <= (1.0 - THIRD) * before):
            break
        tried += sorted(((beside.joint.model.effects[i], one.chi2) for i, one in ends), key=lambda pair: pair[1])
        beside.take(place, end)
        if enough:
            climb = Climb(beside_case(search.case, beside.joint, straight), tuple(tried), whence(search.case))
            return as_found(beside, search, effects), climb
        base, before = _lowest(beside, steps[0], end.vector), excess(end)
        first = _first_far(beside, base, steps)
    return search, None


def whence(case: Case) -> str:
    """What the base model of a climb is that of."""
    return LOWEST if len(clear_drives(case)) > 1 else BEGINNING


def by_surroundings(search: Search, steps: Sequence[tuple]) -> bool:
    """Whether the base model is far off for the temperature, bias voltage and rate of some rows alone: all others it is
    near at every drive, also as the lowest drive tells it.
    """
    joint, free = search.joint, search.optimum.free
    others = calm(search.case, joint.fitted)
    if not others or [*map(id, others)] == [*map(id, joint.fitted)]:
        return False
    lowest = calm(search.case, steps[0])
    if not lowest:
        return False
    told = optimise(joint, joint.start, free, lowest)
    beside = optimise(joint, told.vector, free, others, max_evaluations=0)
    return beside.chi2 < FAR * beside.dof


def beside_lock_in(search: Search) -> Search:
    """The same search, given what a lock-in does to every phasor: nothing fits a resonance that bends over before that
    does.
    """
    held = {effect.label for effect in search.joint.model.effects}
    terms = [t for t in instrument_terms(search.case) if t.of_every_phasor and not t.where and t.label not in held]
    model = search.joint.model.with_effect(*terms)
    places = range(len(model.effects) - len(terms), len(model.effects))
    out = Search(search.base, search.level, (*search.given, *places), search.tell)
    out.joint, out.own, out.keep = Joint(model, search.joint.readings, search.joint.programs), search.own, search.keep
    out.looked = search.looked
    return out


def as_found(beside: Search, search: Search, effects: Sequence[Effect]) -> Search:
    """A search that was given terms of the lock-in as one that found those of them that the records ask for."""
    found = list(beside.steps)
    take_out(beside)
    beside.accepted += [i for i in beside.given if i not in search.given]
    beside.given = search.given
    beside.steps = [*found[:-1], replace(found[-1], fit=beside_case(beside.case, beside.joint, beside.optimum))]
    return beside_terms(beside, search, effects)


def _lowest(search: Search, lowest: tuple, start: np.ndarray) -> Optimum:
    """The base model at the lowest drive, with effects that were found; where even that bends the resonance over, the
    linear device it started as.
    """
    joint, free = search.joint, always_free(search.joint, _held(search))
    fitted = optimise(joint, start, free, lowest)
    return fitted if fitted.chi2 < FAR * fitted.dof else optimise(joint, start, free, lowest, max_evaluations=0)


def _held(search: Search) -> tuple[int, ...]:
    """Places of the effects that are free all the way."""
    return *search.given, *search.accepted


def _tempting(search: Search, base: Optimum, where: tuple, strengths: np.ndarray) -> dict[int, np.ndarray]:
    """Forces that the first drive at which the base model is far off asks for most, and parameters with each from which
    a fit there may begin.

    What they would do to first order says nothing there: each is tried at `strengths` times one that changes the
    readings as much as they are missed, and stands for the best of them.
    """
    joint, places = search.joint, [i for i in search.candidates() if search.joint.of_effect(i).size == 1]
    if not places:
        return {}
    columns = np.concatenate([joint.of_effect(i) for i in places])
    left, slopes = joint.linearise(base.vector, np.eye(joint.start.size)[columns], where)
    shown = np.linalg.norm(np.where(np.isfinite(slopes), slopes, 0.0), axis=0)
    forces = {
        i: np.linalg.norm(left) / size
        for i, size in zip(places, shown, strict=True)
        if size > 0.0 and isinstance(joint.model.effects[i], ForceEffect)
    }
    joint.together((*_held(search), *forces), spare=len(forces))  # a call takes less than another program
    with in_threads(usable_cores()) as over:
        strongest = over(lambda i: _best_strength(search, base, i, forces[i] * strengths, where), forces)
        best = dict(zip(forces, strongest, strict=True))
    chosen = sorted(forces, key=lambda i: best[i][1])
    return {i: best[i][0] for i in chosen if i in search.own or i in chosen[:LOOK_AHEAD]}


def _ends(search: Search, base: Optimum, steps: list[tuple], first: int) -> list[tuple[int, Optimum]]:
    """Where each of the effects ends that are tempting at the drive `first`; others are not tried once one leaves
    nothing but noise, unless they are the user's own.
    """
    tempting = _tempting(search, base, steps[first], STRENGTHS[:: COARSE if first else 1])
    ends: list[tuple[int, Optimum]] = []
    search.joint.together((*_held(search), *tempting))
    for i in sorted(tempting, key=lambda i: i not in search.own):
        if i not in search.own and any(excess(end) == 0.0 for _, end in ends):
            break
        search.tell(f"climb with {search.joint.model.effects[i].label}")
        end = _up(search, base, i, tempting[i], steps, first)
        ends += [] if end is None else [(i, end)]
    return ends


def _first_far(search: Search, base: Optimum, steps: list[tuple]) -> int | None:
    """The first stage at which a fit to the lowest drive is far from what is read; `None` where there is none."""

    def far(step: tuple) -> bool:
        beside = optimise(search.joint, base.vector, base.free, step, max_evaluations=0)
        return not beside.chi2 < FAR * beside.dof

    return next((k for k, step in enumerate(steps) if far(step)), None)


def _as_it_is(joint: Joint, base: Optimum, places: np.ndarray) -> Optimum:
    """A fit beside all that is fitted, by the program of a model in which what is at `places` may move too: one of its
    own takes longer to compile.
    """
    beside = optimise(joint, base.vector, places, joint.fitted, max_evaluations=0)
    slopes = beside.jacobian[:, np.isin(places, base.free)]
    begin = Information.of(slopes)
    return replace(base, residual=beside.residual, jacobian=slopes, frozen=begin.directions[~begin.held])


def _up(search: Search, base: Optimum, place: int, begin: np.ndarray, steps: list[tuple], first: int) -> Optimum | None:
    """A fit with one effect more that starts at the lowest drive, without it, and at the drive `first` also where
    another fit may begin; `None` where it does not take most there, unless it is the user's own.
    """
    joint, free = search.joint, always_free(search.joint, (*_held(search), place))
    end = base
    for k, step in enumerate(steps):
        end = optimise(joint, end.vector, free, step)
        if k == first and end.chi2 > FAR * end.dof:
            end = min(end, optimise(joint, begin, free, step), key=lambda one: one.chi2)
        if k == first and place not in search.own and not _takes_most(joint, base, end, step):
            return None
    return past_the_brink(search.case, joint, end)


def _takes_most(joint: Joint, base: Optimum, end: Optimum, step: tuple) -> bool:
    """Whether a fit leaves a tenth of what the base model does along an axis on which that is far off: so much does the
    effect that is missing where it begins to show, whatever the other axis lacks.
    """
    before = optimise(joint, base.vector, base.free, step, max_evaluations=0).residual
    axes = driven_axes(step)
    told = [(before[axes == axis], end.residual[axes == axis]) for axis in np.unique(axes)]
    far = [(float(b @ b), float(a @ a)) for b, a in told if b @ b >= FAR * np.count_nonzero(b)]
    return not far or any(after <= TENTH * left for left, after in far)


def _best_strength(
    search: Search, base: Optimum, place: int, sizes: np.ndarray, where: tuple
) -> tuple[np.ndarray, float]:
    """Base parameters with the strength of one effect that leaves least of what is read, and χ², when what readings
    are linear in has been taken off.
    """
    joint = search.joint
    low, high = (bound[joint.of_effect(place)] for bound in joint.bounds)
    units = np.eye(joint.start.size)[[i for term in terms_of(search) for i in joint.of_effect(term)]]

    def with_strength(strength: float) -> np.ndarray:
        vector = base.vector.copy()
        vector[joint.of_effect(place)] = strength
        return vector

    def misfit(vector: np.ndarray) -> float:
        left, slopes = joint.linearise(vector, units, where)
        if not (np.isfinite(left).all() and np.isfinite(slopes).all()):
            return np.inf
        left = left - basis(slopes) @ (basis(slopes).T @ left)
        return float(left @ left)

    best = with_strength(0.0)
    least = without = misfit(best)
    for sign in (1, -1):
        before = without
        for strength in np.unique(np.clip(sign * sizes, low, high))[::sign]:
            left = misfit(vector := with_strength(strength))
            if left < least:
                best, least = vector, left
            if min(left, before) > WORSE * without:  # far beyond, where every prediction takes long
                break
            before = left
    return best, least
