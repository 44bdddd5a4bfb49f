"""What a filter expects of a run and the run will not be: told in sentences, before the run."""

import logging

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy import special

from memsgyro_jax.base.concrete import at_hand, is_concrete
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import AbstractGyro, mode_frequencies

from .loop import ClosedLoop
from .noise_budget import noise_budget
from .observers import AbstractBlockObserver, AbstractCovarianceObserver, AbstractObserver
from .scenario import AbstractProfile, Constant, Recorded, Scenario


_LEVEL = 1e-4  # probability at which a rate within the prior is told as far outside of it

FAR = 4.0
"""Standard deviations of its prior beyond which a coefficient is unexpected: one in 16 000 normal numbers is."""

SWING = 0.15
"""Relative error of a mode's frequency that a filter passes through before it has settled."""

_STILL = 1e-3  # standard deviations of the prior by which a constant may move unnoticed
_GRID = 1001
_LOG = logging.getLogger("memsgyro_jax")


def expectations(
    loop: ClosedLoop,
    scenario: Scenario,
    sample_rate: float,
    duration: float,
    drawn: tuple[AbstractGyro, AbstractProfile] | None = None,
) -> tuple[str, ...]:
    """Sentences on what of `scenario` the observer of `loop` does not expect. `drawn` are the devices of some dies and
    their rates, which trail, where they differ. Nothing is said of traced numbers and of observers without a prior.
    """
    if not (isinstance(loop.observer, AbstractCovarianceObserver) and is_concrete(loop, scenario)):
        return ()
    device, rate = drawn or (loop.device, scenario.rate)
    rates = _rates(scenario, duration) if drawn is None else np.atleast_1d(np.asarray(rate.value(0.0)))
    said = (*moving(loop.observer, scenario, duration), *slow(loop, sample_rate, duration))
    said = (*said, *_far(loop.observer, rates, 1 if drawn is None else len(rates)))
    return (*said, *shifted(loop, duration), *_sampled(np.atleast_2d(mode_frequencies(device))[:, -1], sample_rate))


def tell(sentences: tuple[str, ...]) -> None:
    """To whom it concerns, before a long run: by Python's logging, which prints where nothing else is set up."""
    for sentence in sentences:
        _LOG.warning(sentence)


def moving(observer: AbstractObserver, scenario: Scenario, duration: float) -> tuple[str, ...]:
    """A sentence where the rate of `scenario` moves within `duration` [s] and the filter holds it constant."""
    process = getattr(observer, "process_noise", None)
    if not isinstance(observer, AbstractCovarianceObserver) or process is None:
        return ()
    if getattr(observer, "fading", None) is not None or "rate" not in observer.model.names:
        return ()
    if isinstance(observer, AbstractBlockObserver) and observer.moves() is not None:
        return ()
    rates, place = _rates(scenario, duration), observer.model.index("rate")
    moved = float(np.ptp(rates))
    known = float(np.max(np.asarray(observer.prior.theta_std[place])))
    if float(np.max(np.asarray(process.theta[place]))) > 0.0 or moved <= _STILL * known:
        return ()
    walk = random_walk(Recorded(np.linspace(0.0, duration, _GRID), rates))
    said = (
        f"the rate moves by {np.degrees(moved):.3g} deg/s during the run, but the filter holds it constant: its "
        "estimate lags and its claims leave that out; a process noise of the rate, "
        f"`ProcessNoise.of(gyro.model, rate={walk:.2g})` say, makes it follow."
    )
    return (said,)


def slow(loop: ClosedLoop, sample_rate: float, duration: float) -> tuple[str, ...]:
    """A sentence where the filter follows a rate more slowly than a run of `duration` [s] shows: its bandwidth is the
    root of its process noise of the rate [rad²/s³] over the density of the rate's noise [rad/√s], over 2π, as of a
    scalar Kalman filter of a random walk.
    """
    process = getattr(loop.observer, "process_noise", None)
    if process is None or "rate" not in loop.observer.model.names:
        return ()
    walk = float(np.max(np.asarray(process.theta[loop.observer.model.index("rate")]))) ** 0.5
    try:
        noise = float(noise_budget(loop, sample_rate=sample_rate).total) if walk > 0.0 else 0.0
    except InputError:  # a loop without a swing to tell the rate by
        return ()
    bandwidth = walk / noise / (2.0 * np.pi) if noise > 0.0 else np.inf
    if bandwidth * duration > 1.0:
        return ()
    said = (
        f"the filter follows the rate up to about {bandwidth:.2g} Hz, slower than a run of {duration:.3g} s shows: its "
        "process noise of the rate is small beside the noise; more `observer.process_noise.rate` makes it faster, and "
        "its rate noisier."
    )
    return (said,)


def shifted(loop: ClosedLoop, duration: float) -> tuple[str, ...]:
    """A sentence for each offset of the read-out that lies `FAR` standard deviations from what the filter expects; one
    that it takes as known may be off by what the noise hides for `duration` [s].
    """
    observer, offsets = loop.observer, getattr(at_hand(loop.readout), "offset", None)
    if not isinstance(observer, AbstractCovarianceObserver) or offsets is None:
        return ()
    found, prior, exact = [], observer.prior, observer.known
    numbers = (offsets, prior.offset, prior.offset_std, loop.readout.noise_density)
    for axis, *of_axis in zip("xy", *numbers, strict=True):
        offset, mean, std, density = map(np.asarray, of_axis)
        known = f"offset_{axis}" in exact or float(np.max(std)) == 0.0
        hidden = float(np.max(density)) / (2.0 * duration) ** 0.5
        told, away = f"{float(np.mean(mean)):.3g}", float(np.max(np.abs(offset - mean)))
        if away > FAR * (hidden if known else max(float(np.max(std)), hidden)):
            takes = f"takes as known, {told} V" if known else f"expects at {told} ± {float(np.max(std)):.3g} V"
            remedy = "estimate it, or tell the prior" if known else "tell the prior a wider `offset_std`"
            value = float(np.mean(offset))
            found.append(f"the read-out's offset along {axis}, which the filter {takes}, is {value:.3g} V; {remedy}.")
    return tuple(found)


def unknown_to(loop: ClosedLoop) -> tuple[str, ...]:
    """Sentences on what acts in `loop` and is no part of its observer's equations."""
    found, told = [], getattr(loop.observer, "noise_density", None)
    if loop.device.effects:
        names = ", ".join(str(effect.label) for effect in loop.device.effects)
        found.append(f"effects of the device act that the filter's equations leave out ({names})")
    process = getattr(loop.observer, "process_noise", None)
    if loop.device.temperature is not None and process is not None and process.acceleration is None:
        found.append("the filter was not told of the device's Brownian force")
    if told is not None:
        pairs = [np.broadcast_arrays(*pair) for pair in zip(told, loop.readout.noise_density, strict=True)]
        share = min(float(np.min(a[b > 0.0] / b[b > 0.0], initial=np.inf)) for a, b in pairs)  # of a noise there is
        if share < _TOO_SURE:
            found.append(f"the filter was told {share:.2g} of the read-out's noise density")
    return tuple(found)


def folding(modes: Float[np.ndarray, " dies"], sample_rate: float) -> Bool[np.ndarray, " dies"]:
    """Which dies, by their highest mode [Hz], a filter cannot follow at `sample_rate` [Hz]: an estimate that swings by
    `SWING` on its way crosses half the sample rate, beyond which another frequency gives the same samples.
    """
    return modes * (1.0 + SWING) > 0.5 * sample_rate


_TOO_SURE = 0.95  # share of the read-out's noise density below which a filter is told too little


def random_walk(record: Recorded) -> float:
    """Intensity in (rad/s)²/s of the random walk that resembles a record: 2 · std of the rate · std of its slope.

    A walk with this intensity gains twice the record's variance in the time in which the record changes by its own
    standard deviation. Zero for a constant rate.
    """
    times, rate = np.asarray(record.times), np.asarray(record.values)
    grid = np.linspace(times[0], times[-1], 4 * len(times))
    even = np.interp(grid, times, rate)
    return float(2.0 * np.std(even) * np.std(np.diff(even)) / (grid[1] - grid[0]))


def _sampled(modes: Float[np.ndarray, " dies"], sample_rate: float) -> tuple[str, ...]:
    folded, highest = folding(modes, sample_rate), float(np.nanmax(modes, initial=0.0))
    if not folded.any():
        return ()
    which = f"{int(folded.sum())} of the first {len(modes)} dies have" if len(modes) > 1 else "the die has"
    said = (
        f"{which} a mode of up to {highest:.0f} Hz, above {50.0 / (1.0 + SWING):.0f} % of the sample rate, where a "
        f"filter may settle on a wrong frequency; sample at {2.0 * (1.0 + SWING) * highest:.0f} Hz or more."
    )
    return (said,)


def _far(observer: AbstractCovarianceObserver, rates: Float[np.ndarray, " rates"], dies: int) -> tuple[str, ...]:
    if "rate" not in observer.model.names:
        return ()
    place = observer.model.index("rate")
    mean, std = (float(np.mean(np.asarray(part[place]))) for part in (observer.prior.theta, observer.prior.theta_std))
    rate = float(rates[np.argmax(np.abs(rates - mean))])
    if std > 0.0:
        away = abs(rate - mean) / std
        expected = f"expects {np.degrees(mean):.3g} ± {np.degrees(std):.3g} deg/s"
        pull = f"is {away:.2g} standard deviations from that, and its estimate is pulled back towards it"
        remedy = f"`design_prior(gyro, rate_std={abs(rate - mean):.2g})` expects it"
        said = f"the filter {expected}, but the rate of {np.degrees(rate):.4g} deg/s {pull}; {remedy}."
        return (said,) if away > -special.ndtri(0.5 * _LEVEL / dies) else ()
    if abs(rate - mean) <= 1e-9 * max(abs(rate), abs(mean)):
        return ()
    return (
        f"the filter takes the rate as known, {np.degrees(mean):.3g} deg/s, but it is {np.degrees(rate):.4g} deg/s.",
    )


def _rates(scenario: Scenario, duration: float) -> Float[np.ndarray, " times"]:
    """The rate along the run; of dies with rates of their own, which trail, that of the first."""
    if isinstance(scenario.rate, Constant):
        return np.full(_GRID, np.ravel(scenario.rate.level)[0])
    rates = np.asarray(jax.vmap(scenario.rate.value)(jnp.linspace(0.0, duration, _GRID)))
    return rates.reshape(_GRID, -1)[:, 0]
