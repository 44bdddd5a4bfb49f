"""What the tests of a lot on a rate table share."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from memsgyro_jax.base import runtime
from memsgyro_jax.base.arguments import quantity, refuse_traced, whole
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.loop.loop import ClosedLoop, as_loop
from memsgyro_jax.loop.operation import run_of
from memsgyro_jax.loop.scenario import Scenario, Step, as_scenario
from memsgyro_jax.loop.trace import count_steps
from memsgyro_jax.montecarlo.spread import Spread

from .lot_outputs import Outputs, lot_outputs


_WINDOWS = 400  # of a run
_FINER = 10  # times as many, to look at what is fast in it
FEWEST = 3  # dies
RATE = "scenario.rate."  # where the paths of what is replaced begin
MORE = 1.2  # times as much of a number

Dies = Float[np.ndarray, " dies"]


@dataclass(frozen=True)
class RateTests:
    """A lot on a rate table: `run(scenario)` without noise, `noisy(scenario, time, progress)` with it;
    `few(raised, scenario)` runs three dies without noise for each group of paths, with the numbers there `MORE` times
    as large. Means count from `settle` to `duration` [s]. `finer()` are the same tests in windows a tenth as long.
    """

    run: Callable[[Scenario], Outputs]
    noisy: Callable[[Scenario, float, Callable[[float], None] | None], Outputs]
    few: Callable[[Sequence[Collection[str]], Scenario], list[Outputs]]
    loop: ClosedLoop
    surroundings: Scenario
    full_scale: float
    settle: float
    duration: float
    sample_rate: float
    finer: "Callable[[], RateTests] | None" = None

    @classmethod
    def of(
        cls, what: str, loop: ClosedLoop, spread: Spread, scenario: Any, *, full_scale: float | str, dies: int,
        sample_rate: float | str | None, duration: float | str | None, settle: float | str | None, seed: int,
        windows: int = _WINDOWS,
    ) -> "RateTests":  # fmt: skip
        """From the arguments of a test, which is called `what`; `settle` is half the duration when left out. A spread
        of the rate is left out, which each test replaces.

        **Raises:** `InputError` for settings that cannot be run, and outside float64.
        """
        runtime.require_float64(what)
        plain = "plain numbers, or map `simulate` over a lot that `Spread.draw` has drawn"
        refuse_traced(f"`{what}` makes tables of a lot and", plain, loop, spread, scenario)
        loop, seed, dies = as_loop(loop), whole("seed", seed), whole("dies", dies, FEWEST)
        sample_rate, duration = run_of(loop, sample_rate, duration)
        full_scale = quantity("full_scale", full_scale, "rad/s")
        if not full_scale > 0.0:
            raise InputError(f"Argument `full_scale` must be positive, but {full_scale:g} rad/s was given.")
        settle = 0.5 * duration if settle is None else quantity("settle", settle, "s")
        if not 0.0 <= settle < duration:
            raise InputError(f"Argument `settle` must lie within the duration of {duration:g} s, but is {settle:g} s.")
        spread = spread.without(RATE)
        loop = replace(loop, blocks=None).sampled_at(sample_rate, duration=duration)
        window = max(1, count_steps(sample_rate, duration) // windows)
        many = partial(lot_outputs, loop, spread=spread, dies=dies, seed=seed, sample_rate=sample_rate, window=window)
        count = round(sample_rate * duration) // window
        finer = partial(
            cls.of, what, loop, spread, scenario, full_scale=full_scale, dies=dies, sample_rate=sample_rate,
            duration=duration, settle=settle, seed=seed, windows=_FINER * windows,
        )  # fmt: skip
        return cls(
            run=lambda scenario: many(scenario=scenario, windows=count, silent=True),
            noisy=lambda scenario, time, progress: many(
                scenario=scenario, windows=round(sample_rate * time) // window, stretch=count, progress=progress
            ),
            few=lambda raised, scenario: many(
                scenario=scenario, windows=count, dies=FEWEST, raised=raised, by=MORE, silent=True
            ).apart(len(raised)),
            loop=loop, surroundings=as_scenario(scenario), full_scale=full_scale, settle=settle, duration=duration,
            sample_rate=sample_rate, finer=finer,
        )  # fmt: skip

    def at(self, rate: float, after: float | None = None, **changes: Any) -> Scenario:
        """The surroundings at a constant rate [rad/s], or with a step to `after` in the middle of a run."""
        step = Step(0.5 * self.duration, rate if after is None else after, rate)
        return replace(self.surroundings, rate=step, **changes)


def settled_mean(run: Outputs, settle: float, what: str = "rate") -> Dies:
    """Mean from `settle` [s] on."""
    return np.mean(getattr(run, what)[:, round(settle / run.period) :], axis=1)
