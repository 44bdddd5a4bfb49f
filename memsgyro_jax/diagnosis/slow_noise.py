"""Noise that is slow besides white, as 1/f noise is: told by what a fit leaves, and allowed for in every test.

Of noise that does not change with time the cosines over a record are nearly independent, the j-th with a variance of
level²·(1 + (corner/j)^slope); divided by it they are white again. Where that alone makes a remainder white, of one size
everywhere and without dependence on anything known, nothing else is missing: a law leaves its misfit where the device
moves, and an effect that is missing leaves one that its own score still sees.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.fft import dct, idct

from memsgyro_jax.base.text import spoken
from memsgyro_jax.measurement.case import AbstractRecord
from memsgyro_jax.measurement.experiments import Deviation
from memsgyro_jax.measurement.readings import Readings

from .at_resonance import concentrated
from .fit import CaseFit, beside_case
from .instrument import instrument_terms
from .misfit import check_all
from .optimum import Optimum
from .promise import offers_of, promised
from .score import Score, basis, family_p_values, score, survival
from .search import Ranking, Search
from .wrong_noise import repetition


SLOPES = (0.6, 0.8, 1.0, 1.25, 1.5, 2.0)
CORNERS, BINS = 60, 400
FEWEST = 4  # rows
SPENT = 3  # numbers of a spectrum
MEAN = 0.25  # in place of zero for the mean, which slow noise leaves open
# Of twice the logarithm of a likelihood, from which noise counts as slow; and from which beside records of slow noise.
EVIDENT, LIKELY = 12.0, 4.0
ROUNDS = 2  # of spectrum and fit
STEPS = 4  # of a fit to all readings, also those that were not fitted
RESPONSE = 0.1  # of the squared response to a drive: what leaves more is no noise, however slow
SURELY = 1e-6  # of the level: an effect that stands out so far beside a first spectrum does beside the last
LARGE = 1.5  # times white noise: a record of which no more is left says nothing of what that is
AGAIN = 10.0  # times what differs from sweep to sweep: slow noise of few independent rows comes to 5 by chance
CLEARLY = 1.25  # times what an effect leaves: a first estimate that costs so much more is not followed up


class SlowNoise(NamedTuple):
    """Spectrum of the noise of a record with so many rows, over what it was whitened with."""

    level: float
    corner: float
    slope: float
    rows: int

    def std(self, count: int) -> np.ndarray:
        """Standard deviation of the cosines (count,) over so many of its rows, spread over all of it."""
        place = np.arange(self.rows)
        power = 1.0 + (self.corner / np.maximum(place, MEAN)) ** self.slope
        # Of fewer rows the quicker cosines are folded back.
        folded = place % (2 * count)
        folded = np.where(folded < count, folded, 2 * count - 1 - folded)
        return self.level * np.sqrt(np.bincount(folded, power, count) / np.bincount(folded, minlength=count))

    def whitened(self, values: np.ndarray) -> np.ndarray:
        """Rows (n, k) of which slow noise is taken away."""
        return idct(dct(values, axis=0, norm="ortho") / self.std(len(values))[:, None], axis=0, norm="ortho")

    def doubt(self, shares: np.ndarray) -> float:
        """One over the degrees of freedom with which the spectrum tells the variance of a sum of cosines, of which some
        rows (n, k) have these shares of one.
        """
        place = np.maximum(np.arange(self.rows), MEAN)
        slow = 1.0 / (1.0 + (place / max(self.corner, MEAN)) ** self.slope) * (self.corner > 0)
        # The logarithm of the power by those of level and corner, and by the slope, each as far as it may be off.
        moved = np.stack([2.0 + 0.0 * place, self.slope * slow, slow * np.log(max(self.corner, MEAN) / place)], axis=1)
        known = 0.5 * shares.shape[1] * moved[1:].T @ moved[1:] + np.diag([0.0, 0.0, np.var(SLOPES) ** -1])
        seen = np.sum(shares, axis=1) @ moved[: len(shares)]
        return float(seen @ np.linalg.pinv(known) @ seen) / 2.0

    def spoken(self, record: AbstractRecord) -> str:
        """From where on it is slow, for people."""
        time = getattr(record, "time", None)
        span = 2.0 * record.rows if time is None else 2.0 * float(time[-1] - time[0])
        if time is not None:
            return f"below about {spoken(self.corner / span, 'Hz', 2)}"
        return f"over more than about {max(1.0, span / self.corner):.2g} rows"


def slow_noise_of(values: np.ndarray) -> tuple[SlowNoise, float]:
    """The likeliest spectrum of rows (n, k), and twice the logarithm of its likelihood over that of white noise."""
    count, columns = values.shape
    if count < FEWEST:
        return SlowNoise(1.0, 0.0, 1.0, count), 0.0
    power = np.mean(dct(values, axis=0, norm="ortho")[1:] ** 2, axis=1)
    # Neighbours, over which no spectrum changes, are taken together.
    begin = np.unique(np.round(np.geomspace(1, count, BINS)).astype(int))[:-1] - 1
    many = np.diff(np.append(begin, count - 1))
    power, place = (np.add.reduceat(values, begin) / many for values in (power, np.arange(1.0, count)))
    corners, share = np.geomspace(0.3, 30.0 * count, CORNERS), many / (count - 1)
    best = SlowNoise(float(np.sqrt(power @ share)), 0.0, 1.0, count), 0.0
    plain = np.log(power @ share)
    for slope in SLOPES:
        shape = 1.0 + (corners[:, None] / place) ** slope
        square = (power / shape) @ share
        gain = columns * (count - 1) * (plain - np.log(square) - np.log(shape) @ share)
        k = int(np.argmax(gain))
        if gain[k] > best[1]:
            best = SlowNoise(float(np.sqrt(square[k])), float(corners[k]), slope, count), float(gain[k])
    return best


def slowly(slow: Mapping[str, str]) -> str:
    """A sentence on noise that is slow; empty where none is."""
    found = "; ".join(f"{record} {where}" for record, where in slow.items())
    told = "beside which no test of what is left fails and no effect stands out"
    return f" The noise is not white but grows towards low frequencies, in {found}: {told}." if found else ""


def is_slow_noise(search: Search, ranking: Ranking) -> bool:
    """Whether slow noise of some records is all that is missing, which the search is then told; once of a fit."""
    fit = search.steps[-1].fit
    if fit is not search.listened or fit.optimum is not search.optimum:
        search.slow, search.listened = slow_noise(search, ranking), fit
    return bool(search.slow)


def slow_noise(search: Search, ranking: Ranking) -> Mapping[str, str]:
    """Of the records whose noise is slow, from where on, in words; empty where something else is missing, or nothing.

    It must be likelier than any effect and than what the instrument may do, by the Bayesian information criterion; with
    it no effect may be left that stands out, and no test of any record may fail.
    """
    optimum, fit, case = search.optimum, search.steps[-1].fit, search.case
    found = _spectra(fit)
    if not found or fit.optimum is not optimum or any(_is_response(fit, number) for number in found):
        return {}
    if _comes_again(fit, found):
        return {}
    blocks = dict(_blocks(search.joint.fitted, fit))
    # Rows that were not fitted tell of both alike, and are not counted twice.
    price = float(np.log(optimum.residual.size)) * sum(place.size for place in blocks.values()) / _compared(fit)
    least = optimum.chi2 - max((s.statistic - price * s.size for s in ranking.scores), default=0.0)
    white = _whitener(found, blocks)
    costly = _cost(_clean(optimum, white), found, blocks) > CLEARLY * least
    if _stands_out(search, ranking, found, blocks, search.level * (1.0 if costly else SURELY)):
        return {}
    for _ in range(ROUNDS):
        moved = _moved(search, _whitener(found, blocks))
        found = _spectra(moved)
    white = _whitener(found, blocks)
    left = white(_left(search, _step(search, white)[0])[:, None])[:, 0]
    cost = _cost(left, found, blocks) + SPENT * price * len(found.keys() & blocks.keys())
    if cost >= least or _stands_out(search, ranking, found, blocks, search.level):
        return {}
    present = {search.joint.model.effects[i].label for i in (*search.given, *search.accepted)}
    terms = [term for term in instrument_terms(case) if term.label not in present]
    if terms:
        offered = promised(optimum, offers_of(fit, terms), search.level)
        numbers = sum(terms[i].strength.size for i in offered.chosen)
        if cost >= optimum.chi2 - offered.gain + price * numbers:
            return {}
    if not (_passes(moved, found, search.level) or _passes(_moved_by_all(search, found), found, search.level)):
        return {}
    return {case.records[k].name: one.spoken(case.records[k]) for k, one in found.items()}


def _is_response(fit: CaseFit, number: int) -> bool:
    """Whether what is left of a record is a good part of its response to a drive, which no noise is."""
    record, deviation = next(pair for pair in fit.deviations if pair[1].number == number)
    if not record.stepped:
        return False
    seen, rows = _rows(record, deviation)
    response = np.abs(record.readings[seen][:, record.channels]) / record.noise_levels[record.channels]
    return float(np.sum(rows**2)) > RESPONSE * float(np.sum(response**2))


def _comes_again(fit: CaseFit, found: Iterable[int]) -> bool:
    """Whether what is left of records is much alike at the same frequencies of several sweeps, as no noise is."""
    left = {record.name: _rows(record, d)[1] for record, d in fit.deviations if d.number in found}
    sizes = {name: float(np.sqrt(np.mean(rows**2))) for name, rows in left.items()}
    return repetition(fit, {name: size for name, size in sizes.items() if size > LARGE})[0] > AGAIN


def _cost(left: np.ndarray, found: Mapping[int, SlowNoise], blocks: Mapping[int, np.ndarray]) -> float:
    """Twice the negative logarithm of the likelihood beside slow noise, as χ² is beside white, of what is left (r,)."""
    mine = found.keys() & blocks.keys()
    sizes = [blocks[k].shape[1] * 2.0 * float(np.sum(np.log(found[k].std(len(blocks[k]))))) for k in mine]
    return float(left @ left) + sum(sizes)


def _clean(optimum: Optimum, white: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """What a fit beside slow noise would leave (r,), to the first order, whitened."""
    left, q = white(optimum.residual[:, None])[:, 0], basis(white(optimum.jacobian))
    return np.asarray(left - q @ (q.T @ left))


def _compared(fit: CaseFit) -> int:
    return sum(error.count for error in fit.errors)


def _moved(search: Search, white: Callable[[np.ndarray], np.ndarray]) -> CaseFit:
    """The model where the likelihood beside slow noise is largest, by one step from where it is without, beside every
    record; with what was whitened for it.
    """
    vector, residual, slopes = _step(search, white)
    fit = _at(search, vector)
    return replace(fit, optimum=replace(fit.optimum, residual=residual, jacobian=slopes))


def _moved_by_all(search: Search, found: Mapping[int, SlowNoise]) -> CaseFit:
    """The same where readings count as well that were not fitted, which differ by the uncertainty of the fit."""
    joint, vector, fit = search.joint, search.optimum.vector, search.steps[-1].fit
    groups = [group for group in (joint.fitted, [r for r in joint.readings if not r.fitted]) if group]
    whiteners = [_whitener(found, dict(_blocks(group, fit))) for group in groups]
    for _ in range(STEPS):
        parts = []
        for group, white in zip(groups, whiteners, strict=True):
            value, slopes = joint.linearise(vector, np.eye(vector.size)[search.optimum.free], group)
            seen = np.concatenate([~r.weightless for r in group])
            known = (seen & np.isfinite(value))[:, None]
            parts.append(white(np.where(known, np.column_stack([slopes, value]), 0.0)))
        every = np.concatenate(parts)
        vector = _stepped(search, vector, every[:, -1], every[:, :-1])
    return _at(search, vector)


def _at(search: Search, vector: np.ndarray) -> CaseFit:
    return beside_case(
        search.case, search.joint, replace(search.optimum, vector=vector, residual=_left(search, vector))
    )


def _left(search: Search, vector: np.ndarray) -> np.ndarray:
    return np.concatenate(search.joint.residual(vector, search.joint.fitted))


def _step(search: Search, white: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where one step beside slow noise leads, and the residual and the slopes at its begin, whitened."""
    optimum = search.optimum
    residual, slopes = white(optimum.residual[:, None])[:, 0], white(optimum.jacobian)
    return _stepped(search, optimum.vector, residual, slopes), residual, slopes


def _stepped(search: Search, vector: np.ndarray, residual: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(slopes, axis=0)
    size, out = np.where(size > 0, size, 1.0), vector.copy()
    out[search.optimum.free] -= np.linalg.lstsq(slopes / size, residual, rcond=1e-7)[0] / size
    return np.clip(out, *search.joint.bounds)


def _blocks(chosen: Sequence[Readings], fit: CaseFit) -> Iterator[tuple[int, np.ndarray]]:
    """Of each record, where in the residual of some readings its rows stand (n, k), one column per channel and part."""
    begin = 0
    for r in chosen:
        shape = r.record.size, r.axes, r.size // (r.record.size * r.axes)
        place = begin + np.arange(r.size).reshape(shape)
        begin += r.size
        for record in np.unique(r.record[r.record >= 0]):
            mine = np.flatnonzero(r.record == record)
            mine = mine[np.argsort(r.row[mine], kind="stable")]
            yield int(record), place[mine][:, fit.case.records[record].channels].reshape(mine.size, -1)


def _rows(record: AbstractRecord, deviation: Deviation) -> tuple[np.ndarray, np.ndarray]:
    """Which rows of a record are compared (n,), and their deviations (n, k)."""
    white = deviation.white[:, record.channels]
    seen = np.flatnonzero(np.isfinite(white).all(axis=(1, 2)))
    return seen, white[seen].reshape(seen.size, -1)


def _spectra(fit: CaseFit) -> dict[int, SlowNoise]:
    """The spectra of records whose noise is evidently slow, of others of their kinds, which share instruments, and of
    those of which it is then likely; without those of which white noise is the likeliest.
    """
    told = [(record, d.number, *slow_noise_of(_rows(record, d)[1])) for record, d in fit.deviations]
    every = [one for one in told if one[2].corner > 0]
    kinds = {record.kind for record, _, _, gain in every if gain > EVIDENT}
    return {number: one for record, number, one, gain in every if record.kind in kinds or (kinds and gain > LIKELY)}


def _whitener(found: Mapping[int, SlowNoise], blocks: Mapping[int, np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    """What makes residuals or slopes (r, k) white again."""

    def white(values: np.ndarray) -> np.ndarray:
        out = values.copy()
        for record in found.keys() & blocks.keys():
            one, place = found[record], blocks[record]
            rows = values[place].reshape(len(place), -1)
            out[place] = one.whitened(rows).reshape(values[place].shape)
        return out

    return white


def _stands_out(
    search: Search, ranking: Ranking, found: Mapping[int, SlowNoise], blocks: Mapping[int, np.ndarray], level: float
) -> bool:
    """Whether an effect of the device does, at a `level`, beside all that is free and the slow noise, as well as that
    is known.
    """
    if not ranking.places:
        return False
    white = _whitener(found, blocks)
    residual, q = white(search.optimum.residual[:, None])[:, 0], basis(white(search.optimum.jacobian))
    scores = [score(residual, q, white(slopes)) for slopes in ranking.slopes]
    mine = found.keys() & blocks.keys()
    doubts = [sum(found[k].doubt(_shares(one, blocks[k])) for k in mine) if one.size else 0.0 for one in scores]
    scores = [
        replace(one, p_value=survival(one, 1.0 / doubt)) if doubt > 0 else one
        for one, doubt in zip(scores, doubts, strict=True)
    ]
    return bool(np.min(family_p_values(scores)) <= level)


def _shares(found: Score, place: np.ndarray) -> np.ndarray:
    """The shares of the cosines over some rows (n, k) in the directions of a score."""
    rows = found.directions[place].reshape(len(place), -1)
    power = dct(rows, axis=0, norm="ortho").reshape(*place.shape, found.size) ** 2
    return np.asarray(np.sum(power, axis=2) / found.size)


def _passes(fit: CaseFit, found: Mapping[int, SlowNoise], alone: float) -> bool:
    """Whether no test of a record of slow noise fails once that is taken away, and the others are of their noise's
    size, or of the fit's uncertainty: at a probability `alone` of more by chance.
    """
    names = {fit.case.records[k].name for k in found}
    others = [error for error in fit.errors if error.name not in names and not error.explained]
    if any(fit.p_value(error) <= alone / len(fit.errors) for error in others):
        return False
    series, white_again = [], []
    for record, deviation in fit.deviations:
        if deviation.number in found:
            seen, rows = _rows(record, deviation)
            rows = found[deviation.number].whitened(rows)
            white = np.full(deviation.white.shape, np.nan)
            size = np.sqrt(np.mean(rows**2))
            white[np.ix_(seen, record.channels)] = (rows / size).reshape(seen.size, len(record.channels), -1)
            white_again.append((record, replace(deviation, white=white)))
            series.append(record.series(white_again[-1][1]).compared)
    return not concentrated(white_again) and not any(check.failed for check in check_all(series))
