"""The five noises of a rate sensor, fitted to Allan deviations by maximum likelihood."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy import stats

from .allan_variance import TERMS, shapes
from .noise_likelihood import LAG, NoiseModel


# Fall of twice the log-likelihood at the ends of a 95 % interval. It is 3.84 for many degrees of freedom, of which the
# longest averaging times have few; beside a ramp the slower noises have but two or three, as Student's t has, and a
# walk's own drift passes for the ramp. By simulation the intervals hold the truth in 92 to 99 %, beside a ramp in 93 to
# 98 %, more than 99 % where the walk is none.
FALL = 5.0
_BESIDE_RAMP = (5.0, 13.0, 10.0, 11.0, 5.0)  # of each term
_RAMP = 0.1  # share of the variance at the longest averaging time from which a ramp counts
_NOTHING = np.log(1e6)  # a term this far below the curve is as good as absent
_MOST = np.log(1e4)  # and none can lie further above it
_IN_SIGHT = np.log(50.0)  # below the curve, from where a term is pulled to where it belongs
_STEP = 1e-4  # of a logarithm, for slopes
_HALVINGS = 18
_SPARED = np.array([5.41, 7.29, 8.75, 10.02, 11.18])  # the same for so many terms left out, at `_CHANCE` for none there
_FIRST_LAG = 0.3  # lag over the first factor, nearly
_REACH = 8.0  # times the first factor that a lag can be, where nothing is known of a low-pass, or noise that grows
_OPPOSITE = TERMS.index("Q")  # which goes with the averaging time as a low-pass does, but adds
_CHANCE = 0.01  # probability at which series without a term are taken to have it
_LAGGED = 0.1  # the same of a low-pass: one that is not seen takes from N, one that is not there widens its interval


class NoiseFit(NamedTuple):
    """Terms of the noise model with the sample period as the unit of time, one row per series.

    Args:
        value: of each term; zero where the series need none of it.
        low, high: ends of the 95 % interval by the profile likelihood; `low` is zero where the record cannot tell the
            term from none.
        variance: Allan variance of the model at each factor.
        freedom: degrees of freedom of the measured variance at each factor, 2 σ⁴/variance of it.
        chi2: squared whitened residual.
        dof: of `chi2`: deviations less terms that do not vanish, and less the low-pass.
        lag: of a low-pass, as `low_passed` takes it; zero where the series show none.
        lowest: least Allan variance of the model within the factors, and the ends of its 95 % interval.
        rising: whether that is at the first factor.
    """

    value: Float[np.ndarray, "series 5"]
    low: Float[np.ndarray, "series 5"]
    high: Float[np.ndarray, "series 5"]
    variance: Float[np.ndarray, "series factors"]
    freedom: Float[np.ndarray, "series factors"]
    chi2: Float[np.ndarray, " series"]
    dof: Float[np.ndarray, " series"]
    lag: Float[np.ndarray, " series"]
    lowest: Float[np.ndarray, "series 3"]
    rising: Bool[np.ndarray, " series"]


def fit_noise(
    variance: Float[np.ndarray, "series factors"], factors: tuple[int, ...], samples: int, low_pass: bool = False
) -> NoiseFit:
    """Fit `TERMS` to overlapping Allan variances of series of `samples` rates, each an average over its period.

    A variance follows a multiple of χ² with ν degrees of freedom, whose cube root is nearly normal with the mean
    1 − 2/(9ν) and the variance 2/(9ν) (Wilson and Hilferty 1931), also where ν is 1. The cube roots are taken as
    jointly normal with the correlations of the variances. Mean, ν and correlations are those of the model at hand, so
    that the likelihood is whole: no weights from the data.

    No term can be negative, so one that is not there still takes from the others: N was told 3 % too small. What the
    series can do without is dropped therefore (`_needed`), while the intervals are those of all terms. A low-pass
    (`low_passed`) is counted where the series together show it, and with `low_pass` in any
    case, of either sign. Nothing tells it from quantisation, which is left out then.
    """
    model, nearest, floor, (best, least, free) = _begun(variance, factors, samples, low_pass)
    ramp = np.exp(best[:, 3]) * model.shapes[-1, 3] > _RAMP * model.expected(best).variance[:, -1]
    fall = np.where(ramp[:, None], _BESIDE_RAMP, FALL)
    # What describes no record may have a term further above the curve still, whose end lies above it all the same.
    most = np.maximum(nearest, best) + _MOST
    ends, rises = _profile(model, best, least[:, None] + 0.5 * fall, floor, most, nearest, free)
    kept = _needed(model, best, least, rises - least[:, None], floor, nearest, free)
    expected = model.expected(kept)
    gone = (kept <= floor + 1.0)[:, :LAG]
    value = np.where(gone, 0.0, np.exp(0.5 * kept[:, :LAG]))
    unknown = free[:, LAG:] & np.isin(TERMS, TERMS[_OPPOSITE])
    low = np.where(rises <= least[:, None] + 0.5 * fall, 0.0, np.exp(0.5 * ends[0]))
    return NoiseFit(
        value,
        np.minimum(low, value),
        np.where(unknown, np.inf, np.maximum(np.exp(0.5 * ends[1]), value)),
        expected.variance,
        expected.freedom,
        np.sum(model.whitened(expected) ** 2, axis=-1),
        np.maximum(len(factors) - np.sum(~gone, axis=-1) - np.sum(free[:, LAG:], axis=-1), 1.0),
        model.lag(kept),
        *_lowest(model, kept, floor),
    )


def glance(
    variance: Float[np.ndarray, "series factors"], factors: tuple[int, ...], samples: int, low_pass: bool = False
) -> tuple[Float[np.ndarray, " series"], Float[np.ndarray, " series"], float]:
    """Lag and χ² of each series where all terms of `fit_noise` are fitted, and the degrees of freedom: a tenth of its
    work, without intervals.
    """
    model, _, _, (best, _, free) = _begun(variance, factors, samples, low_pass)
    chi2 = np.sum(model.whitened(model.expected(best)) ** 2, axis=-1)
    return model.lag(best), chi2, max(len(factors) - float(np.sum(free[0])), 1.0)


def _begun(
    variance: np.ndarray, factors: tuple[int, ...], samples: int, low_pass: bool
) -> tuple[NoiseModel, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The model, the terms that reach the curve, those as good as absent, and the best of all terms (`_full`)."""
    model = NoiseModel(variance, factors, samples, (_REACH, 1.0 if low_pass else _REACH))
    nearest = np.log(np.min(variance[:, :, None] / model.shapes, axis=1))
    least_lag = np.full((len(nearest), 1), -_REACH if low_pass else 0.0)
    nearest = np.concatenate([nearest, least_lag + _IN_SIGHT], axis=1)
    floor = np.concatenate([nearest[:, :LAG] - _NOTHING, least_lag], axis=1)
    start = np.concatenate([nearest[:, :LAG] - np.log(len(TERMS)), np.zeros_like(least_lag)], axis=1)
    return model, nearest, floor, _full(model, start, floor, low_pass)


def _lowest(model: NoiseModel, kept: np.ndarray, floor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(series, 3) least variance of the model with its 95 % interval by what the deviations tell of the terms that are
    `kept`, and whether it is the first. The least of the measured ones is of the longest averaging times, which scatter
    most: of flicker it lay between a third and all of it.
    """
    times = np.geomspace(model.factors[0], model.factors[-1], 16 * len(model.factors))
    there = (kept > floor + 1.0)[:, :LAG]
    parts = (np.exp(kept[:, :LAG]) * there)[:, None, :] * shapes(times)
    variance = np.sum(parts, axis=-1)
    place = np.argmin(variance, axis=-1)[:, None]
    value = np.take_along_axis(variance, place, axis=-1)
    shares = np.take_along_axis(parts, place[..., None], axis=1)[:, 0] / value  # slopes of the logarithm
    units = _STEP * np.eye(kept.shape[-1])[:LAG]
    sides = [[model.loss(kept + sign * unit)[1] for sign in (1.0, -1.0)] for unit in units]
    bend = np.stack([(up - down) / (2 * _STEP) for up, down in sides], axis=-1) * there[:, None, :]
    normal = np.swapaxes(bend, -1, -2) @ bend + np.where(there, 1e-6, 1.0)[:, None, :] * np.eye(LAG)
    spread = np.einsum("st,st->s", shares, np.linalg.solve(normal, shares[..., None])[..., 0])
    ends = np.exp(np.sqrt(FALL * spread)[:, None] * np.array([0.0, -1.0, 1.0]))
    return value * ends, place[:, 0] == 0


def _full(
    model: NoiseModel, start: np.ndarray, floor: np.ndarray, low_pass: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Best of all terms, its loss, and what is free in it: a low-pass in place of quantisation where there is one, or
    the series together show one.
    """
    free = np.ones(start.shape, bool)
    free[:, LAG] = False
    best, least = _descend(model.loss, start, floor, free, 80)
    begun = np.where(free, np.maximum(best, start - _IN_SIGHT), _FIRST_LAG)
    begun[:, _OPPOSITE], lagged = floor[:, _OPPOSITE], np.ones(start.shape, bool)
    lagged[:, _OPPOSITE] = False
    passed, less = _descend(model.loss, begun, floor, lagged, 80)
    if not low_pass and _by_chance(2.0 * np.maximum(least - less, 0.0)) > _LAGGED:
        return best, least, free
    return passed, less, lagged


def _needed(
    model: NoiseModel, best: np.ndarray, least: np.ndarray, rises: np.ndarray, floor: np.ndarray, nearest: np.ndarray,
    free: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Best without the terms that the series can do without. Terms are left out in turn, from that on which least
    hangs: in a series as long as its likelihood allows, never one that it tells, and in none where the likelihoods of
    all of them together object, as a mean over a lot shows what no die shows.
    """
    at, loss, free, told, left_out = best, least, free.copy(), 2.0 * rises > FALL, np.zeros(len(best), int)
    for place in np.argsort(np.sum(np.clip(2.0 * rises, 0.0, FALL), axis=0)):
        trial = free.copy()
        trial[:, place] = False
        begun = np.where(trial, np.maximum(at, nearest - _IN_SIGHT), floor)
        begun[:, LAG] = at[:, LAG]
        moved, value = _descend(model.loss, begun, floor, trial, 30)
        spared = ~told[:, place] & (2.0 * (value - least) <= _SPARED[left_out])
        if _by_chance(np.minimum(2.0 * (value - loss), FALL)) < _CHANCE:
            continue
        at, loss = np.where(spared[:, None], moved, at), np.where(spared, value, loss)
        free, left_out = np.where(spared[:, None], trial, free), left_out + spared
    return at


def _by_chance(gains: np.ndarray) -> float:
    """Probability of as large a sum of twice the gains in log-likelihood by one number that cannot be negative and is
    zero in all series: each gain is zero for one half of them, and χ² for the other.
    """
    count = len(gains)
    positive = np.arange(1, count + 1)
    return float(stats.binom.pmf(positive, count, 0.5) @ stats.chi2.sf(max(float(np.sum(gains)), 0.0), positive))


Loss = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def _descend(
    loss: Loss, at: np.ndarray, floor: np.ndarray, free: np.ndarray, rounds: int
) -> tuple[np.ndarray, np.ndarray]:
    """Levenberg-Marquardt on many losses at once, over logarithms not below `floor`, moving those that are `free`."""
    value, white = loss(at)
    damping = np.full(len(at), 1e-2)
    moved = np.flatnonzero(np.any(free, axis=0))
    sides = _STEP * np.eye(at.shape[-1])[moved][:, None, :]
    slope, bend = np.zeros(at.shape), np.zeros((*white.shape, at.shape[-1]))
    for _ in range(rounds if moved.size else 0):
        # One call for all: of few fits the calls cost, not what is computed.
        (above, below), (bent, back) = (np.split(part, 2) for part in loss(np.concatenate([at + sides, at - sides])))
        slope[:, moved] = ((above - below) / (2 * _STEP)).T
        bend[..., moved] = np.moveaxis((bent - back) / (2 * _STEP), 0, -1)
        moving = free & ~((at <= floor) & (slope > 0.0))
        slope, bend = np.where(moving, slope, 0.0), np.where(moving[:, None, :], bend, 0.0)
        normal = np.swapaxes(bend, -1, -2) @ bend
        scale = np.einsum("...ii->...i", normal) + 1e-4
        lifted = normal + (damping[:, None] * scale)[..., None] * np.eye(at.shape[-1])
        lifted += np.where(moving, 1e-9, 1.0)[..., None] * np.eye(at.shape[-1])
        step = np.clip(-np.linalg.solve(lifted, slope[..., None])[..., 0], -2.0, 2.0)
        trial = np.maximum(at + np.where(moving, step, 0.0), floor)
        tried, _ = loss(trial)
        better = tried < value
        gain = np.max(np.where(better, value - tried, 0.0))
        at, value = np.where(better[:, None], trial, at), np.where(better, tried, value)
        damping = np.clip(np.where(better, damping * 0.3, damping * 5.0), 1e-6, 1e6)
        if gain < 1e-7 and np.all(better | (damping > 1e2)):
            break
    return at, value


def _profile(
    model: NoiseModel, best: np.ndarray, limits: np.ndarray, floor: np.ndarray, most: np.ndarray, nearest: np.ndarray,
    free: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """(2, series, 5) logarithms where the loss, least over the others that are `free`, has risen to `limits` (series,
    5), below and above; and (series, 5) the loss of a vanishing term.
    """
    series, terms = limits.shape
    number = 2 * terms
    many, held = model.repeated(number), np.tile(np.eye(terms, best.shape[-1], dtype=bool), (2 * series, 1))
    others_free = np.repeat(free, number, axis=0) & ~held
    base, bottom = np.repeat(best, number, axis=0), np.repeat(floor, number, axis=0)
    limit = np.tile(limits, 2).ravel()
    down = np.tile(np.repeat([True, False], terms), series)
    own = base[held]
    far = np.where(down, bottom[held], np.repeat(most, number, axis=0)[held])
    inside, others = own, base

    # Far below the curve a term has no slope and would stay there, whatever the held one needs of it: the walk, say,
    # whose drift passes for the ramp. So each way is also begun with all terms in sight.
    seen = np.maximum(base, np.repeat(nearest - _IN_SIGHT, number, axis=0))

    def at(position: np.ndarray, start: np.ndarray, rounds: int) -> tuple[np.ndarray, np.ndarray]:
        found, cost = _descend(many.loss, np.where(held, position[:, None], start), bottom, others_free, rounds)
        poor = cost > limit
        if not np.any(poor):
            return found, cost
        begun = np.where(held, position[:, None], seen)[poor]
        moved, less = _descend(many.only(poor).loss, begun, bottom[poor], others_free[poor], rounds + 6)
        better = less < cost[poor]
        found[poor], cost[poor] = np.where(better[:, None], moved, found[poor]), np.where(better, less, cost[poor])
        return found, cost

    _, value = at(far, base, 25)
    absent = value.reshape(series, 2, terms)[:, 0]
    outside = far
    for _ in range(_HALVINGS):
        middle = 0.5 * (inside + outside)
        moved, value = at(middle, others, 6)
        within = value <= limit
        inside, outside = np.where(within, middle, inside), np.where(within, outside, middle)
        others = np.where(within[:, None], moved, others)
    return np.moveaxis(inside.reshape(series, 2, terms), 1, 0), absent
