"""What limits the bandwidth of a loop, by experiment: each number that may be the cause is raised, one by one."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.loop.loop import ClosedLoop

from .datasheet_tests import Answer, step_answer
from .rate_tests import FEWEST, RateTests


_MORE = 1.2  # times as much of a number
_MOVES = 0.1  # of its own change: how far a number must move the bandwidth to be its cause
Knobs = dict[str, tuple[str, ...]]


def knobs(loop: ClosedLoop) -> Knobs:
    """Numbers of the loop that may set its bandwidth: what they are called, and their paths."""
    found: Knobs = {f"`observer.{name}`": (f"observer.{name}",) for name in loop.observer.usually_tuned}
    for words, paths in loop.controller.sets_bandwidth.items():
        found[words] = tuple(f"controller.{path}" for path in paths)
    if hasattr(loop.filter, "bandwidth"):
        found["`bandwidth` of the output filter"] = ("filter.bandwidth",)
    return found


def limits(bench: RateTests, answer: Answer) -> tuple[str, ...]:
    """A sentence that names what sets the bandwidth of the design's loop, or why it has none; empty where nothing can
    be said.
    """
    loop, offered = bench.loop, knobs(bench.loop)
    zero = [words for words, paths in offered.items() if not all(np.all(value) for value in _values(loop, paths))]
    if answer.unknown or not np.isfinite(answer.bandwidth[:FEWEST]).any():
        constant = next((words for words in zero if "process_noise.rate" in words), None)
        return (f"No bandwidth: {constant} is zero, which takes the rate for constant; give one.",) if constant else ()
    before, found = float(np.nanmedian(answer.bandwidth[:FEWEST])), {}
    for words, paths in offered.items():
        if words not in zero:
            more = [_MORE * jnp.asarray(value) for value in _values(loop, paths)]
            other = eqx.tree_at(lambda made, paths=paths: _values(made, paths), loop, more)
            found[words] = _bandwidth(replace(bench, run=partial(bench.few, other)))
    moved = {words: abs(np.log(after / before) / np.log(_MORE)) for words, after in found.items() if after > 0.0}
    if not moved:
        return ()
    words = max(moved, key=lambda name: moved[name])
    if moved[words] < _MOVES:
        return (f"The bandwidth is the device's own, by its decay and mode split: {', '.join(moved)} do not move it.",)
    return (f"The bandwidth is set by {words}: a fifth more of it makes {before:.4g} Hz {found[words]:.4g} Hz.",)


def _bandwidth(bench: RateTests) -> float:
    """Median over the dies [Hz]."""
    found = step_answer(bench, bench.run(bench.at(0.0)))[0].bandwidth
    return float(np.nanmedian(found)) if np.isfinite(found).any() else float("nan")


def _values(loop: ClosedLoop, paths: tuple[str, ...]) -> list:
    found = []
    for path in paths:
        here = loop
        for part in path.split("."):
            here = getattr(here, part)
        found.append(here)
    return found
