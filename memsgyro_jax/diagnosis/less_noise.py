"""A noise that the rows of a record told too large: a model leaves clearly less of it, and weaker effects may hide."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy import special

from memsgyro_jax.base.text import listed
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.experiments import AbstractRecord

from .fit import CaseFit
from .fitted import RecordError


SELDOM = 1e-6  # chance that a record whose noise is estimated right leaves so little
LESS = 3  # times at most that a diagnosis is made again, as an effect that was hidden was in what is left
CLEARLY = 0.8  # of the estimated noise: what leaves more hides next to nothing


def less_noise(fit: CaseFit) -> Mapping[str, tuple[float | tuple[float, ...], float]]:
    """Per record of which a model leaves clearly less than the noise that its rows told, the share that it leaves, of
    each recorded channel where the rows told each its own, and the degrees of freedom of that.

    Of the fitted readings as many count as there are beside the parameters, all of which a single record may have
    taken. χ² per degree of freedom follows Fisher's distribution, as the noise is an estimate.
    """
    found: dict[str, tuple[float | tuple[float, ...], float]] = {}
    for error in fit.errors:
        free = error.count - (fit.optimum.free.size if error.role == "fit" else 0)
        if np.isinf(error.freedom) or free < 1:
            continue
        squares = _squares_by_noise(fit, error)
        each = free / len(squares)
        shares = [float(np.sqrt(one / each)) if _is_less(one / each, each, error.freedom) else 1.0 for one in squares]
        if min(shares) < 1.0:
            known = each if max(shares) < 1.0 else min(each, error.freedom)
            found.setdefault(error.name, (tuple(shares) if len(shares) > 1 else shares[0], known))
    return found


def _is_less(share: float, free: float, freedom: float) -> bool:
    """Whether a model leaves clearly less than the noise of a record: that share of its χ² per degree of freedom."""
    return share < CLEARLY**2 and bool(special.fdtr(free, freedom, share) < SELDOM)


def _squares_by_noise(fit: CaseFit, error: RecordError) -> list[float]:
    """χ² of a record's rows of one role, of each recorded channel where their rows told each its own noise."""
    number = fit.case.number(error.name)
    record, rows = fit.case.records[number], fit.fitted[number] == (error.role == "fit")
    if np.ptp(record.noise_levels[record.channels]) == 0.0:
        return [error.chi2]
    return [float(np.nansum(fit.whitened[number][rows][:, channel] ** 2)) for channel in record.channels]


def with_less_noise(case: Case, found: Mapping[str, tuple[float | tuple[float, ...], float]]) -> Case:
    """The case with the noise that a model leaves in place of the one that the rows told."""
    return replace(case, records=tuple(_with_less(r, *found[r.name]) if r.name in found else r for r in case.records))


def _with_less(record: AbstractRecord, share: float | tuple[float, ...], freedom: float) -> AbstractRecord:
    if isinstance(share, float):
        return replace(record, left=(share * record.noise_level, freedom))
    return replace(record, left=(tuple(np.multiply(share, record.noise_levels[record.channels])), freedom))


def of_less_noise(case: Case) -> str:
    """A sentence on noise that was estimated too large, and what was done; empty where none was."""
    return "".join(
        f" The rows of {r.name} told {_times(r)} that a model leaves there, which was taken instead: {_declares(r)} "
        "would declare it."
        for r in case.records
        if r.left is not None
    )


def _times(record: AbstractRecord) -> str:
    """How much too large the rows told the noise."""
    told = record.told_noise.levels
    if not told:
        return f"{(record.estimated_noise() or np.nan) / record.noise_level:.3g} times the noise"
    times = {c: one / record.noise_levels[c] for c, one in zip(record.channels, told, strict=True)}
    return listed([f"{one:.3g} times the noise of channel {'xy'[c]}" for c, one in times.items() if one > 1.0])


def _declares(record: AbstractRecord) -> str:
    return "columns of each channel's" if record.told_noise.levels else "`noise_std`"
