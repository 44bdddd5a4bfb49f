"""What limits the bandwidth of a loop, by experiment: each number that may be the cause is raised, one by one."""

from dataclasses import replace
from functools import partial

import jax.numpy as jnp
import numpy as np

from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.tuning.tunable import numbers_at, placed

from .datasheet_tests import Answer, step_answer
from .rate_tests import FEWEST, RateTests


_MORE = 1.2  # times as much of a number
_MOVES = 0.1  # of its own change: how far a number must move the bandwidth to be its cause


def knobs(loop: ClosedLoop) -> dict[str, dict[str, float]]:
    """Numbers of the loop that may set its bandwidth, by what they are called: the path of each and what it is."""
    named = {f"`observer.{name}`": [f"observer.{name}"] for name in loop.observer.usually_tuned}
    named |= {words: [f"controller.{p}" for p in paths] for words, paths in loop.controller.sets_bandwidth.items()}
    if hasattr(loop.filter, "bandwidth"):
        named["`bandwidth` of the output filter"] = ["filter.bandwidth"]
    return {
        words: {name: value for path in paths for name, value in numbers_at(loop, path).items()}
        for words, paths in named.items()
    }


def limits(bench: RateTests, answer: Answer) -> tuple[str, ...]:
    """A sentence that names what sets the bandwidth of the design's loop, or why it has none; empty where nothing can
    be said.
    """
    offered = knobs(bench.loop)
    zero = [words for words, numbers in offered.items() if not all(numbers.values())]
    if answer.unknown or not np.isfinite(answer.bandwidth[:FEWEST]).any():
        constant = next((words for words in zero if "process_noise.rate" in words), None)
        return (f"No bandwidth: {constant} is zero, which takes the rate for constant; give one.",) if constant else ()
    before = float(np.nanmedian(answer.bandwidth[:FEWEST]))
    found = {words: _raised(bench, numbers) for words, numbers in offered.items() if words not in zero}
    moved = {words: abs(np.log(after / before) / np.log(_MORE)) for words, after in found.items() if after > 0.0}
    if not moved:
        return ()
    words = max(moved, key=lambda name: moved[name])
    if moved[words] < _MOVES:
        return (f"The bandwidth is the device's own, by its decay and mode split: {', '.join(moved)} do not move it.",)
    return (f"The bandwidth is set by {words}: a fifth more turns {before:.4g} Hz into {found[words]:.4g} Hz.",)


def _raised(bench: RateTests, numbers: dict[str, float]) -> float:
    """Median bandwidth [Hz] of a few dies with more of these numbers."""
    loop = placed(bench.loop, list(numbers), [jnp.asarray(_MORE * value) for value in numbers.values()])
    bench = replace(bench, run=partial(bench.few, loop))
    found = step_answer(bench, bench.run(bench.at(0.0)))[0].bandwidth
    return float(np.nanmedian(found)) if np.isfinite(found).any() else float("nan")
