"""The information bound of each die of a lot: how well its rate could be known at best."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from memsgyro_jax.loop.bound import compile_bound, information_bound
from memsgyro_jax.loop.die_by_die import from_outside
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.observers import AbstractCovarianceObserver
from memsgyro_jax.loop.scenario import AbstractProfile, Constant, Scenario

from .batch import picked
from .spread import Spread


_LANES = 32  # dies side by side


def own_bounds(
    loop: ClosedLoop, scenario: Scenario, spread: Spread, seed: int, dies: int, sample_rate: float, duration: float
) -> Float[np.ndarray, " dies"] | None:
    """Least standard deviation of the rate at the end, of each of the first dies, if there is one; NaN for a die whose
    data and prior say nothing.

    The bound is that of a constant rate on a constant device that the read-out's noise hides, so there is none where
    anything varies.
    """
    if not _bounded(loop, scenario, dies, duration):
        return None
    asked, found, alone = _asked(loop, sample_rate, duration), [], from_outside(loop, scenario)
    for made, turning, count in _groups(loop, scenario, spread, seed, dies):
        rate = information_bound(made, turning, **asked).rate_std[-1]
        found.append(np.broadcast_to(rate, (count,)))
        if not alone and np.ndim(rate) == 0:  # all dies are alike
            found = [np.full(dies, rate)]
            break
    rate = np.concatenate(found)[:dies]
    return np.where(np.isfinite(rate), rate, np.nan)


@contextmanager
def compiled_beside(
    loop: ClosedLoop, scenario: Scenario, spread: Spread, seed: int, dies: int, sample_rate: float, duration: float
) -> Iterator[None]:
    """Compiles the program of `own_bounds` of the same arguments beside what is done inside: a compiler takes one core.

    What it refuses, `own_bounds` will say.
    """
    if not _bounded(loop, scenario, dies, duration):
        yield
        return
    beside = ThreadPoolExecutor(1)

    def compiled() -> None:
        made, turning, _ = next(_groups(loop, scenario, spread, seed, min(dies, _LANES)))
        compile_bound(made, turning, **_asked(loop, sample_rate, duration))

    ahead = beside.submit(compiled)
    try:
        yield
        wait([ahead])
    finally:
        beside.shutdown(wait=False, cancel_futures=True)


def _asked(loop: ClosedLoop, sample_rate: float, duration: float) -> dict[str, Any]:
    """What a bound is asked besides the dies."""
    asked = {"sample_rate": sample_rate, "duration": duration, "windows": 1, "design": loop}
    if isinstance(observer := loop.observer, AbstractCovarianceObserver):
        return {**asked, "prior": observer.prior, "known": observer.known}
    return {**asked, "prior": None, "known": ()}


def _groups(
    loop: ClosedLoop, scenario: Scenario, spread: Spread, seed: int, dies: int
) -> Iterator[tuple[ClosedLoop, Scenario, int]]:
    """Dies as they are bounded together, and how many each time."""
    drawn, design = spread.draw(loop, scenario, seed, np.arange(dies)), (loop, scenario)
    alone = from_outside(*design)
    for first in range(0, dies, 1 if alone else _LANES):
        # Always as many side by side: one program, whatever the number of dies. Parts from outside know of one alone.
        places = np.asarray(first) if alone else np.minimum(first + np.arange(_LANES), dies - 1)
        made, turning = picked((drawn.loop, drawn.scenario), design, places)
        yield made, turning, np.atleast_1d(places).size


def why_unbounded(loop: ClosedLoop, scenario: Scenario, duration: float) -> str | None:
    """Why a loop that has a bound has none in a run of `duration` [s]: something moves in `scenario`. Else None."""
    moving = _moving(scenario, duration) if _has_bound(loop) else None
    return f"none, as it is that of a constant rate on a constant device, but {moving}" if moving else None


def _bounded(loop: ClosedLoop, scenario: Scenario, dies: int, duration: float) -> bool:
    return dies > 0 and _has_bound(loop) and not _moving(scenario, duration)


def _has_bound(loop: ClosedLoop) -> bool:
    """Whether the read-out's noise hides a rate that the observer seeks."""
    if any(float(np.min(np.asarray(density))) == 0.0 for density in loop.readout.noise_density):
        return False
    if not loop.observer.learns:  # it takes the design's numbers for true, which no bound without a prior does
        return False
    # A known rate is nothing to find.
    return not (isinstance(loop.observer, AbstractCovarianceObserver) and "rate" in loop.observer.known)


def _moving(scenario: Scenario, duration: float) -> str | None:
    """What moves in a run, in words; None for nothing, which is not asked of what is constant by its kind."""
    profiles = jax.tree.leaves(scenario, is_leaf=lambda part: isinstance(part, AbstractProfile))
    if all(type(profile) is Constant for profile in profiles):
        return None
    conditions = jax.vmap(scenario.at)(jnp.linspace(0.0, duration, 1001))
    if float(jnp.ptp(conditions.inertial.rate)) > 0.0:
        return "the rate moves"
    varies = any(float(jnp.ptp(value)) > 0.0 for value in jax.tree.leaves(conditions))
    return "the conditions move" if varies else None
