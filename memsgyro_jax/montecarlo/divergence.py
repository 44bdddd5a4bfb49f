"""Which filters were lost although their mass never left its travel, and what is likely to have led them astray.

A filter says how large its errors and innovations may be. Of a die whose filter is right, the normalised estimation
error squared at the end, the innovations of the settled part and the error of the rate each exceed the limits taken
here with a probability of `LEVEL`: a die beyond one of them is *diverged*.
"""

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import stats

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Inertial, mode_frequencies, natural_frequencies
from memsgyro_jax.device.propagate import Exact
from memsgyro_jax.loop.blocks.run import taken_as_constant
from memsgyro_jax.loop.bound import moved_by
from memsgyro_jax.loop.die_by_die import from_outside
from memsgyro_jax.loop.expectation import FAR, expectations, folding, moving, shifted, unknown_to
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.observability import PERIODS, observability
from memsgyro_jax.loop.observers import AbstractCovarianceObserver
from memsgyro_jax.loop.scenario import Scenario

from .batch import Plan, picked
from .spread import Spread


LEVEL = 1e-12
"""Probability at which one of the three tests takes a die whose filter is right as diverged: far below one in 20 000
dies, since the errors of a filter that linearises have longer tails than normal ones."""

NO_OBSERVER = "the loop has no observer whose claims could judge its errors"
_LOOKED_AT = 256  # dies drawn before a run
_SPREAD = 2.0  # times the design's highest mode within which those of the dies are taken to lie
_FEW = 15.0  # samples per period of the higher mode; `Operation` takes 26.6
_NAMED = 5  # dies named in a sentence
_RUNG_DOWN = 0.3  # of a run, within which a swing that lasts no longer is too short to tell the damping by
_STRETCHES = 8  # of the run that are asked what they tell
_REMAINDER = 1e-6  # of a whole run, in rad, that a series may leave out
_ROUNDING = 1e-6  # relative deviation of a known coefficient that is no rounding
_CHANCE = 0.01  # probability that of all numbers of all dies drawn from the prior one is taken as far from it
_PART = 0.1  # of what a die's largest deviation moves, below which another is beside the point
_ASKED = 8  # dies of which it is asked how much a deviation shows
Rows = Mapping[str, np.ndarray]
Drawn = Callable[[Int[np.ndarray, " dies"]], tuple[ClosedLoop, Scenario]]


@dataclass(frozen=True)
class Divergence:
    """The diverged dies of a lot by number, and sentences on what is likely to have led them astray.

    `unjudged` says why nothing can be said where the observer claims neither covariance nor innovations.
    """

    dies: tuple[int, ...] = ()
    causes: tuple[str, ...] = ()
    unjudged: str | None = None


def impossible(
    rows: Rows, standardised: Float[np.ndarray, "dies states"] | None, plan: Plan, filtered: bool
) -> Bool[np.ndarray, " dies"]:
    """Which dies are beyond what their filters claim, at `LEVEL`. `standardised` are the errors of all states in
    claimed standard deviations, None without a covariance. The rate of a `filtered` loop is not the estimate the claims
    speak of, and is left out.
    """
    samples = plan.innovations
    with np.errstate(invalid="ignore", divide="ignore"):
        rate = np.abs(rows["rate_error_end"] / rows["rate_std_end"])
    found = rows["nis_mean"] * samples > _limit(2 * samples)
    if not filtered:
        found = found | (rate > _size(1))
    if standardised is None:
        return found
    states = standardised.shape[1]
    # A singular covariance has no NEES; each error by itself then shares the level with the others.
    worst = np.max(np.nan_to_num(np.abs(standardised), nan=0.0, posinf=np.inf), axis=1, initial=0.0)
    alone = np.isnan(rows["nees_end"]) & (worst > _size(max(states, 1)))
    return found | alone | (rows["nees_end"] > _limit(states))


# Kept, because every batch asks for them.
@functools.cache
def _limit(freedom: int) -> float:
    """What a sum of so many squared normal numbers exceeds with probability `LEVEL`."""
    return float(stats.chi2.isf(LEVEL, freedom))


@functools.cache
def _size(count: int) -> float:
    """What the largest of so many normal numbers exceeds in size with probability `LEVEL` at most."""
    return float(stats.norm.isf(0.5 * LEVEL / count))


def divergence_of(
    dies: Int[np.ndarray, " diverged"],
    theta: Float[np.ndarray, "first coefficients"],
    loop: ClosedLoop,
    scenario: Scenario,
    plan: Plan,
    drawn: Drawn | None = None,
) -> Divergence:
    """The diverged `dies`, and why; `theta` are the coefficients of the first of them, or of all. `drawn` gives dies by
    number as loop and scenario, which trail; without it the design stands for them.
    """
    if not loop.observer.learns:
        return Divergence(unjudged=NO_OBSERVER)
    if not (isinstance(loop.observer, AbstractCovarianceObserver) or loop.observer.claims_innovation):
        return Divergence(unjudged="the observer claims no covariance and no innovations to judge its errors by")
    causes = _causes(theta, dies[: len(theta)], loop, scenario, plan, drawn) if dies.size else ()
    if len(theta) < dies.size:
        causes = (*causes, f"only the first {len(theta)} of them were asked for a cause")
    return Divergence(tuple(dies.tolist()), causes)


def unexpected(
    loop: ClosedLoop, scenario: Scenario, spread: Spread, seed: int, dies: int, sample_rate: float, duration: float
) -> tuple[str, ...]:
    """What a user should know before the run. The first dies are drawn for it only where their own rates or modes may
    tell more than the design's.
    """
    first, highest = np.arange(min(dies, _LOOKED_AT)), float(np.max(mode_frequencies(loop.device)))
    own = any(item.path.startswith("scenario.") for item in spread.items)
    if not (own or folding(np.array([_SPREAD * highest]), sample_rate).any()):
        return expectations(loop, scenario, sample_rate, duration)
    drawn = spread.draw(loop, scenario, seed, first)
    return expectations(loop, scenario, sample_rate, duration, (drawn.loop.device, drawn.scenario.rate))


class _Cause(NamedTuple):
    """Dies (of the diverged) that a cause holds for, and the cause in words."""

    holds: Bool[np.ndarray, " diverged"]
    words: str


def _causes(
    theta: np.ndarray, dies: np.ndarray, loop: ClosedLoop, scenario: Scenario, plan: Plan, drawn: Drawn | None
) -> tuple[str, ...]:
    def shown(names: tuple[str, ...]) -> np.ndarray:
        asked = drawn(dies[:_ASKED]) if drawn else (loop, scenario)
        return _shown(names, asked, (loop, scenario), plan)

    found = [cause for cause in (*_sampling(theta, loop, plan), *_surprises(theta, loop, shown)) if cause.holds.any()]
    everywhere = (*unknown_to(loop), *(words.rstrip(".") for words in shifted(loop, plan.samples * plan.period)))
    if moving(loop.observer, scenario, plan.samples * plan.period):
        everywhere = (*everywhere, "the rate moves, but the filter holds it constant")
    texts = [f"{_count(cause.holds, dies)} {cause.words}" for cause in found]
    texts += [f"all dies: {words}" for words in everywhere]
    rest = ~np.any([cause.holds for cause in found], axis=0) if found else np.ones(len(dies), bool)
    if rest.any() and not everywhere:
        texts.append(f"{_count(rest, dies)} are within what the filter was told: {_astray(loop, scenario, plan)}")
    return tuple(texts)


def _astray(loop: ClosedLoop, scenario: Scenario, plan: Plan) -> str:
    """Why a filter that expects a die loses it: the run does not tell what it seeks, or its linearisation."""
    untold = [" together with ".join(direction) for direction in _untold(loop, scenario, plan)]
    if untold:
        return (
            f"the run tells nothing of {' and '.join(untold)}, but linearising takes some of it for told (a tone "
            "beside the drive tells it: `tones=mg.Tone(...)`; what is known exactly is named by `known`)"
        )
    if constant := taken_as_constant(loop):
        return f"{constant}, which they do not bear (shorter blocks, or sample by sample)"
    samples = 1.0 / plan.period / float(np.max(mode_frequencies(loop.device)))
    often = f"take more than {samples:.2g} samples per period, " if samples < _FEW else ""
    short = _short_swing(loop, plan)
    remedy = f"{often}{short}narrow the prior or the spread" + ("" if short else ", or change the annealing")
    return f"it did not bear being linearised about its prior ({remedy})"


def _short_swing(loop: ClosedLoop, plan: Plan) -> str:
    """What keeps dies whose swing rings down long before the run ends, too early to be told from noise: of 512 dies of
    Q 150 with 15 % spread 59 diverged, 37 with the annealing of 0.5 ms, 2 with one of a third of the ring-down (and a
    rate of 11.6 instead of 8.3 deg/s), 2 with that of 0.5 ms and five times the swing, none with ten times.
    """
    damping = loop.device.dynamics(Inertial()).damping
    ring_down = 2.0 / max(float(np.max(np.asarray(damping[axis][axis]))) for axis in (0, 1))  # s
    if ring_down > _RUNG_DOWN * plan.samples * plan.period:
        return ""
    return (
        f"the design rings down in {1e3 * ring_down:.2g} ms: start it with a larger swing, `start` of the loop and "
        f"`amplitude` of `design_prior`, and anneal for a third of that, `annealing=mg.Annealing(1e4, "
        f"{ring_down / 3.0:.1g})`, which costs some of the rate's precision; or "
    )


def _untold(loop: ClosedLoop, scenario: Scenario, plan: Plan) -> tuple[dict[str, float], ...]:
    """Directions of what the filter seeks that the design's run never tells; none where that cannot be asked."""
    known = getattr(loop.observer, "known", ())
    duration = min(plan.samples * plan.period, _STRETCHES * PERIODS / float(np.min(mode_frequencies(loop.device))))
    try:
        return observability(loop, scenario, sample_rate=1.0 / plan.period, duration=duration, known=known).null
    except InputError:
        return ()


def _count(holds: Bool[np.ndarray, " diverged"], dies: np.ndarray) -> str:
    return f"{int(holds.sum())} of them ({_some(dies[holds])})"


def _some(dies: Int[np.ndarray, " dies"]) -> str:
    return ", ".join(map(str, dies[:_NAMED])) + (", ..." if len(dies) > _NAMED else "")


def _sampling(theta: Float[np.ndarray, "dies coefficients"], loop: ClosedLoop, plan: Plan) -> list[_Cause]:
    """Dies with a mode that their own sampling cannot carry."""
    modes = natural_frequencies(loop.device.model.assemble(tuple(theta.T)).stiffness)[..., -1]
    rate = 1.0 / plan.period
    highest = float(np.nanmax(modes, initial=0.0))
    above = folding(modes, rate)
    found = [
        _Cause(above, f"have a mode of up to {highest:.0f} Hz, too near half the sample rate of {rate:g} Hz or above"),
        _Cause(np.isnan(modes), "have a stiffness that holds no mode"),
    ]
    series = loop.discretisation
    if isinstance(series, Exact):
        left_out = (2.0 * np.pi * modes / rate) ** (series.order + 1) / math.factorial(series.order + 1)
        short = ~above & (left_out * plan.samples > _REMAINDER)
        found.append(_Cause(short, f"have a mode that a series of order {series.order} cannot carry at {rate:g} Hz"))
    return found


def _surprises(
    theta: Float[np.ndarray, "dies coefficients"], loop: ClosedLoop, shown: Callable[[tuple[str, ...]], np.ndarray]
) -> list[_Cause]:
    """Dies with coefficients that the filter takes as known otherwise, or that lie far outside its prior: by more than
    chance, and by more than the noise hides from it, as `shown` of a unit change of each says.
    """
    observer = loop.observer
    if not isinstance(observer, AbstractCovarianceObserver):
        return []
    names, known = np.array(observer.model.names), np.isin(observer.model.names, observer.known)
    mean, std = (np.asarray([float(v) for v in part]) for part in (observer.prior.theta, observer.prior.theta_std))
    known |= std == 0.0
    away = np.abs(theta - mean)
    by_chance = max(FAR, float(stats.norm.isf(0.5 * _CHANCE / max(theta.size, 1))))
    off = known & (away > _ROUNDING * np.maximum(np.abs(mean), np.abs(theta)))
    far = ~known & (away > by_chance * std)
    if (asked := np.flatnonzero((off | far).any(axis=0))).size:
        size = np.zeros_like(away)
        size[:, asked] = away[:, asked] * shown(tuple(names[asked].tolist()))
        largest = np.max(np.where(off | far, np.nan_to_num(size), 0.0), axis=1, keepdims=True)
        seen = ~(size < np.maximum(FAR, _PART * largest))  # NaN: it cannot be told
        off, far = off & seen, far & seen
    told = [
        (off, "differ in what the filter takes as known exactly"),
        (far, f"lie farther than {by_chance:.2g} standard deviations from the filter's prior, which could be wider"),
    ]
    return [_Cause(which.any(axis=1), f"{words}: {', '.join(names[which.any(axis=0)])}") for which, words in told]


def _shown(
    names: tuple[str, ...], asked: tuple[ClosedLoop, Scenario], design: tuple[ClosedLoop, Scenario], plan: Plan
) -> Float[np.ndarray, " quantities"]:
    """By how many standard deviations of its noise a unit change of each name moves what is measured, of the die among
    those asked where it does most; NaN where that is unknown.
    """
    if from_outside(*design):  # they know of one die alone
        asked = picked(asked, design, np.asarray(0))
    try:
        moved = moved_by(asked[0], design[0], asked[1], names, plan.period, plan.samples)
    except InputError:
        return np.full(len(names), np.nan)
    return np.max(moved.reshape(len(names), -1), axis=1)
