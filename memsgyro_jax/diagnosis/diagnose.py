"""Which named physical effect is missing from a model, given what a laboratory recorded; or that none is, or that the
records cannot tell, or that it is none of those known.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import replace

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.runtime import make_room
from memsgyro_jax.base.text import listed
from memsgyro_jax.effects import Effect, Scanned
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.case.lone import lone_readings
from memsgyro_jax.measurement.case.quality import contradictions
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.readings import model_of, readings_of

from .accepted import accepted_of
from .climb import climbed
from .confusions import confusions
from .decays_apart import SAME_CLOCK, decays_apart
from .drift_in_time import with_drift_alone
from .drives import Rows, without_rows
from .effort import MOST, of_effort
from .estimates import unseen_terms
from .fewer import terms_of
from .findings import Accepted, Candidate, Stage
from .fit import CaseFit
from .fitted import within_gates
from .instrument import beside_case_of, drive_levels, knowledge, with_declared
from .instrument_told import of_instrument, of_lines
from .joint_residual import Joint
from .judged_loosely import judged_loosely, with_these_fitted
from .late_first import late_first
from .less_noise import LESS, less_noise, of_less_noise, with_less_noise
from .listing import followed_candidates, listed_candidates
from .moved import moved
from .next_experiment import advice, next_experiments, of_the_unknown
from .nuisances import instrument_first
from .onset import Onset, onset_of
from .optimum import Optimum
from .other_courses import beside_other_courses
from .outlying import far_off, of_rows, search_beside_outlying
from .oven import of_oven
from .result import UNEXPLAINED, Diagnosis, Verdict, validation_error
from .rounds import search_on
from .rows_before import behind_filter
from .search import CONFUSED, Ranking, Search, SearchStep, start_search
from .sentence import DRIFT, before_all, denied, of_noise, sentence, unseen_by_rest
from .slow_noise import is_slow_noise, slowly
from .spoiler import without_spoiler
from .wander import beside_course, of_wander, wanders, with_wander_first
from .worth_trying import worth_trying
from .wrong_noise import what_repeats, wrong_noise


RECORDS = 0.1  # of the level, for records; candidates have all of it, as readings left out refuse a sixth of chance's
PARTLY = 0.9  # share of the misfit above noise, in readings never fitted, that "partly explained" asks for
FAR_LEFT = 10.0  # times the noise: what is left of them beyond that makes the law unknown, whatever share was explained
NAMED = 2  # effects that are named as tried where none explains what is missing

Tell = Callable[[str], None]
Keep = Callable[[CaseFit, Sequence[Stage]], None]
Begun = tuple[CaseFit, tuple[Candidate, ...], str]  # the base model, what was tried beside it, what it is that of


def diagnose(
    model: "Model | object | None",
    case: Case,
    *,
    effects: Sequence[Effect] = (),
    level: float = 0.05,
    thorough: bool = False,
    tell: Tell = lambda text: None,
    keep: Keep = lambda fit, stages: None,
) -> Diagnosis:
    """Find what is missing from a model of a case.

    Args:
        model: a `Model` or device to start from, with effects it already has; `None` takes the design.
        case: from `load_case`.
        effects: the user's own, beside the catalogue.
        level: probability that anything is reported where nothing is missing.
        thorough: whether a search goes on, however long it takes, also where nothing has come near what was read.
        tell: is called with a sentence as the search goes on.
        keep: is called with the best fit so far and how it came, after every step that is a better one.

    Raises:
        InputError: in float32, for a level outside 0 to 1, or effects that do not suit the device.
    """
    if not 0.0 < level < 1.0:
        raise InputError(f"Argument `level` must lie between 0 and 1, but is {level:g}.")
    make_room()
    against = contradictions(case)
    for contradiction in against:
        tell(f"records contradict each other: {contradiction}")
    outcome, loose = _diagnosed(model, case, effects, level, thorough, tell, keep)
    if loose:
        tell(f"again with {listed(loose)} fitted too, which what the others hold does not tell")
        whole = with_these_fitted(case, loose)
        again, _ = _diagnosed(model, whole, effects, level, thorough, tell, keep)
        if again.verdict not in UNEXPLAINED:
            said = f" Fitted as well: {listed(loose)}, as what the other records hold does not tell what is seen there."
            case, outcome = whole, replace(again, sentence=again.sentence + said)
    for _ in range(LESS):
        if outcome.verdict in UNEXPLAINED or not (less := less_noise(outcome.final)):
            break
        tell("again with the noise that the model leaves, as it is less than the rows told")
        case = with_less_noise(case, less)
        outcome, _ = _diagnosed(model, case, effects, level, thorough, tell, keep)
    if wanders(outcome.instrument) and outcome.verdict not in UNEXPLAINED:
        against = ()  # records of which each has its resonance agree, where that goes with the time
    return replace(outcome, sentence=before_all(against) + outcome.sentence + of_less_noise(case))


def _diagnosed(
    model: "Model | object | None", case: Case, effects: Sequence[Effect], level: float, thorough: bool, tell: Tell,
    keep: Keep,
) -> tuple[Diagnosis, tuple[str, ...]]:  # fmt: skip
    """`diagnose` with the noise that the records have; and which records judged what the others hold too loosely."""
    start = _start(model, case)
    given = {e.label for e in start.effects}
    candidates = [*worth_trying(case), *effects]
    smooth = [e for e in candidates if not isinstance(e, Scanned) and e.label not in given]
    known_before = knowledge([effect for effect in start.effects if effect.of_instrument])
    joint = Joint(start.with_effect(*smooth), (*readings_of(case), *known_before))
    effort = joint.programs.effort
    effort.most = np.inf if thorough else MOST

    def begun(left_out: Rows) -> Search:
        if left_out:
            tell("leave out " + of_rows(case, left_out))
        effort.spent = 0
        kept = Joint(joint.model, without_rows(joint.readings, left_out), joint.programs)
        search = start_search(case, kept, level, range(len(start.effects)), tell)
        search.keep = _keep_better(search, keep)
        search.own = tuple(i for i, e in enumerate(joint.model.effects) if e.label in {own.label for own in effects})
        return search

    def done(search: Search) -> bool:
        return bool(search.slow) or all(_each_explained(search.steps[-1].fit, search.accepted, level))

    def searched(search: Search) -> Iterator[tuple[Search, Ranking, str, Begun]]:
        search = late_first(search)
        first = search.rank()
        if (behind := behind_filter(search, first)) is not search:
            search, first = behind, behind.rank()
        plain = search.base, listed_candidates(case, search.joint.model, first, powers=done(search)), ""
        if is_slow_noise(search, first):
            yield search, first, "", plain
            return
        wander = with_wander_first(search, first)
        if wander is not None:
            yield *beside_course(wander, search_on), "", plain
            return
        begin, climb = moved(search, first, smooth)
        if climb is None:
            begin, climb = climbed(search, first, smooth)
        ranking = begin.rank() if begin.accepted else first
        start = (
            plain if climb is None else (climb.base, followed_candidates(case, climb, len(first.places)), climb.whence)
        )
        if climb is not None:
            yield begin, ranking, "", start
        yield *instrument_first(begin, ranking, smooth, search_on, done), start

    (search, ranking, rival, (base, first, whence)), left_out = search_beside_outlying(
        begun, searched, done, lambda: lone_readings(case.records)
    )
    if without_spoiler(search, lambda fit, accepted: all(_each_explained(fit, accepted, level))):
        ranking = search.rank()
    steps = search.steps
    final = search.steps[-1].fit
    confused: dict[int, dict[int, Optimum]] = {place: {} for place in search.accepted}
    accepted = accepted_of(search, confused, steps)
    explained = list(_each_explained(final, accepted, level))
    noise: Mapping[str, float] = {}
    onset: Onset | None = None
    if not all(explained) and all(_each_explained(final, accepted, level, wrong := wrong_noise(final))):
        explained, noise = [True] * len(explained), wrong
    explained = [fine or bool(search.slow) for fine in explained]
    terms = accepted_of(search, {place: [] for place in terms_of(search)}, steps)
    apart = _of_device(search)
    found_more = _found_more(terms, given)
    if _verdict(steps[apart - 1].fit, final, accepted, all(explained), found_more) != "unknown_effect":
        tell("see what these records can tell apart")
        confused = confusions(search, ranking)
        accepted = accepted_of(search, confused, steps)
        if accepted and all(explained) and _drifts_as_well(steps[0].fit, final, accepted, level):
            accepted = (replace(accepted[0], confused_with=(*accepted[0].confused_with, DRIFT)), *accepted[1:])
        accepted = beside_other_courses(search, accepted)
    verdict = _verdict(steps[apart - 1].fit, final, accepted, all(explained), found_more)
    stages = (Stage("", base.chi2_per_dof, validation_error(base)), *_stages(steps)[1:])
    loose = judged_loosely(final) if accepted and verdict in UNEXPLAINED else ()
    denial = ""
    if verdict == "unknown_effect":  # what was tried is no finding: the model stays the base model and its instrument
        denial = denied(final, [effect.label for effect in accepted])
        base, whence = search.base, ""
        stages = _stages(steps)
        final, accepted, stages, tried = steps[apart - 1].fit, (), stages[:apart], stages[apart : apart + NAMED]
        terms = _terms_in(final, search, steps[:apart])
        explained = list(_each_explained(final, (), level))
        if all(explained):  # an effect of chance that spoils what was never fitted
            verdict, tried = "instrument_only" if _found_more(terms, given) else "nothing_missing", ()
        elif onset := onset_of(search.base) or onset_of(final):
            final, explained = onset.fit, list(_each_explained(onset.fit, (), level))
            if final.joint is search.base.joint:  # what the instrument seemed to do is not needed there
                base, whence, terms = final, onset.whence, ()
                stages = (Stage("", base.chi2_per_dof, validation_error(base)),)
    else:
        tried = ()
        onset = onset_of(final) if verdict == "partly_explained" else None
    again = what_repeats(final, noise)
    declared = {record.name for record in case.records if record.noise_std}
    unexplained = verdict in UNEXPLAINED
    why = "as they lie far off their neighbours and pull every fit" if unexplained else "as outlying"
    scale = np.nan if unexplained else final.scale  # what is left that nobody knows is in no standard deviation
    accepted, terms = (tuple(a.scaled(scale) for a in every) for every in (accepted, terms))
    apart_in_time = decays_apart(final) if unexplained else ""
    planned = () if unexplained else next_experiments(search, ranking, confused, rival)
    outcome = Diagnosis(
        case=case,
        base=base,
        final=final,
        verdict=verdict,
        sentence=sentence(verdict, accepted, final, explained, onset)
        + unseen_by_rest(base, final, verdict)
        + denial
        + apart_in_time
        + of_effort(effort.ended and unexplained)
        + of_instrument(terms, rival, drive_levels(case))
        + ("" if unexplained else of_wander(search))
        + of_lines(case, terms, unexplained)
        + of_oven(case, terms, final.model.effects)
        + of_noise(noise, declared, again)
        + slowly(search.slow)
        + (f" Left out {why}: {of_rows(case, left_out)}." if left_out else "")
        + (far_off(case) if unexplained and not left_out else ""),
        accepted=accepted,
        first=first,
        whence=whence,
        candidates=listed_candidates(case, search.joint.model, ranking, powers=not unexplained),
        groups=tuple((a.label, *a.confused_with) for a in accepted if a.confused_with),
        next_experiment=(SAME_CLOCK if apart_in_time else of_the_unknown(case)) if unexplained else advice(planned),
        next_experiments=planned,
        given=tuple(effect.label for effect in start.effects),
        steps=stages,
        level=level,
        tried=tried,
        outlying={case.records[number].name: rows for number, rows in left_out.items()},
        instrument=terms,
        scale=final.scale,
        noise={
            k: "part of what is left repeats"
            if again
            else f"its noise is larger than {'declared' if k in declared else 'estimated'}"
            for k in noise
        }
        | dict.fromkeys(search.slow, "its noise is slow"),
    )
    return outcome, loose


def _found_more(terms: Sequence[Accepted], given: Set[str]) -> bool:
    """Whether a term of the instrument is not of the model that was given."""
    return not {term.label for term in terms} <= given


def _drifts_as_well(base: CaseFit, final: CaseFit, accepted: Sequence[Accepted], level: float) -> bool:
    """Whether a drift in time explains what is not driven as well as all effects together."""
    drifting = with_drift_alone(base)
    if drifting is None or drifting.optimum.chi2 > final.optimum.chi2 + CONFUSED:
        return False
    return all(_each_explained(drifting, accepted, level))


def _stages(steps: Sequence[SearchStep]) -> tuple[Stage, ...]:
    return tuple(Stage(s.added, s.fit.chi2_per_dof, validation_error(s.fit)) for s in steps)


def _keep_better(begun: Search, keep: Callable[[CaseFit, Sequence[Stage]], None]) -> Callable[[Search], None]:
    """Keeps the steps of a search that is better than all before it, or that goes on from what is kept, as where an
    effect was dropped.
    """
    kept = list(begun.steps)
    keep(begun.base, _stages(kept))

    def better(search: Search) -> None:
        goes_on = [step.added for step in search.steps[:-1]] == [step.added for step in kept]
        if goes_on or search.steps[-1].fit.chi2_per_dof < kept[-1].fit.chi2_per_dof:
            kept[:] = search.steps
            keep(search.steps[-1].fit, _stages(kept))

    return better


def _of_device(search: Search) -> int:
    """The first step of a search that added an effect of the device, or how many there are."""
    labels = {e.label for e in search.joint.model.effects if not e.of_instrument}
    return next((k for k, step in enumerate(search.steps) if step.added in labels), len(search.steps))


def _terms_in(fit: CaseFit, search: Search, steps) -> tuple[Accepted, ...]:
    """The terms of the instrument that a fit has."""
    free = {fit.joint.parameters[i].effect for i in fit.optimum.free} - unseen_terms(fit.joint, fit.optimum)
    places = [i for i, effect in enumerate(fit.joint.model.effects) if effect.of_instrument and i in free]
    return accepted_of(Search(fit, search.level, places, search.tell), {place: [] for place in places}, steps)


def _start(model, case: Case) -> Model:
    if isinstance(model, Model):
        return with_declared(case, beside_case_of(case, model))
    return with_declared(case, model_of(case, starting_device(case) if model is None else model))


def _each_explained(
    fit: CaseFit, accepted: Sequence, level: float, noise: Mapping[str, float] | None = None
) -> Iterator[bool]:
    """Per record and role, whether noise alone explains what is left; fitted readings, many and tested anyway, get a
    wider gate.

    Where no effect was accepted, or terms of the instrument are free that some record alone would tell, a record beyond
    its gate counts only if noise, and the uncertainty of the fit, would seldom put it there: with all records together
    this happens to `RECORDS` of the level. Where the `noise` of a record is declared wrong, the one found counts.
    """
    within = within_gates(fit.errors, noise or {})
    if (accepted and not any(effect.of_instrument for effect in fit.joint.model.effects)) or all(within):
        yield from within
        return
    alone = RECORDS * level / len(within)
    for fine, error in zip(within, fit.errors, strict=True):
        yield fine or fit.p_value(error) > alone


def _verdict(base: CaseFit, final: CaseFit, accepted: tuple[Accepted, ...], explained: bool, terms: bool) -> Verdict:
    if not accepted:
        return ("instrument_only" if terms else "nothing_missing") if explained else "unknown_effect"
    if explained:
        return "cannot_tell" if any(a.confused_with for a in accepted) else "found"
    roles = {e.role for e in base.errors}
    judge = "validation" if "validation" in roles else "fit"
    before, after = (sum(e.chi2 - e.count for e in fit.errors if e.role == judge) for fit in (base, final))
    near = after < FAR_LEFT**2 * sum(e.count for e in final.errors if e.role == judge)
    return "partly_explained" if near and after < (1 - PARTLY) * before else "unknown_effect"
