"""A noise that the rows of a record told too large: a model leaves clearly less of it, and weaker effects may hide."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy import special

from memsgyro_jax.measurement.case import Case

from .fit import CaseFit


SELDOM = 1e-6  # chance that a record whose noise is estimated right leaves so little
LESS = 3  # times at most that a diagnosis is made again, as an effect that was hidden was in what is left
CLEARLY = 0.8  # of the estimated noise: what leaves more hides next to nothing


def less_noise(fit: CaseFit) -> Mapping[str, tuple[float, float]]:
    """Per record of which a model leaves clearly less than the noise that its rows told, the share that it leaves and
    the degrees of freedom of that.

    Of the fitted readings as many count as there are beside the parameters, all of which a single record may have
    taken. χ² per degree of freedom follows Fisher's distribution, as the noise is an estimate.
    """
    found: dict[str, tuple[float, float]] = {}
    for error in fit.errors:
        free = error.count - (fit.optimum.free.size if error.role == "fit" else 0)
        if np.isinf(error.freedom) or free < 1:
            continue
        share = error.chi2 / free
        if share < CLEARLY**2 and special.fdtr(free, error.freedom, share) < SELDOM:
            found.setdefault(error.name, (float(np.sqrt(share)), float(free)))
    return found


def with_less_noise(case: Case, found: Mapping[str, tuple[float, float]]) -> Case:
    """The case with the noise that a model leaves in place of the one that the rows told."""
    records = [
        replace(r, left=(found[r.name][0] * r.noise_level, found[r.name][1])) if r.name in found else r
        for r in case.records
    ]
    return replace(case, records=tuple(records))


def of_less_noise(case: Case) -> str:
    """A sentence on noise that was estimated too large, and what was done; empty where none was."""
    return "".join(
        f" The rows of {r.name} told {(r.estimated_noise() or np.nan) / r.left[0]:.3g} times the noise that a model "
        "leaves there, which was taken instead: `noise_std` would declare it."
        for r in case.records
        if r.left is not None
    )
