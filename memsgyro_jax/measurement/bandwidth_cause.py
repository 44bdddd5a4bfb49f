"""What limits the bandwidth of a loop, by experiment: each number that may be the cause is raised, all side by side."""

import numpy as np

from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.tuning.tunable import numbers_at

from .datasheet_tests import Answer, step_answer, step_size
from .rate_tests import FEWEST, MORE, RateTests


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
    found = _raised(bench, {words: numbers for words, numbers in offered.items() if words not in zero})
    moved = {words: abs(np.log(after / before) / np.log(MORE)) for words, after in found.items() if after > 0.0}
    if not moved:
        return ()
    words = max(moved, key=lambda name: moved[name])
    if moved[words] < _MOVES:
        others = f"{', '.join(moved)} {'does' if len(moved) == 1 else 'do'} not move it"
        return (f"The bandwidth is the device's own, by its decay and mode split: {others}.",)
    return (f"The bandwidth is set by {words}: a fifth more turns {before:.4g} Hz into {found[words]:.4g} Hz.",)


def _raised(bench: RateTests, knobs: dict[str, dict[str, float]]) -> dict[str, float]:
    """Median bandwidth [Hz] of a few dies with more of each of these numbers, all side by side."""
    if not knobs:
        return {}
    raised = [tuple(numbers) for numbers in knobs.values()]
    runs = zip(*(bench.few(raised, bench.at(0.0, after)) for after in (0.0, step_size(bench))), strict=True)
    found = {name: step_answer(bench, *pair)[0].bandwidth for name, pair in zip(knobs, runs, strict=True)}
    return {name: float(np.nanmedian(of)) if np.isfinite(of).any() else float("nan") for name, of in found.items()}
