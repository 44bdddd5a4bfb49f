"""Allan deviation of rates at rest: the curve, the noises that it is made of, and what the record cannot tell."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array, Bool, Float
from scipy import stats

from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import listed
from memsgyro_jax.loop.trace_result import Trace

from .allan_result import MEANING, Allan, NoiseTerm
from .allan_variance import TERMS, allan_deviation, shapes
from .log_doubts import doubts_of
from .log_temperature import beside_temperature
from .noise_likelihood import low_passed
from .rate_log import RateLog, read_rate_log
from .rate_noise import NoiseFit, fit_noise, glance


FLAT = float(np.sqrt(2.0 * np.log(2.0) / np.pi))  # 0.664, the deviation of flicker of strength one
_FEWEST = 6  # octaves: five terms and something to judge them by
_SEEN = 0.1  # share of white noise from which a low-pass is worth a word: less shows by chance
_BEYOND = 2.0  # times its lag, from where on the form of a low-pass hardly matters
_POOR = 1e-3  # probability of a fit's χ² below which the five noises are taken not to describe the record
_OTHER = "the five noises do not describe the record"
_HIDDEN = "the record is too short behind its low-pass"
_HIDES = 0.75  # of the first averaging time: a lag that leaves the noises to be guessed by the form of the low-pass


def allan(
    source: Trace | str | Path | Float[Array, "*series samples"],
    *,
    sample_rate: float | str | None = None,
    column: str | None = None,
    start: float | str = 0.0,
    band: tuple[float, float] | None = None,
) -> Allan:
    """Allan deviation of rates at rest and its noise terms by maximum likelihood.

    Args:
        source: a CSV file as `read_rate_log` takes it; a `Trace`, one of `jax.vmap` too, whose error of the output is
            taken; or rates in rad/s, shape (samples,) or (series, samples). Each rate counts as an average over its
            period: for a sampled one the rate random walk reads differently at the first averaging times.
        sample_rate: [Hz] of an array, or of a file.
        column: the one to take of a file, with its unit ("Gyr_X [rad/s]") where the file names none.
        start: [s] from which on the rates count, behind the settling; zero takes all.
        band: shortest and longest averaging time of the fit [s]; without it all octaves up to a third of the record.

    Of a record that the five noises do not describe no term is told, nor the bias instability; `notes` say so, and
    where the rate goes with a temperature that the file has as well, comes in steps as coarse as its noise, or jumps.

    Raises:
        InputError: for rates that are not finite, do not vary or are too few, and for what `read_rate_log` refuses.
    """
    log = _after(_read(source, sample_rate, column), quantity("start", start, "s"))
    log = log._replace(notes=(*log.notes, *doubts_of(log)))
    return beside_temperature(analysed(log, band), log, lambda rest: analysed(rest, band))


def analysed(log: RateLog, band: tuple[float, float] | None = None, low_pass: bool = False) -> Allan:
    """`allan` of rates that are read; with `low_pass` those of a lot whose `band` begins near the end of its bandwidth,
    so that white noise has lost something there.
    """
    samples, period = log.rate.shape[-1], log.period
    octaves = tuple(2**k for k in range(samples.bit_length()) if 3 * 2**k <= samples)
    if band is not None:
        if not 0.0 <= band[0] < band[1]:
            raise InputError(
                "Argument `band` must be a shortest and a longest averaging time, but is "
                f"{band[0]:g} and {band[1]:g} s."
            )
        octaves = tuple(m for m in octaves if band[0] * (1 - 1e-9) <= m * period <= band[1] * (1 + 1e-9))
    if len(octaves) < _FEWEST:
        raise InputError(
            f"The record must hold at least {_FEWEST} octaves of averaging times up to a third of it"
            f"{'' if band is None else ' within `band`'}, but {samples} samples of {period:.4g} s hold {len(octaves)}."
        )
    factors = _factors(samples, period, octaves)
    measured = allan_deviation(log.rate, factors)
    still = [
        name for name, row in zip(log.names, measured[:, np.isin(factors, octaves)], strict=True) if np.any(row <= 0.0)
    ]
    if still:
        others = "" if len(still) == len(log.names) else "; take another by `--column` (`column`)"
        raise InputError(
            f"The rates must vary at every averaging time, but those of {listed(still, '`')} do not; is the log of "
            f"coarse numbers?{others}"
        )
    begun = octaves[0]
    octaves, found = _fit(measured, factors, octaves, samples, low_pass, band is not None)
    freedom = np.exp([np.interp(np.log(factors), np.log(octaves), row) for row in np.log(found.freedom)])
    ends = [measured * np.sqrt(freedom / stats.chi2.ppf(tail, freedom)) for tail in (0.975, 0.025)]
    tau = np.array(factors) * period
    terms = tuple(
        _terms(found, k, tau, measured[k], ends[0][k], ends[1][k], period, octaves[0]) for k in range(len(log.names))
    )
    return Allan(
        series=log.names,
        tau=tau,
        deviation=measured,
        low=ends[0],
        high=ends[1],
        fitted=_fitted(found, factors, octaves),
        terms=terms,
        band=(octaves[0] * period, octaves[-1] * period),
        chi2_per_dof=found.chi2 / found.dof,
        period=period,
        samples=samples,
        notes=(*log.notes, *_passed(found, octaves[0], period, begun), *_misfits(log.names, found)),
    )


def _fit(
    measured: np.ndarray, factors: tuple[int, ...], octaves: tuple[int, ...], samples: int, low_pass: bool, held: bool
) -> tuple[tuple[int, ...], NoiseFit]:
    """The noises, and from which octave on they are fitted: unless that is `held`, beyond the reach of a low-pass that
    shows, so that its form does not matter; of one pole, N was told 12 to 16 % too small from the first octave on. All
    octaves where the noises describe the record from none of them on.
    """

    def of(some: tuple[int, ...]) -> np.ndarray:
        return measured[:, np.isin(factors, some)] ** 2

    later, known = octaves, low_pass
    while not held:
        lag, chi2, dof = glance(of(later), later, samples, known)
        poor = stats.chi2.sf(chi2, dof) < _POOR
        # What its form leaves undescribed says little of how far it reaches: an octave at a time then.
        beyond = _BEYOND * float(np.median(np.where(poor, later[0], lag)))
        if beyond <= later[0] or len(later) == _FEWEST:
            octaves, low_pass = (octaves, low_pass) if np.median(poor) else (later, known)
            break
        rest = tuple(m for m in later if m >= beyond)
        later, known = rest if len(rest) >= _FEWEST else later[-_FEWEST:], True
    return octaves, fit_noise(of(octaves), octaves, samples, low_pass)


def _fitted(found: NoiseFit, factors: tuple[int, ...], octaves: tuple[int, ...]) -> Float[np.ndarray, "series factors"]:
    """Deviation of the model; of a low-pass no more is known than from the band on."""
    m = np.array(factors, float)
    taken = found.value[:, :1] ** 2 / m * low_passed(found.lag, np.maximum(m, octaves[0]))
    return np.sqrt(found.value**2 @ shapes(factors).T - taken)


def _passed(found: NoiseFit, first: int, period: float, begun: int) -> list[str]:
    """What a low-pass takes of the white noise at the `first` averaging time; nothing where none is seen. Times from
    `begun` on were looked at.
    """
    taken = float(np.median(low_passed(found.lag, np.array([first]))))
    at, less = f"{first * period:.3g} s", f"{100.0 * (1.0 - np.sqrt(1.0 - max(taken, 0.0))):.2g} %"
    if first > begun:
        said = (
            f"The noises are fitted from {at} on, not from {begun * period:.3g} s: a low-pass takes white noise before"
        )
        said += f", and {less} of it there" * (taken >= _SEEN)
    elif taken >= _SEEN:
        said = f"White noise is {less} less at {at} than a random walk tells, as behind a low-pass"
    else:
        return []
    return [f"{said}; N is that of long averaging times, and Q cannot be told."]


def _read(source: Any, sample_rate: float | str | None, column: str | None) -> RateLog:
    if isinstance(source, str | Path):
        return read_rate_log(source, sample_rate, column)
    if column is not None:
        raise InputError("Argument `column` must go with a file, but other rates were given.")
    if isinstance(source, Trace):
        if sample_rate is not None:
            raise InputError("Argument `sample_rate` must be left out for a trace, which has its own times.")
        return _of_trace(source)
    if sample_rate is None:
        raise InputError("Argument `sample_rate` must be given with rates, but is missing.")
    period = 1.0 / float(quantity("sample_rate", sample_rate, "Hz"))
    try:
        rate = np.atleast_2d(np.asarray(source, float))
    except (TypeError, ValueError) as error:
        raise InputError(
            "Argument `source` must be a file, a trace or rates, but is of type "
            f"{type(source).__name__}; a lot keeps no samples: map `simulate` over its dies with `jax.vmap`."
        ) from error
    if rate.ndim > 2 or not np.all(np.isfinite(rate)) or not (period > 0.0 and np.isfinite(period)):
        raise InputError(
            "Argument `source` must hold finite rates of shape (samples,) or (series, samples) at a positive sample "
            f"rate, but has the shape {np.shape(source)}, or holds what is not finite."
        )
    return RateLog(_numbered(len(rate)), rate, period)


def _of_trace(trace: Trace) -> RateLog:
    error, lost = np.atleast_2d(trace.rate_error), np.atleast_1d(np.isfinite(trace.intact_until))
    if np.all(lost):
        raise InputError("The trace must be of a die that was not lost, but none of them is.")
    times = np.asarray(trace.time).reshape(len(lost), -1)[0]
    names = tuple(name for name, gone in zip(_numbered(len(lost)), lost, strict=True) if not gone)
    notes = (f"{np.sum(lost)} of {len(lost)} dies were lost and are left out.",) if np.any(lost) else ()
    return RateLog(names, error[~lost], float(times[-1] - times[0]) / (len(times) - 1), notes)


def _numbered(count: int) -> tuple[str, ...]:
    return ("rate",) if count == 1 else tuple(f"series {k}" for k in range(count))


def _after(log: RateLog, start: float) -> RateLog:
    first = round(start / log.period) if start >= 0.0 else -1
    if not 0 <= first < log.rate.shape[-1]:
        raise InputError(
            f"Argument `start` must lie within the {log.rate.shape[-1] * log.period:.4g} s of the record, but "
            f"{start:g} s was given."
        )
    warm = None if log.temperature is None else log.temperature[first:]
    return log._replace(rate=log.rate[:, first:], temperature=warm)


def _factors(samples: int, period: float, octaves: tuple[int, ...]) -> tuple[int, ...]:
    """Four averaging times an octave, and one second where the samples hit it."""
    most = samples // 3
    quarters = {round(2 ** (k / 4)) for k in range(4 * most.bit_length())}
    second = round(1.0 / period)
    there = {second} if second and abs(second * period - 1.0) < 1e-6 else set()
    return tuple(sorted(m for m in {*quarters, *octaves, *there} if m <= most))


def _terms(
    found: NoiseFit,
    k: int,
    tau: np.ndarray,
    measured: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    period: float,
    first: int,
) -> dict[str, NoiseTerm]:
    terms, other = {}, _unknown(found, first)[k]
    for place, name in enumerate(TERMS):
        _, unit, factor, power = MEANING[name]
        value, least, most = (
            factor * period**power * float(part[k, place]) for part in (found.value, found.low, found.high)
        )
        if other:
            terms[name] = NoiseTerm(None, 0.0, float("inf"), unit, other)
            continue
        told = least > 0.0
        terms[name] = NoiseTerm(value if told else None, least, most, unit, "" if told else "the record cannot tell it")
    return {
        **terms,
        "arw_1s": _at_one_second(tau, measured, low, high),
        "bias_instability": _minimum(terms, found, k, float(high[np.argmin(measured)])),
    }


def _at_one_second(tau: np.ndarray, *curves: np.ndarray) -> NoiseTerm:
    """√(1 s) times the deviation at 1 s, between its neighbours where no averaging time is 1 s."""
    _, unit, factor, _ = MEANING["N"]
    if not tau[0] <= 1.0 + 1e-6 or not tau[-1] >= 1.0 - 1e-6:
        return NoiseTerm(None, 0.0, float("inf"), unit, "1 s is not among the averaging times")
    value, low, high = (factor * float(np.exp(np.interp(0.0, np.log(tau), np.log(curve)))) for curve in curves)
    return NoiseTerm(value, low, high, unit, "")


def _minimum(terms: Mapping[str, NoiseTerm], found: NoiseFit, k: int, most: float) -> NoiseTerm:
    """Of the fitted model: the least of the measured deviations is the one that chance has put lowest. Where the model
    has no minimum, it is below `most`, the upper end of that one.
    """
    _, unit, factor, _ = MEANING["B"]
    value, below, above = (factor / FLAT * float(np.sqrt(part)) for part in found.lowest[k])
    unknown = ""
    if terms["N"].verdict in {_OTHER, _HIDDEN}:
        unknown = terms["N"].verdict
    elif all(terms[name].value is None for name in "BKR"):
        unknown = "the deviation has not ceased to fall"
    elif found.rising[k]:
        unknown = "the deviation rises from the first averaging time on"
    if unknown:
        return NoiseTerm(None, 0.0, factor / FLAT * most, unit, unknown)
    return NoiseTerm(
        value, below, above, unit, "all noises together: flicker alone, B, is less" * (terms["B"].high < below)
    )


def _poor(found: NoiseFit) -> Bool[np.ndarray, " series"]:
    """Which series are described by no sum of the five noises, whose terms then mean nothing."""
    return np.asarray(stats.chi2.sf(found.chi2, found.dof) < _POOR)


def _unknown(found: NoiseFit, first: int) -> list[str]:
    """Why the terms of each series mean nothing; empty where they do."""
    hidden = found.lag > _HIDES * first
    return [_OTHER if poor else _HIDDEN * bool(hides) for poor, hides in zip(_poor(found), hidden, strict=True)]


def _misfits(names: tuple[str, ...], found: NoiseFit) -> list[str]:
    poor = int(np.sum(_poor(found)))
    if not poor:
        return []
    which = "" if len(names) == 1 else f" of {poor} of {len(names)} series"
    said = f"The five noises do not describe the record{which} (χ² beyond its 99.9 % point): "
    return [said + "a filter, vibration, settling or temperature; no term is told, those of a `band` without them are."]
