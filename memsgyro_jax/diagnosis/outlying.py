"""Rows that stand alone in what a fit leaves: named, and left out of every fit and every error from there on."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from memsgyro_jax.measurement.case import AbstractRecord, Case
from memsgyro_jax.measurement.case.lone import lone_readings
from memsgyro_jax.measurement.least_squares import gate
from memsgyro_jax.measurement.outliers import lone_residuals
from memsgyro_jax.measurement.readings import Readings

from .drives import NOBODY, Rows, falls, gone, without_rows, without_weight
from .far_rows import FEW_ROWS, HOPELESS, TRIMMED, far_rows_in_turns, near_rows
from .fit import CaseFit, beside_case
from .joint_residual import Joint
from .optimum import optimise
from .score import basis
from .search import Search


FAR = 3.0  # times what is usual from which rows are trimmed
USUAL = 1.5  # standard deviations that most rows may be off a fit that nothing pulls
NEARER = 0.5  # of what was usual: what a fit to the others must come to, each time
ROUNDS, EVALUATIONS = 8, 8  # of such fits
AGAIN = 3  # searches without rows that were found beside the end of another


def outlying(fit: CaseFit) -> Rows:
    """Rows of each record, by its number, that a parabola through twelve neighbours in what the fit leaves does not
    come near, by the rule of `lone_residuals`: in one of a thousand records of normal noise there is one.

    A misfit that is smooth from row to row names nobody; a record of which more than a twentieth stands alone keeps
    all.
    """
    out = {}
    for record, deviation in fit.deviations:
        series, found = record.series(deviation).compared, []
        for piece in series.pieces:
            white = series.white[piece].reshape(series.white[piece].shape[0], -1)
            seen = np.flatnonzero(np.isfinite(white).all(axis=1))
            rows = np.arange(len(series.white))[piece][seen]
            found += [int(rows[row]) for row, _, _ in lone_residuals(white[seen], np.ones_like(white[seen]))]
        if 0 < len(found) <= FEW_ROWS * record.rows:
            out[deviation.number] = tuple(sorted(found))
    return out


def of_rows(case: Case, left_out: Rows) -> str:
    """Rows by number, from one, of each record, where each was taken and why it may be outlying."""
    return "; ".join(
        f"row{'s' * (len(rows) > 1)} {', '.join(_of_row(case.records[number], row) for row in rows)} of "
        f"{case.records[number].name}"
        for number, rows in left_out.items()
    )


def as_left_out(case: Case, left_out: Rows) -> str:
    """The same as a part of a sentence that says so; empty for none."""
    are = "are" if sum(map(len, left_out.values())) > 1 else "is"
    return f"{of_rows(case, left_out)}, which {are} outlying and left out" if left_out else ""


def far_off(case: Case) -> str:
    """Rows that `check` names, which pull every fit: to be said of a case that nothing explains; empty for none."""
    rows = lone_readings(case.records)
    if not rows:
        return ""
    return (
        f" Rows that lie far off their neighbours pull every fit, to be corrected or left out: {of_rows(case, rows)}."
    )


def _of_row(record: AbstractRecord, row: int) -> str:
    said = [record.at(row), "read while the response fell from branch to branch" * (row in falls(record))]
    told = ", ".join(filter(None, said))
    return f"{row + 1} ({told})" if told else str(row + 1)


def search_beside_outlying(
    begun: Callable[[Rows], Search], searched: Callable[[Search], Iterator[tuple[Search, Any, Any, Any]]],
    done: Callable[[Search], bool], suspected: Callable[[], Rows] = dict,
) -> tuple[tuple[Search, Any, Any, Any], Rows]:  # fmt: skip
    """The end of a search, and the rows that it leaves out, if any.

    Rows are outlying only beside a model that explains all others: beside another they may be its misfit, as the one
    row at the top of a narrow resonance is. So they are left out at the beginning where the base model then explains
    the case, or where a model that was found on the way, or at the end, does. Rows that stand out before any model are
    left out on the way, as they pull every fit, and taken in again where the end explains them.

    Args:
        begun: a search without some rows.
        searched: where a search stands on its way and at its end, and what else is told of it.
        done: whether a search leaves nothing to explain.
        suspected: rows that stand far off their neighbours in what was read.
    """
    whole = begun({})
    search, left_out = (whole, {}) if done(whole) else _begun_without(whole, begun, done, suspected)
    tried: list[Rows] = [left_out]
    for found in searched(search):
        end, rows = found, left_out
        while not done(end[0]) and len(tried) <= AGAIN:
            rows = _together(rows, _to_leave_out(end[0].steps[-1].fit))
            if rows in tried:
                break
            tried.append(rows)
            *_, end = searched(begun(rows))
        if done(end[0]) and rows != left_out:
            break
    if not done(end[0]):
        return found, left_out
    near = near_rows(end[0].steps[-1].fit, whole.joint.readings, rows) if rows else {}
    if near:
        fewer = {k: kept for k, every in rows.items() if (kept := tuple(np.setdiff1d(every, near.get(k, ())).tolist()))}
        *_, again = searched(begun(fewer))
        if done(again[0]):
            return again, fewer
    return end, rows


def _begun_without(
    whole: Search, begun: Callable[[Rows], Search], done: Callable[[Search], bool], suspected: Callable[[], Rows]
) -> tuple[Search, Rows]:
    """A search without the rows that are outlying beside the base model, where that explains the rest, else without
    those that are suspected, and which they are.
    """
    if (rows := _to_leave_out(whole.base)) and done(fewer := begun(rows)):
        return fewer, rows
    if not (suspects := suspected()):
        return whole, {}
    search = begun(suspects)
    if not done(search) and (more := _to_leave_out(search.base)):
        rows = _together(suspects, more)
        if done(fewer := begun(rows)):
            return fewer, rows
    return search, suspects


def _together(some: Rows, others: Rows) -> dict[int, tuple[int, ...]]:
    """The rows of both."""
    return {k: tuple(sorted({*some.get(k, ()), *others.get(k, ())})) for k in sorted({*some, *others})}


def _to_leave_out(fit: CaseFit) -> Rows:
    """Outlying rows, if without them the rest may be explained; also those that one row, far off, has hidden by pulling
    the fit away from all others, and those that stand beside each other.
    """
    if rows := outlying_in_noise(fit):
        return rows
    calmer = not_pulled(fit)
    return {} if calmer is None else outlying_in_noise(calmer) or far_rows_in_turns(calmer)


def fit_without(fit: CaseFit, rows: Rows) -> CaseFit:
    """A fit again from where it ended, without some rows, which are then not compared either."""
    joint = Joint(fit.model, without_rows(fit.joint.readings, rows), fit.joint.programs)
    return beside_case(fit.case, joint, optimise(joint, joint.start, fit.optimum.free, joint.fitted), fit.apart)


def outlying_in_noise(fit: CaseFit) -> Rows:
    """Outlying rows, if a refit without them may leave noise: to the first order, which costs nothing."""
    rows, joint = outlying(fit), fit.joint
    if not rows:
        return rows
    kept = np.concatenate([np.repeat(~gone(r, rows), r.size // r.record.size) for r in joint.fitted])
    q, residual = basis(fit.optimum.jacobian[kept]), fit.optimum.residual[kept]
    left, dof = float(np.sum((residual - q @ (q.T @ residual)) ** 2)), fit.optimum.dof
    return rows if left / dof <= HOPELESS * gate(dof) else {}


def few_outlying(fit: CaseFit) -> Iterator[Rows]:
    """Rows without which a refit may leave noise: those that are outlying in noise, then those that were read while the
    response fell from branch to branch. A motion between two branches is none of the model's, and pulls a fit too far
    for the first order to tell what is left without it.
    """
    if rows := outlying_in_noise(fit):
        yield rows
    fallen = {k: tuple(sorted({*own} & {*falls(fit.case.records[k]).tolist()})) for k, own in outlying(fit).items()}
    if (few := {k: own for k, own in fallen.items() if own}) and few != rows:
        yield few


def not_pulled(fit: CaseFit) -> CaseFit | None:
    """The fit to all rows but those that are farthest from it, round by round (least trimmed squares), beside every
    record; `None` where that brings most rows no nearer, as it does not where a law is missing.

    Rousseeuw, "Least median of squares regression", J. Am. Stat. Assoc. 79 (1984) 871.
    """
    joint, vector, free = fit.joint, fit.optimum.vector, fit.optimum.free
    sizes = _sizes(fit.optimum.residual, joint.fitted)
    for _ in range(ROUNDS):
        every = np.concatenate(sizes)
        usual = float(np.median(every))
        if usual <= USUAL:
            return beside_case(fit.case, joint, optimise(joint, vector, free, joint.fitted, max_evaluations=0))
        far = max(FAR * usual, float(np.quantile(every, 1.0 - TRIMMED)))
        near = [
            without_weight(r, size > far) if np.any(r.record != NOBODY) else r
            for r, size in zip(joint.fitted, sizes, strict=True)
        ]
        vector = optimise(joint, vector, free, near, max_evaluations=EVALUATIONS).vector
        sizes = _sizes(np.concatenate(joint.residual(vector, joint.fitted)), joint.fitted)
        if not np.median(np.concatenate(sizes)) <= max(USUAL, NEARER * usual):
            break
    return None


def _sizes(residual: np.ndarray, chosen: Sequence[Readings]) -> list[np.ndarray]:
    """Of each of the readings, the size of what is left of each row, in standard deviations."""
    parts = np.split(residual, np.cumsum([r.size for r in chosen])[:-1])
    return [np.sqrt(np.mean(p.reshape(r.record.size, -1) ** 2, axis=1)) for p, r in zip(parts, chosen, strict=True)]
