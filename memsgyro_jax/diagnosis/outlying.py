"""Rows that stand alone in what a fit leaves: named, and left out of every fit and every error from there on."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.measurement.experiments import Readings
from memsgyro_jax.measurement.outliers import lone_residuals

from .fit import CaseFit


FEW_ROWS = 0.05  # share of a record's rows from which they are no outliers but a part of it
Rows = Mapping[int, tuple[int, ...]]


def outlying(fit: CaseFit) -> Rows:
    """Rows of each record, by its number, that a parabola through twelve neighbours in what the fit leaves does not
    come near, by the rule of `lone_residuals`: in one of a thousand records of normal noise there is one.

    A misfit that is smooth from row to row names nobody; a record of which more than a twentieth stands alone keeps
    all.
    """
    out = {}
    for record, deviation in fit.deviations:
        series, found = record.series(deviation), []
        for piece in series.pieces:
            white = series.white[piece].reshape(series.white[piece].shape[0], -1)
            seen = np.flatnonzero(np.isfinite(white).all(axis=1))
            rows = np.arange(len(series.white))[piece][seen]
            found += [int(rows[row]) for row, _, _ in lone_residuals(white[seen], np.ones_like(white[seen]))]
        if 0 < len(found) <= FEW_ROWS * record.rows:
            out[deviation.number] = tuple(sorted(found))
    return out


def without_rows(readings: Sequence[Readings], left_out: Rows) -> tuple[Readings, ...]:
    """The same readings, in which some rows of some records belong to none and have no weight."""
    return tuple(_without(one, left_out) for one in readings)


def _without(readings: Readings, left_out: Rows) -> Readings:
    gone = np.zeros(readings.record.size, bool)
    for number, rows in left_out.items():
        gone |= (readings.record == number) & np.isin(readings.row, rows)
    if not gone.any():
        return readings
    noise = readings.experiment.noise
    std = getattr(noise, "std", None)
    if std is None or gone.all():
        return readings
    wide = jnp.where(gone[:, None], jnp.inf, std)
    experiment = eqx.tree_at(lambda e: e.noise.std, readings.experiment, wide)
    return replace(readings, experiment=experiment, record=np.where(gone, -1, readings.record))
