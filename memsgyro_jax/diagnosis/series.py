"""The residual of each record of a case beside what is known about its rows: what a misfit is tested against."""

import numpy as np

from memsgyro_jax.measurement.experiments.deviation import Series

from .fit import CaseFit


def series_of(fit: CaseFit) -> tuple[Series, ...]:
    """The whitened residual of every compared record, with its channels, conditions and variables."""
    compared = [k for k, white in enumerate(fit.whitened) if np.isfinite(white).any()]
    return tuple(fit.case.records[k].series(fit.deviation(k)) for k in compared)
