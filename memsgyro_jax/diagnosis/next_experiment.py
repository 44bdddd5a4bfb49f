"""What to measure next: each feasible experiment, scored by what it would decide between the candidates that are left.

Kinds of measurement propose experiments in the shapes of records that were taken, so that the compiled programs predict
them at once. Of two models that explain the records, one is taken for the truth: its prediction is what the proposed
experiment would record. The other is then refitted to all records and this one, to first order and with everything in
it free. What it leaves of χ² beyond the truth is the expected Δχ² (the T-optimality of Atkinson and Fedorov, Biometrika
62 (1975) 57).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.runtime import usable_cores
from memsgyro_jax.base.threads import in_threads
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.drive_levels import clear_drives, goes_one_way
from memsgyro_jax.measurement.experiments import Readings

from .findings import NOTHING, SIGMAS_SEEN, Prospect
from .joint_residual import Joint
from .linearised import WIDTH
from .odd_setting import odd_setting
from .optimum import Optimum, optimise
from .rounds import DECIDED
from .score import RELATIVE, basis, score
from .search import CONFUSED, LOOK_AHEAD, Ranking, Search, always_free
from .settings_apart import in_each_place, moves


HALF = 0.5  # of what an experiment tells: how few rows hold it is said
UNKNOWN = "not computed: the model does not follow it"
SETTLES, STILL = 4, 0.1  # steps towards what a model records, and standard deviations that it may still be off
CLEARLY = 100.0  # times what rounding leaves of an effect that the records cannot show
OTHER = 1e-6  # of the largest sensitivity: below it a row says what the records say
FEW_ROWS = 0.02  # of the readings
JUMP, MOST_FALL = 1e3, 0.25  # times the noise, and times what other rows are off; share of the rows that may fall
MANY = 3  # labels that a sentence lists


@dataclass(frozen=True, eq=False)
class Proposal:
    """A feasible experiment: what to do, and its readings, those measured to be replaced."""

    text: str
    readings: Readings


@dataclass(frozen=True, eq=False)
class Rivals:
    """Two models of the same records: their names, where the one fits, and where the other."""

    names: tuple[str, str]
    truth: Optimum
    other: Optimum


def plans(case: Case, readings: Sequence[Readings]) -> tuple[Proposal, ...]:
    """Feasible experiments, the least effort first, as the kinds of the fitted readings propose them."""
    known = [(r, r.record[r.record >= 0]) for r in readings if r.fitted]
    return tuple(plan for taken, of in known if of.size for plan in _plans_of(taken, case.records[int(of[0])].name))


def _plans_of(taken: Readings, name: str) -> Iterator[Proposal]:
    """What is proposed from a record, without the same rows."""
    whole = taken.experiment if taken.whole is None else taken.whole
    for (text, other), (_, all_rows) in zip(taken.experiment.proposals(name), whole.proposals(name), strict=True):
        yield Proposal(text, replace(taken, experiment=other, whole=None if taken.whole is None else all_rows))


def next_experiments(
    search: Search, ranking: Ranking, twins: Mapping[int, Mapping[int, Optimum]], rival: str
) -> tuple[Prospect, ...]:
    """What each feasible experiment would decide beside a model that explains the records, the best first.

    Best are those that decide beyond doubt, the least effort first among them; the others follow by their expected Δχ².

    Args:
        search, ranking: at its end, and the candidates that are left.
        twins: per accepted effect, those that could stand in its place, and fits with them.
        rival: label of an effect of the device that explains as much as the instrument; empty where there is none.
    """
    rivals = _rivals(search, twins, rival)
    weigh = _told_apart(search.joint, rivals) if rivals else _shown(search, ranking)
    found, proposed = [], plans(search.case, search.joint.readings)
    with in_threads(usable_cores()) as over:
        for plan, worth in zip(proposed, over(weigh, proposed), strict=True):
            search.tell(f"predicted: {plan.text}")
            found.append(worth)
    most = DECIDED if rivals else np.inf
    return tuple(sorted(found, key=lambda p: (-p.shown, -min(np.nan_to_num(p.chi2, nan=-1.0), most))))


def advice(prospects: Sequence[Prospect]) -> str | None:
    """A sentence on the best of them; `None` where nothing can be proposed."""
    if not prospects or np.isnan(prospects[0].chi2):
        return None
    best = prospects[0]
    if best.shown:
        return f"{best.experiment}; it would {best.decides}"
    by = f"{np.sqrt(best.chi2):.3g} standard deviations"
    if best.weaker is not None:
        return f"nothing is left to decide; to see weaker effects, {best.experiment}: {best.told}, for one, would show"
    if best.chi2 <= CONFUSED:
        return f"none of the feasible experiments would tell {best.decides}"
    return f"{best.experiment}; it would tell {best.decides} by {by}{best.where}"


def of_the_unknown(case: Case) -> str:
    """What helps where no candidate explains the records: none then predicts what an experiment would show."""
    more = ""
    if len(clear_drives(case)) < 2 and moves(in_each_place(case)):
        more = "; sweeps at further temperatures or bias voltages show the course that is missing"
        more = f"; {odd}" if (odd := odd_setting(case)) else more
    elif any(hasattr(record, "setting") for record in case.records):
        more = "; sweeps at further drives, and at a lower one, show the law that is missing at more amplitudes"
    alike = [record.name for record in case.records if goes_one_way(record)]
    if alike:
        more += (
            f"; in {', '.join(alike)} the drive goes one way in time, so that a drift looks like what comes with the "
            "drive: repeat the first drive at the end"
        )
    return f"none is predicted, as nothing that was tried explains these records{more}"


# ---- two models that explain the same records


def _rivals(search: Search, twins: Mapping[int, Mapping[int, Optimum]], rival: str) -> list[Rivals]:
    """The pairs that are to be told apart: an effect and each that could stand in its place, or the instrument and an
    effect of the device.
    """
    joint, labels = search.joint, [effect.label for effect in search.joint.model.effects]
    out = []
    for place, others in twins.items():
        out += [Rivals((labels[place], labels[other]), search.optimum, fit) for other, fit in others.items()]
    terms = [i for i in search.given if joint.model.effects[i].of_instrument]
    if terms and rival in labels:
        start = search.optimum.vector.copy()
        start[np.concatenate([joint.of_effect(i) for i in terms])] = 0.0
        kept = [i for i in (*search.given, *search.accepted) if i not in terms]
        fit = optimise(joint, start, always_free(joint, [*kept, labels.index(rival)]), joint.fitted)
        out.append(Rivals((" and ".join(labels[i] for i in terms), rival), search.optimum, fit))
    return out


def _told_apart(joint: Joint, rivals: Sequence[Rivals]) -> Callable[[Proposal], Prospect]:
    """What a proposal is worth: of several pairs, the one that it tells least."""

    def weigh(plan: Proposal) -> Prospect:
        told = [(*expected(joint, pair, plan.readings), pair) for pair in rivals]
        if any(np.isnan(chi2) for chi2, _, _ in told):
            return Prospect(plan.text, UNKNOWN, np.nan)
        chi2, rows, pair = min(told, key=lambda one: one[0])
        return Prospect(plan.text, f"{pair.names[0]} from {pair.names[1]}", chi2, where=_where(plan.readings, rows))

    return weigh


def expected(joint: Joint, pair: Rivals, planned: Readings) -> tuple[float, np.ndarray]:
    """Expected Δχ² between two models once an experiment is added, and what each of its rows (n,) adds to it; NaN where
    what it would record cannot be predicted.
    """
    recorded = as_recorded(joint, pair.truth, planned)
    if recorded is None:
        return np.nan, np.zeros(planned.record.size)
    units = np.eye(joint.start.size)[pair.other.free]
    value, slope = map(_finite, joint.linearise(pair.other.vector, units, [recorded]))
    value = value - _finite(joint.residual(pair.truth.vector, [recorded])[0])
    sure = np.repeat(~_beside_a_fall(value.reshape(planned.record.size, -1)), value.size // planned.record.size)
    value, slope = np.where(sure, value, 0.0), np.where(sure[:, None], slope, 0.0)
    whole, left = np.concatenate([pair.other.jacobian, slope]), np.concatenate([pair.other.residual, value])
    q = basis(whole)
    left = left - q @ (q.T @ left)
    rows = np.sum(left[-value.size :].reshape(planned.record.size, -1) ** 2, axis=1)
    return max(0.0, float(left @ left) - pair.truth.chi2), rows


def as_recorded(joint: Joint, truth: Optimum, planned: Readings) -> Readings | None:
    """An experiment that recorded what a model predicts; as it stands where its noise has no `std`, `None` where a
    prediction that looks at what was measured (for its start) does not come to rest.
    """
    units = np.eye(joint.start.size)[truth.free[:WIDTH]]  # slopes that are asked for next, if they are no more
    for _ in range(SETTLES):
        measured, std = planned.experiment.measured, getattr(planned.experiment.noise, "std", None)
        white = _finite(joint.linearise(truth.vector, units, [planned])[0])
        if std is None or np.sqrt(np.mean(white**2)) < STILL:
            return planned
        parts = white.reshape(*measured.shape, -1)
        error = _finite(np.broadcast_to(std, measured.shape)) * (parts @ (1.0, 1.0j)[: parts.shape[-1]])
        read = measured - jnp.asarray(error)
        planned = planned.changed(lambda e: eqx.tree_at(lambda o: o.measured, e, read))  # noqa: B023
    return None


def _beside_a_fall(off: np.ndarray) -> np.ndarray:
    """Which rows (n, k) stand where one of two models is on another branch, or unsettled: few, and off beyond measure.
    Where exactly a resonance falls is nothing to decide by.
    """
    size = np.sqrt(np.mean(off**2, axis=1))
    far = size > JUMP * max(1.0, float(np.median(size)))
    return far if far.mean() <= MOST_FALL else np.zeros_like(far)


def _finite(values: np.ndarray) -> np.ndarray:
    """The same with zero for rows that have no weight or no prediction."""
    return np.where(np.isfinite(values), values, 0.0)


def _where(planned: Readings, rows: np.ndarray) -> str:
    """How few rows hold half of what an experiment tells, and where the best of them is."""
    order = np.argsort(-rows)
    few = 1 + int(np.searchsorted(np.cumsum(rows[order]), HALF * rows.sum()))
    place = planned.experiment.at(int(order[0]))
    return f", half of it in {few} of {rows.size} rows, first {place}" if place and rows.sum() > 0 else ""


# ---- nothing left to tell apart: what is not seen yet


def _shown(search: Search, ranking: Ranking) -> Callable[[Proposal], Prospect]:
    """What a proposal is worth where no two models are left: effects that the records cannot show and it would, and
    else, of those that the records speak for most, the one that gains most, at the strength that would just show. One
    that would have to move the records by more than they read to show there is none: nothing is linear as far as that.
    """
    joint, here, known = search.joint, search.optimum.vector, search.optimum.jacobian
    blind = [i for i, mine in enumerate(ranking.scores) if not mine.size]
    seen = [i for i in ranking.order if ranking.scores[i].size]
    rest = search.optimum.free.size
    columns = np.concatenate([search.optimum.free, *(joint.of_effect(ranking.places[i]) for i in (*blind, *seen))])
    few = sum(joint.of_effect(ranking.places[i]).size for i in (*blind, *seen[:LOOK_AHEAD]))
    columns = columns[: WIDTH * -(-(rest + few) // WIDTH)]  # some that are seen, and more where they cost nothing
    places = {i: np.isin(columns, joint.of_effect(ranking.places[i])) for i in (*blind, *seen)}
    whole = {i: places[i].sum() == joint.of_effect(ranking.places[i]).size for i in places}
    labels = {i: joint.model.effects[ranking.places[i]].label for i in places if whole[i]}
    read = np.linalg.norm(np.concatenate([_sizes(r) for r in joint.fitted]))
    allowed = {i: SIGMAS_SEEN * np.linalg.norm(ranking.slopes[i]) <= read * ranking.scores[i].information for i in seen}
    units, rounding = np.eye(joint.start.size)[columns], np.zeros(columns.size)
    imitated = np.zeros((rest, columns.size))
    if blind:
        slopes_here = _finite(_here(search, columns))
        rounding, imitated = _news(slopes_here, known), _imitation(slopes_here, known)

    def weigh(plan: Proposal) -> Prospect:
        if seen and any(plan.readings.experiment is r.experiment for r in joint.fitted):  # twice the same tells twice
            weakest = joint.model.effects[ranking.places[seen[0]]].label  # whether or not it had a column
            return Prospect(plan.text, f"{weakest}{NOTHING}", 2 * SIGMAS_SEEN**2)
        planned = as_recorded(joint, search.optimum, plan.readings) if blind else plan.readings
        if planned is None:
            return Prospect(plan.text, UNKNOWN, np.nan)
        value, slopes = map(_finite, joint.linearise(here, units, [planned]))
        clear = _news(slopes, slopes[:, :rest]) > CLEARLY * rounding
        clear &= _share_of_rows(slopes, slopes[:, :rest] @ imitated) > FEW_ROWS
        new = [labels[i] for i in blind if i in labels and clear[places[i]].any()]
        most, gains = float(_sizes(planned).max(initial=0.0) + np.abs(value).max(initial=0.0)), [(0.0, "")]
        for i in (i for i in seen if i in labels and allowed[i]):
            least = SIGMAS_SEEN / ranking.scores[i].information
            sure = told_by_slopes(least * slopes[:, places[i]], planned.record.size, most)[:, None]
            more = np.where(sure, slopes, 0.0)
            q = basis(np.concatenate([known, more[:, :rest]]))
            both = np.concatenate([ranking.slopes[i], more[:, places[i]]])
            gains.append((float((least * score(np.zeros(len(both)), q, both).information) ** 2), labels[i]))
        chi2, label = max(gains)
        return Prospect(plan.text, _shows(new) if new else f"{label}{NOTHING}", chi2, shown=len(new))

    return weigh


def told_by_slopes(moved: np.ndarray, rows: int, most: float) -> np.ndarray:
    """Which readings (r,) of a planned experiment of so many rows slopes tell, by how far they move them (r, k): not
    those beside a fall from branch to branch, where slopes grow without bound, nor any moved by more than is read.

    Args:
        moved: by the weakest strength that the records would show [standard deviations].
        rows: of the experiment.
        most: its largest reading [standard deviations].
    """
    far = np.linalg.norm(moved, axis=1)
    falls = _beside_a_fall(far.reshape(rows, -1))
    return (far <= most) & ~np.repeat(falls, far.size // rows)


def _sizes(readings: Readings) -> np.ndarray:
    """How large readings are, in standard deviations; where their noise has none, no bound."""
    measured, std = np.asarray(readings.experiment.measured), getattr(readings.experiment.noise, "std", None)
    if std is None:
        return np.array([np.inf])
    std = np.broadcast_to(std, measured.shape)
    return np.ravel(_finite(np.abs(measured) / np.where(std > 0, std, np.inf)))


def _here(search: Search, columns: np.ndarray) -> np.ndarray:
    """Sensitivities (r, k) to some parameters where a search stands, which mostly it knows."""
    optimum, ranked = search.sensitivities
    known = dict(zip(search.optimum.free.tolist(), search.optimum.jacobian.T, strict=True))
    known |= ranked if optimum is search.optimum else {}
    if all(place in known for place in columns.tolist()):
        return np.stack([known[place] for place in columns.tolist()], axis=1)
    units = np.eye(search.joint.start.size)[columns]
    return search.joint.linearise(search.optimum.vector, units, search.joint.fitted)[1]


def _news(slopes: np.ndarray, free: np.ndarray) -> np.ndarray:
    """(k,) how large each sensitivity (r, k) is beside those of what is free; zero where next to nothing is left."""
    q = basis(free)
    news = np.linalg.norm(slopes - q @ (q.T @ slopes), axis=0)
    return np.where(news > np.sqrt(RELATIVE) * np.linalg.norm(slopes, axis=0), news, 0.0)


def _imitation(slopes: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Coefficients (f, k) with which the columns of what is free (r, f) come nearest to each sensitivity (r, k)."""
    size = np.linalg.norm(free, axis=0)
    size = np.where(size > 0, size, 1.0)
    return np.linalg.lstsq(free / size, slopes)[0] / size[:, None]


def _share_of_rows(slopes: np.ndarray, imitated: np.ndarray) -> np.ndarray:
    """(k,) in how many of the readings, as a share, a sensitivity (r, k) is other than what imitates it in the records:
    a row beside a fall from branch to branch, whose prediction is steep or unsettled, shows nothing that others do not.
    """
    other = np.abs(slopes - imitated) > OTHER * np.abs(slopes).max(axis=0, initial=0.0)
    return other.mean(axis=0)


def _shows(new: Sequence[str]) -> str:
    more = f" and {len(new) - MANY} more" if len(new) > MANY else ""
    return f"show {', '.join(new[:MANY])}{more}, which these records cannot"
