"""A resonance that wanders over sweeps which follow each other by one clock, as in an oven that is not settled yet.

A course of many numbers imitates much. So it has no more of them than there are single sweeps, each of which passes the
resonance once, and it is kept only where it takes nearly all of what is missing.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from memsgyro_jax.effects import InstrumentTerm
from memsgyro_jax.effects.instrument import FrequencyDrift, FrequencyOffset, FrequencyWander
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.drive_levels import ALIKE, levels_apart
from memsgyro_jax.measurement.phasor_fit import device_of_phasors

from .acceptance import excess
from .best_single import best_single
from .effort import NEARLY_ALL
from .fewer import SHARE, by_itself, cost, take_out
from .findings import Accepted
from .fit import CaseFit, beside_case
from .instrument import LONGER, frequency_wander, instrument_terms
from .joint_residual import Joint
from .optimum import Optimum, optimise
from .promise import offers_of, promised, promised_by_effects
from .row_groups import Place, RowGroups
from .score import basis
from .search import CONFUSED, Ranking, Search, SearchStep, always_free
from .worth_trying import count_biases, count_temperatures


STIFF = 1e-3  # of a shift, by which a course rather bends less than meets what a sweep shows by itself
INSIDE = 0.9  # of a bound, at which a course may begin
OTHERS = (FrequencyDrift, FrequencyOffset, FrequencyWander)  # of which a course over all records takes the place


End = tuple[Search, Ranking]
Ends = list[End]


class Passed(NamedTuple):
    """What a single sweep shows by itself, at the time [s] at which it passed the resonance, over what a model shows
    there: stiffness and damping of the axis that it drives, and the mobility.
    """

    axis: int
    time: float
    stiffness: float
    damping: float
    mobility: float


def with_wander_first(search: Search, ranking: Ranking) -> Search | None:
    """The search beside a resonance that wanders, and what a lock-in does to every phasor where that is needed, if they
    leave noise alone of every record and the present model does not; `None` else, and where plainer terms or effects of
    the device may do as well, or other surroundings may move the resonance.

    Args:
        search, ranking: at the base model or its first effect, and the further effects of the device beside it.
    """
    surroundings = count_temperatures(search.case) > 1 or count_biases(search.case) > 1
    if surroundings or all(error.explained for error in search.steps[-1].fit.errors):
        return None
    held = {search.joint.model.effects[i].label for i in search.given}
    others = [term for term in instrument_terms(search.case) if term.label not in held]
    found = with_wander(search, [term for term in others if term.of_every_phasor and not term.where])
    if found is None or not all(error.explained for error in found.steps[-1].fit.errors):
        return None
    gain = cost(search.optimum) - cost(found.optimum)
    plain = promised(search.optimum, offers_of(search.steps[-1].fit, others), SHARE * search.level)
    device = promised_by_effects(search, ranking)
    if max(plain.worth, 0.0 if device is None else device.worth) >= gain:
        return None
    best = None if search.accepted else best_single(search, ranking)
    if best is not None and cost(best.optimum) <= cost(found.optimum):
        return None
    take_out(found)
    found.steps = [*search.steps, replace(found.steps[-1], added=FrequencyWander.name)]
    found.keep(found)
    return found


def with_wander(search: Search, terms: Sequence[InstrumentTerm] = ()) -> Search | None:
    """The search beside a resonance that wanders, in place of drifts and offsets of the frequency, and further terms of
    the instrument, where that takes nearly all of what is missing; `None` else, and where an even drift does as well.
    """
    most = frequency_wander(search.case)
    if most is None or _wanderers(search):
        return None
    seen = list(_passes(search.steps[-1].fit))
    if len(seen) < 2:
        return None
    search.tell(f"try a resonance that wanders in time, in up to {most.strength.size} parts")
    joint, order = _beside(search, (*terms, most))
    place, given = order.index(-1) + len(terms), tuple(range(order.index(-1) + len(terms) + 1))
    accepted = [order.index(i) for i in search.accepted]
    parts = joint.of_effect(place)
    free, start = always_free(joint, (*given, *accepted)), _start(joint, most, parts, seen)
    if accepted:  # first what they come to beside a device that has changed
        theirs = np.concatenate([joint.of_effect(i) for i in accepted])
        start = optimise(joint, start, theirs, joint.fitted).vector
    found = optimise(joint, start, free, joint.fitted)
    if excess(found) > NEARLY_ALL * excess(search.optimum) or (needed := _needed(found, parts)) < 2:
        return None
    if needed < parts.size:
        vector = np.delete(found.vector, parts[needed:])
        joint, _ = _beside(search, (*terms, frequency_wander(search.case, needed)))
        found = optimise(joint, vector, always_free(joint, (*given, *accepted)), joint.fitted)
    search.tell(f"in {needed} parts it leaves χ²/dof {found.chi2 / found.dof:.4g}")
    out = Search(search.base, search.level, given, search.tell)
    out.joint, out.optimum, out.accepted, out.keep = joint, found, accepted, search.keep
    out.own, out.looked = tuple(order.index(i) for i in search.own), search.looked
    out.steps = [*search.steps, SearchStep(most.label, beside_case(search.case, joint, found))]
    return out


def beside_course(begin: Search, go_on: Callable[[Search, Ranking], End]) -> End:
    """The end of a search for effects of the device beside a course that leaves noise alone; the course by itself where
    a longer one takes as much of the little that was left, as the true one does not end with its last part.

    Args:
        begin: beside the course.
        go_on: the search for effects, from another and its ranking.
    """
    ranking = begin.rank()
    found, last = go_on(by_itself(begin), ranking)
    most = frequency_wander(begin.case)
    if not found.accepted or most is None:
        return found, last
    longer = _longer(begin, frequency_wander(begin.case, int(LONGER * most.strength.size)))
    if longer.chi2 > found.optimum.chi2 + CONFUSED:
        return found, last
    begin.tell("a longer course explains as much")
    return begin, ranking


def _longer(begin: Search, term: FrequencyWander) -> Optimum:
    """A fit with a longer course in the place of the one that a search was given."""
    joint, order = _beside(begin, (term,))
    (place,), mine = _wanderers(begin), joint.of_effect(order.index(-1))
    course, vector = begin.joint.of_effect(place), joint.start.copy()
    vector[mine[: course.size]] = begin.optimum.vector[course]
    return optimise(joint, vector, always_free(joint, range(order.index(-1) + 1)), joint.fitted)


def wander_at_last(ends: Ends, go_on: Callable[[Search, Ranking], End], done: Callable[[Search], bool]) -> Ends:
    """The end of a search beside a resonance that wanders, where none of some `ends` explains the records and that one
    does; else none.

    Args:
        ends: searches and their rankings.
        go_on: the search for effects of the device.
        done: whether a search leaves nothing to explain.
    """
    if any(done(search) for search, _ in ends):
        return []
    wander = with_wander(min((search for search, _ in ends), key=lambda search: cost(search.optimum)))
    if wander is None:
        return []
    found, ranking = go_on(wander, wander.rank())
    take_out(found)
    return [(found, ranking)] if done(found) else []


def goes_with_drive(search: Search) -> bool:
    """Whether a resonance that is another at each drive level explains what is fitted as well as one that wanders in
    time does, so that nothing tells the two apart; to the first order about the course that was found.
    """
    levels = _by_drive(search.case)[1:]
    if not levels or not _wanderers(search):
        return False
    (place,) = _wanderers(search)
    instead = FrequencyOffset(np.zeros(len(levels)), RowGroups.of(search.case).table(levels))
    (offer,) = offers_of(search.steps[-1].fit, [instead])
    q = basis(np.column_stack([search.jacobian_without(place), offer.slopes]))
    left = search.optimum.residual + search.taken_by(place)
    return float(np.sum((left - q @ (q.T @ left)) ** 2)) <= search.optimum.chi2 + CONFUSED


def _by_drive(case: Case) -> list[set[Place]]:
    """The single sweeps of each axis and drive level, whichever records they are of."""
    found: dict[tuple[int, int], set[Place]] = {}
    swept: list[tuple[int, Any]] = [(k, record) for k, record in enumerate(case.records) if hasattr(record, "setting")]
    told = [(k, i, r.axis, float(np.mean(r.setting[rows]))) for k, r in swept for i, rows in enumerate(r.sweeps)]
    levels = (1.0 + ALIKE) * np.array(levels_apart(level for *_, level in told))
    for number, sweep, axis, level in told:
        found.setdefault((axis, int(np.searchsorted(levels, level))), set()).add((number, sweep))
    return list(found.values())


def wanders(terms: Sequence[Accepted]) -> bool:
    """Whether the resonance wanders, by what the instrument was found to do."""
    return any(term.name == FrequencyWander.name for term in terms)


def of_wander(search: Search) -> str:
    """Sentences on what moves a resonance that wanders, and on what these records cannot tell from it; empty where none
    does.
    """
    if not _wanderers(search):
        return ""
    why = " An oven moves a resonance so, or a drive that warms the device over longer than a sweep."
    if not goes_with_drive(search):
        return why
    return why + (
        " These records cannot tell a resonance that wanders in time from one that goes with the drive, as each drive "
        "has its own time: repeat the first drive at the end."
    )


def _wanderers(search: Search) -> list[int]:
    """The place of the course that a search was given, if it was."""
    return [i for i in search.given if isinstance(search.joint.model.effects[i], FrequencyWander)]


def _beside(search: Search, terms: Sequence[InstrumentTerm]) -> tuple[Joint, list[int]]:
    """The present model of a search with terms behind those it was given, and without `OTHERS`; and where each of its
    effects stands in that of the search, −1 for the new ones.
    """
    model = search.joint.at(search.optimum.vector)
    kept = [i for i in search.given if not isinstance(model.effects[i], OTHERS)]
    device = [i for i, effect in enumerate(model.effects) if i not in kept and not effect.of_instrument]
    every = (*(model.effects[i] for i in kept), *terms, *(model.effects[i] for i in device))
    return Joint(model.with_only(every), search.joint.readings, search.joint.programs), [
        *kept, *(-1 for _ in terms), *device,
    ]  # fmt: skip


def _passes(fit: CaseFit) -> Iterator[Passed]:
    """What each single sweep that may be fitted shows beside a model, both as the linear device that it looks like."""
    record: Any
    for number, record in enumerate(fit.case.records):
        if record.role == "validation" or not record.stepped or getattr(record, "time", None) is None:
            continue
        predicted = fit.predicted(number)
        seen = np.isfinite(predicted).all(axis=1)
        for rows in record.sweeps:
            mine = np.flatnonzero(seen & np.isin(np.arange(record.rows), np.arange(record.rows)[rows]))
            read, model = (
                _looks_like(one.only(mine), fit.case) for one in (record, replace(record, phasors=predicted))
            )
            if read is not None and model is not None:
                time = record.time[mine][np.argmax(np.abs(record.readings[mine, record.axis]))]
                yield Passed(record.axis, float(time), *(read / model))


def _looks_like(sweep: Any, case: Case) -> np.ndarray | None:
    """Stiffness and damping per mass of the axis that is driven, and mobility, of the linear device that a sweep looks
    like.
    """
    told = sweep.starting_phasors(case) if sweep.rows else None
    device = None if told is None else device_of_phasors([told])
    if told is None or device is None:
        return None
    own = 0 if told.motion.shape[1] == 1 else sweep.axis
    return np.array([device.stiffness[own], device.damping[own], device.mobility])


def _start(joint: Joint, term: FrequencyWander, parts: np.ndarray, seen: Sequence[Passed]) -> np.ndarray:
    """Parameters at which each sweep passes the resonance where it shows it: the smoothest such course, and the device
    that most of them show.
    """
    names = [parameter.name for parameter in joint.parameters]
    vector, begin, span = joint.start.copy(), float(np.min(term.begin)), float(np.max(term.span))
    axes = np.array([one.axis for one in seen])
    each = (axes[:, None] == np.unique(axes)).astype(float)
    course = np.asarray(term.course((np.array([one.time for one in seen]) - begin) / span))
    bends = np.diag(STIFF * np.arange(1, parts.size + 1.0) ** 2)
    whole = np.block([[course, each], [bends, np.zeros((parts.size, each.shape[1]))]])
    shifts = 0.5 * np.log([one.stiffness for one in seen])
    solved = np.linalg.lstsq(whole, np.concatenate([shifts, np.zeros(parts.size)]))[0]
    vector[parts] = np.clip(solved[: parts.size], *(INSIDE * bound[parts] for bound in joint.bounds))
    for axis, level in zip(np.unique(axes), solved[parts.size :], strict=True):
        pair = "" if joint.model.axes == 1 else 2 * "xy"[axis]
        vector[names.index(f"k{pair}/m")] *= np.exp(2.0 * level)
        vector[names.index(f"d{pair}/m")] *= np.median([one.damping for one in seen if one.axis == axis])
    vector[names.index("1/m")] *= np.median([one.mobility for one in seen])
    return vector


def _needed(found: Optimum, parts: np.ndarray) -> int:
    """How many parts of a course pay for themselves by the Bayesian information criterion, to the first order."""
    mine = [int(np.flatnonzero(found.free == place)[0]) for place in parts]
    price = float(np.log(found.residual.size)) * max(1.0, found.chi2 / found.dof)

    def worse(count: int) -> float:
        dropped = mine[count:]
        q = basis(np.delete(found.jacobian, dropped, axis=1))
        moved = found.jacobian[:, dropped] @ found.vector[found.free[dropped]]
        return float(np.sum((moved - q @ (q.T @ moved)) ** 2)) + price * count

    return min(range(parts.size + 1), key=worse)
