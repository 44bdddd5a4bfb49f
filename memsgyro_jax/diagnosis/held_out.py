"""What readings that were left out say of a fit: cross-validation over records and rows, without a refit.

At an optimum with residual r and sensitivities J, spanned by an orthonormal Q, the fit to all readings but a fold F
moves the parameters so that r_F + Q_F·c is left there, with c = (1 − H)⁻¹·Q_Fᵀ·r_F and H = Q_FᵀQ_F: exact where the
model is linear, and to the first order elsewhere (Cook and Weisberg, Residuals and Influence in Regression, 1982).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from memsgyro_jax.measurement.experiments import Readings

from .optimum import Optimum
from .score import basis


BLOCKS, FOLDS = 20, 5  # runs of rows in a record, dealt out in turn
HELD = 0.9  # share of what all readings hold of a direction from which a fold has it alone and keeps it
ENOUGH = 0.5  # of what an effect gains where it was fitted: so much it must gain where it was not


@dataclass(frozen=True)
class Support:
    """How much an effect lowers χ²: where it was fitted, and in rows and in records that were left out."""

    fitted: float
    rows: float
    records: float

    @property
    def enough(self) -> bool:
        """Whether what was left out gets better by it too, by more than half of what the fit gains."""
        return min(self.rows, self.records) > ENOUGH * self.fitted > 0.0


def support(before: Optimum, after: Optimum, readings: Sequence[Readings]) -> Support:
    """What the effects of `after` that `before` lacks gain; both are fits of the same readings, in their order."""

    def gain(fold: np.ndarray) -> float:
        one, other = (left_out(o.residual, o.jacobian, fold) for o in (before, after))
        return float(one @ one - other @ other)

    return Support(before.chi2 - after.chi2, gain(row_folds(readings)), gain(record_folds(readings)))


def left_out(residual: np.ndarray, jacobian: np.ndarray, fold: np.ndarray) -> np.ndarray:
    """Residual (r,) of each reading from the fit to all others but its own fold.

    A direction that a fold holds alone, nothing else could predict: there the fit to all readings stands.
    """
    q, out = basis(jacobian), residual.copy()
    slope = q.T @ residual
    for number in np.unique(fold):
        mine = fold == number
        own = q[mine]
        held, ways = np.linalg.eigh(own.T @ own)
        others = np.where(held < HELD, ways.T @ (own.T @ residual[mine] - slope), -(ways.T @ slope))
        out[mine] += own @ (ways @ (others / np.where(held < HELD, 1.0 - held, 1.0)))
    return out


def record_folds(readings: Sequence[Readings]) -> np.ndarray:
    """The record of each reading (r,), in the order of a residual."""
    return _of_readings(readings, [r.record for r in readings])


def row_folds(readings: Sequence[Readings]) -> np.ndarray:
    """A fold of each reading (r,): every record is cut into runs of neighbouring rows, which are dealt out in turn."""
    folds = []
    for r in readings:
        fold = np.zeros(r.record.size, int)
        for record in np.unique(r.record):
            mine = np.flatnonzero(r.record == record)
            order = np.argsort(np.argsort(r.row[mine], kind="stable"), kind="stable")
            fold[mine] = (order * BLOCKS // max(mine.size, BLOCKS)) % FOLDS
        folds.append(fold)
    return _of_readings(readings, folds)


def _of_readings(readings: Sequence[Readings], rows: Sequence[np.ndarray]) -> np.ndarray:
    """A number per row of each experiment, repeated for its channels and parts."""
    return np.concatenate([np.repeat(row, r.size // row.size) for r, row in zip(readings, rows, strict=True)])
