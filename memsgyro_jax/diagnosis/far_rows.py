"""Rows far off a model that explains all others, found by turns with the fit: also those that hide behind others beside
them, or by pulling the fit.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import special

from memsgyro_jax.measurement.case import AbstractRecord
from memsgyro_jax.measurement.experiments import Deviation
from memsgyro_jax.measurement.least_squares import gate
from memsgyro_jax.measurement.outliers import LEVEL
from memsgyro_jax.measurement.readings import Readings

from .drives import BRINK, Rows, falls_of, without_rows
from .fit import CaseFit, beside_case
from .joint_residual import Joint
from .optimum import Optimum, optimise


HOPELESS = 1.5  # of the χ² that noise may leave: rows without which a model leaves more are not what it misses
FEW_ROWS = 0.05  # share of a record's rows from which they are no outliers but a part of it
TRIMMED = 0.1  # of all rows: the most that are left out on the way
TURNS = 8  # of a fit and a look for rows
FALLING = 0.8  # of what was left: what a turn that is not the last comes to
PAIR = 2  # rows beside one another: what goes on for longer is a part of the curve
BESIDE, NOISE = 0.25, 3.0  # of the largest of them, or standard deviations: what rows beside may be off
BY_CHANCE = 0.02  # so unlikely a repetition at one frequency in sweep after sweep is none
_MEDIAN = special.ndtri(0.75)  # of the modulus of a standard normal variable


def far_rows_in_turns(fit: CaseFit) -> Rows:
    """Rows by the rule of `far_rows` beside a fit to all others, without which the model leaves noise; none where it
    leaves more.

    On the way every far row is left out, one of a long run too: beside a fit that a wrong row still pulls, a steep
    flank is as far off, and the top of a bent resonance cannot be reached.

    Args:
        fit: near most rows, as `not_pulled` leaves it.
    """
    optimum, most = fit.optimum, TRIMMED * sum(record.rows for record, _ in fit.deviations)
    trimmed: list[Rows] = []
    near, least = False, np.inf
    for _ in range(TURNS):
        beside = _beside_all(fit, optimum)
        if near and not far_rows(beside):  # the model leaves noise, and no row stands alone beside it
            return {}
        far = _far(beside)
        if far in trimmed or sum(map(len, far.values())) > most:
            break
        trimmed.append(far)
        optimum = _without(fit, optimum, far)
        left = optimum.chi2 / optimum.dof
        if left > max(HOPELESS * gate(optimum.dof), FALLING * least):  # without fewer rows it leaves more yet
            return {}
        near, least = left > FALLING * least, left
    if not (rows := far_rows(beside)):
        return {}
    end = _without(fit, beside.optimum, rows)
    return rows if end.chi2 / end.dof <= HOPELESS * gate(end.dof) else {}


def _without(fit: CaseFit, optimum: Optimum, rows: Rows) -> Optimum:
    """A fit that goes on without some rows."""
    return optimise(fit.joint, optimum.vector, optimum.free, without_rows(fit.joint.fitted, rows))


def _far(fit: CaseFit) -> Rows:
    """Every row that is farther off than normal noise puts one in a thousand records, by the number of its record."""
    out = {}
    for record, deviation in fit.deviations:
        size, scale, numbers = _sizes(record, deviation)
        if (rows := np.flatnonzero(size > _limit(record.rows * numbers) * scale)).size:
            out[deviation.number] = tuple(rows.tolist())
    return out


def near_rows(fit: CaseFit, readings: Sequence[Readings], suspected: Rows) -> Rows:
    """Those of some rows, by the number of their record, that a fit which has not seen them explains.

    Args:
        readings: of all rows.
    """
    beside = _beside_all(replace(fit, joint=Joint(fit.joint.model, readings, fit.joint.programs)), fit.optimum)
    near: dict[int, tuple[int, ...]] = {}
    for record, deviation in beside.deviations:
        size, scale, numbers = _sizes(record, deviation)
        rows = [k for k in suspected.get(deviation.number, ()) if size[k] <= _limit(record.rows * numbers) * scale]
        near |= {deviation.number: tuple(rows)} if rows else {}
    return near


def _beside_all(fit: CaseFit, optimum: Optimum) -> CaseFit:
    """The parameters of an optimum beside every row, those that it was not fitted to too."""
    joint = fit.joint
    here = optimise(joint, optimum.vector, optimum.free, joint.fitted, max_evaluations=0)
    return beside_case(fit.case, joint, here, fit.apart)


def _sizes(record: AbstractRecord, deviation: Deviation) -> tuple[np.ndarray, float, int]:
    """Largest deviation of each row (n,), NaN where not compared, what is usual of them all, both in standard
    deviations, and how many numbers a row has.
    """
    white = record.series(deviation).compared.white
    usual = max(1.0, float(np.nanmedian(np.abs(white))) / _MEDIAN)
    return np.max(np.abs(white).reshape(len(white), -1), axis=1), usual, white[0].size


def _limit(numbers: int) -> float:
    """Standard deviations beyond which one of so many normal numbers lies in one of a thousand records."""
    return -float(special.ndtri(LEVEL / (2 * max(1, numbers))))


def far_rows(fit: CaseFit) -> Rows:
    """Rows of each record, by its number, that are farther off than normal noise puts one in a thousand records, alone
    or in pairs, while those beside them are near.

    None of three rows or more that follow each other, which are a part of the curve, nor a pair on the brink of a fall
    from branch to branch; none of a record of which more than a twentieth would be named; none of sweeps that repeat
    what is far off at the same frequencies more often than chance does, as what the device does repeats.
    """
    found: dict[int, tuple[int, ...]] = {}
    for record, deviation in fit.deviations:
        size, scale, numbers = _sizes(record, deviation)
        pieces, brink = record.series(deviation).pieces, _brink(deviation)
        rows = [row for piece in pieces for row in _alone(size / scale, piece, numbers, brink)]
        if 0 < len(rows) <= FEW_ROWS * record.rows:
            found[deviation.number] = tuple(sorted(rows))
    # Each row at a frequency of its own: a sweep.
    swept = {d.number for record, d in fit.deviations if record.stepped and len(record.frequencies) == record.rows}
    if _repeated(fit, {number: rows for number, rows in found.items() if number in swept}):
        found = {number: rows for number, rows in found.items() if number not in swept}
    return found


def _brink(deviation: Deviation) -> np.ndarray:
    """Rows near a fall that the model predicts: of what was read, wrong rows look like one."""
    return np.add.outer(falls_of(deviation.predicted), np.arange(-BRINK, BRINK + 1)).ravel()


def _alone(size: np.ndarray, piece: slice, numbers: int, brink: np.ndarray) -> list[int]:
    """Rows of one piece of a record that are far off, at most two beside one another.

    Args:
        size: (n,) largest deviation of each row of the record, in standard deviations; NaN where not compared.
        numbers: how many of them a row has.
        brink: rows near a fall.
    """
    rows = np.arange(len(size))[piece]
    rows = rows[np.isfinite(size[rows])]
    far = np.flatnonzero(size[rows] > _limit(rows.size * numbers))
    out: list[int] = []
    for run in np.split(far, 1 + np.flatnonzero(np.diff(far) > 1)) if far.size else ():
        beside = [size[rows[k]] for k in (run[0] - 1, run[-1] + 1) if 0 <= k < rows.size]
        near = max(beside, default=np.inf) <= max(NOISE, BESIDE * float(np.max(size[rows[run]])))
        fallen = run.size > 1 and bool(np.isin(rows[run], brink).any())
        if run.size <= PAIR and near and not fallen:
            out += rows[run].tolist()
    return out


def _repeated(fit: CaseFit, found: Rows) -> bool:
    """Whether rows of different sweeps stand at the same frequency more often than chance puts them there."""
    places, bands, sweeps = [], [], []
    for record, deviation in fit.deviations:
        if (rows := found.get(deviation.number)) is None:
            continue
        bands.append(record.frequencies)
        for k, piece in enumerate(record.series(deviation).pieces):
            mine = np.intersect1d(np.arange(record.rows)[piece], rows)
            places.append(record.frequencies[mine])
            sweeps += [(deviation.number, k)] * mine.size
    if len(sweeps) < PAIR:
        return False
    place = np.concatenate(places)
    band = np.concatenate(bands)
    step, count = float(np.median(np.abs(np.diff(band)))), len(np.unique(band))
    first, second = np.triu_indices(place.size, 1)
    other = np.array([sweeps[a] != sweeps[b] for a, b in zip(first, second, strict=True)])
    pairs = int(np.sum((np.abs(place[first] - place[second]) <= 0.5 * step) & other))
    return pairs > 0 and bool(special.pdtrc(pairs - 1, np.sum(other) / count) < BY_CHANCE)
