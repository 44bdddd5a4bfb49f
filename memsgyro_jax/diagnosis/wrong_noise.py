"""A noise that is simply declared wrong: what a model leaves is white and depends on nothing, but has another size."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import special

from memsgyro_jax.base.text import spoken
from memsgyro_jax.measurement.experiments import Deviation
from memsgyro_jax.measurement.experiments.rounded_frequency import MATTERS, rounding_error

from .compare import judged
from .fit import CaseFit
from .misfit import check_all


BY_CHANCE = 1e-3  # that noise alone repeats so
ALIKE = 1e-9  # of a frequency, within which rows of several sweeps are at the same
SPREAD = 2.0  # times the usual deviation: a few rows that make the size larger are no noise of another size
WEAK = 3.0  # times the noise that is declared: what repeats and is larger is more than a doubt
_OFF = ": the frequencies are off, or something weak is missing"
_USUAL = special.ndtri(0.75)  # half of normal deviations are smaller


def wrong_noise(fit: CaseFit) -> Mapping[str, float]:
    """Per record whose deviations are too large and nothing else, their size over the declared noise.

    With the noise multiplied by that, no test of the record may fail: neither of whiteness, nor of a dependence on
    anything known, nor of the size in any part of it. A misfit of a few rows, as beside an internal resonance, is none,
    nor is a large one that comes again in every sweep.
    """
    comparison = judged(fit)
    failed = {check.record for check in comparison.checks if check.failed}
    sizes = {s.record: float(np.sqrt(np.nanmean(s.white**2))) for s in comparison.series if s.record in failed}
    rescaled = [
        replace(s, white=s.white / sizes.get(s.record, 1.0), turned=s.turned / sizes.get(s.record, 1.0))
        for s in comparison.series
    ]
    still = {check.record for check in check_all(rescaled, comparison.level) if check.failed}
    records = [record for record, _ in fit.deviations if record.name in sizes]
    rounded = {record.name for record in records if _rounded_to(record)}  # most at the top of a resonance
    still |= {s.record for s in rescaled if s.record in sizes and s.record not in rounded and _few_hold_most(s.white)}
    found = {record: size for record, size in sizes.items() if size > 1.0 and record not in still}
    return {} if max(found.values(), default=0.0) > WEAK and what_repeats(fit, found) == _OFF else found


def _few_hold_most(white: np.ndarray) -> bool:
    """Whether deviations of size one are mostly much smaller."""
    return float(np.nanmedian(np.abs(white))) < _USUAL / SPREAD


def what_repeats(fit: CaseFit, noise: Mapping[str, float]) -> str:
    """What is said where that which a fit leaves of records of such `noise` is much alike in several sweeps at the same
    frequencies, as no noise is; empty where it is not, or no frequencies are the same.

    By the analysis of variance of whitened rows, each record in units of its own size, between frequencies.
    """
    if repetition(fit, noise)[1] > BY_CHANCE:
        return ""
    sweeps: list[Any] = [record for record, _ in fit.deviations if record.name in noise and hasattr(record, "setting")]
    if step := max(map(_rounded_to, sweeps)):
        return f", as frequencies that are rounded to {spoken(step, 'Hz', 2)} make it"
    return _OFF


def repetition(fit: CaseFit, size: Mapping[str, float]) -> tuple[float, float]:
    """How much larger what a fit leaves of sweeps is from frequency to frequency than from sweep to sweep, 1 for noise,
    and how often white noise would make it so; of records that leave this `size` of deviation over noise. Nothing, and
    always, where no rows are at the same frequency.
    """
    values, places = [], []
    sweeps: list[tuple[Any, Deviation]] = list(fit.deviations)
    for record, deviation in sweeps:
        if record.name in size and hasattr(record, "setting"):
            values.append(deviation.white[:, record.channels].reshape(record.rows, -1) / size[record.name])
            places.append(np.round(np.log(record.frequency) / ALIKE) + 1e12 * record.axis)
    if len({one.shape[1] for one in values}) != 1:  # or none
        return 0.0, 1.0
    return _repetition(np.vstack(values), np.concatenate(places))


def _rounded_to(record: Any) -> float:
    """Hertz to which the frequencies of a sweep are rounded, where that is no less than its noise; zero else."""
    if not hasattr(record, "setting"):
        return 0.0
    hertz, read = record.frequency / (2.0 * np.pi), record.readings[:, record.channels]
    step, error = rounding_error(hertz, read, record.sweeps)
    return step if error > MATTERS * record.noise_level else 0.0


def _repetition(values: np.ndarray, place: np.ndarray) -> tuple[float, float]:
    """Of rows (n, k), some of which are at the same place."""
    seen = np.isfinite(values).all(axis=1)
    _, number, size = np.unique(place[seen], return_inverse=True, return_counts=True)
    several = size[number] > 1
    values, number = values[seen][several], np.unique(number[several], return_inverse=True)[1]
    rows, groups, parts = len(values), int(number.max(initial=-1)) + 1, values.shape[1]
    if groups < 2:
        return 0.0, 1.0
    sums = np.stack([np.bincount(number, weights=part) for part in values.T], axis=1)
    between = float(np.sum(sums**2 / np.bincount(number)[:, None]))
    within = float(np.sum(values**2)) - between
    free, left = parts * groups, parts * (rows - groups)
    if within <= 0.0:
        return np.inf, 0.0
    ratio = between / free / (within / left)
    return ratio, float(special.fdtrc(free, left, ratio))
