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
from .fit import CaseFit, beside_case
from .joint_residual import Joint
from .optimum import optimise
from .score import basis
from .search import Search


HOPELESS = 1.5  # of the χ² that noise may leave: rows without which a model leaves more are not what it misses
FEW_ROWS = 0.05  # share of a record's rows from which they are no outliers but a part of it

FAR, TRIMMED = 3.0, 0.1  # times what is usual from which rows are trimmed, and the largest share of them
USUAL = 1.5  # standard deviations that most rows may be off a fit that nothing pulls
NEARER = 0.5  # of what was usual: what a fit to the others must come to, each time
ROUNDS, EVALUATIONS = 8, 8  # of such fits


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
    done: Callable[[Search], bool],
) -> tuple[tuple[Search, Any, Any, Any], Rows]:  # fmt: skip
    """The end of a search, and the rows that it leaves out, if any.

    Rows are outlying only beside a model that explains all others: beside another they may be its misfit, as the one
    row at the top of a narrow resonance is. So they are left out at the beginning where the base model then explains
    the case, or where a model that was found on the way, or at the end, does.

    Args:
        begun: a search without some rows.
        searched: where a search stands on its way and at its end, and what else is told of it.
        done: whether a search leaves nothing to explain.
    """
    search = begun({})
    if not done(search) and (rows := _to_leave_out(search.base)) and done(fewer := begun(rows)):
        *_, found = searched(fewer)
        return found, rows
    tried: list[Rows] = []
    for found in searched(search):
        if done(found[0]) or not (rows := _to_leave_out(found[0].steps[-1].fit)) or rows in tried:
            continue
        *_, again = searched(begun(rows))
        if done(again[0]):
            return again, rows
        tried.append(rows)
    return found, {}


def _to_leave_out(fit: CaseFit) -> Rows:
    """Outlying rows, if without them the rest may be explained; also those that one row, far off, has hidden by pulling
    the fit away from all others.
    """
    if rows := outlying_in_noise(fit):
        return rows
    calmer = not_pulled(fit)
    return {} if calmer is None else outlying_in_noise(calmer)


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
        if not np.median(np.concatenate(sizes)) <= NEARER * usual:
            break
    return None


def _sizes(residual: np.ndarray, chosen: Sequence[Readings]) -> list[np.ndarray]:
    """Of each of the readings, the size of what is left of each row, in standard deviations."""
    parts = np.split(residual, np.cumsum([r.size for r in chosen])[:-1])
    return [np.sqrt(np.mean(p.reshape(r.record.size, -1) ** 2, axis=1)) for p, r in zip(parts, chosen, strict=True)]
