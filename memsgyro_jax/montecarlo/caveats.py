"""What must be said beside a yield: errors that still move when the runs end, dies whose modes have changed places."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy import stats

from memsgyro_jax.base.concrete import at_hand
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.settling import duration_to_settle, not_at_rest

from .batch import Plan
from .sketch import Sketch


_ENDS = 5  # the part of the settled windows that is its beginning, and its end
_CHANCE = 1e-3  # probability at which dies without any drift are taken to move
_MATTERS = 0.1  # of the tolerance: a movement that may change a yield
_NEAR = 0.5  # of the tolerance: nine in ten errors within it throughout, and no die was or is about to fail
_STARTS = 3.0  # times its own scatter later: errors as far from there before are of a start, not of stationary noise
_FEWEST = 16  # settled windows of which halves are compared
_SWELLS = 1.2  # times: what a start must add to the scatter of the lot to be worth a word
_MATCHED = 1e-6  # relative distance of stiffnesses below which a design has no order of its modes
NAMED = 5  # dies named in a sentence


class Movement:
    """Sizes of the rate errors at the beginning and at the end of the settled part, and how many dies fell or rose."""

    def __init__(self, plan: Plan):
        settled = np.flatnonzero(plan.window_times >= plan.settle)
        few = len(settled) // _ENDS
        self.plan, self.ends = plan, (settled[:few], settled[len(settled) - few :])
        self.sizes = Sketch(), Sketch()
        self.fell = self.rose = 0

    def add(self, true: Float[np.ndarray, "dies windows"], estimate: Float[np.ndarray, "dies windows"]) -> None:
        """Take in dies, where their rate is constant and the run has as many windows."""
        settled = true[:, self.ends[0][0] :] if self.ends[0].size else np.empty((0, 0))
        if not settled.size or np.ptp(settled, axis=1).any():
            return
        early, late = (np.abs(np.mean((estimate - true)[:, end], axis=1)) for end in self.ends)
        self.sizes[0].add(early)
        self.sizes[1].add(late)
        self.fell, self.rose = self.fell + int(np.sum(late < early)), self.rose + int(np.sum(late > early))

    def sentence(self, loop: ClosedLoop) -> str | None:
        """How the errors still move, and what helps; None where they rest, or move by nothing that counts."""
        count, most = self.fell + self.rose, max(self.fell, self.rose)
        if not count or 2.0 * stats.binom.sf(most - 1, count, 0.5) > _CHANCE:
            return None
        (early, before), (late, after) = (sizes.quantile(0.5, 0.9) for sizes in self.sizes)
        plan, falls = self.plan, self.fell > self.rose
        if abs(late - early) < _MATTERS * plan.tolerance or max(before, after) < _NEAR * plan.tolerance:
            return None
        begin, end = (float(np.mean(plan.window_times[part])) for part in self.ends)
        enough = duration_to_settle(loop, plan.settle, plan.samples * plan.period)
        return (
            f"the error still {'falls' if falls else 'rises'} on {most} of {count} dies, in the median from "
            f"{np.degrees(early):.3g} deg/s at {begin:.3g} s to {np.degrees(late):.3g} deg/s at {end:.3g} s: the yield "
            f"is of this start; run longer, `duration` = {enough:.3g} s, until this line goes"
        )


class Scatter:
    """How errors vary within the settled part of each run, its first half beside its second: noise does not know which
    of them comes first, and a die that still pulls in does, whatever the design's own time constant says.
    """

    def __init__(self, plan: Plan):
        self.plan, settled = plan, np.flatnonzero(plan.window_times >= plan.settle)
        half = len(settled) // 2 if len(settled) >= _FEWEST else 0
        self.halves = settled[:half], settled[len(settled) - half :]
        self.dies = self.starting = self.ending = 0
        self.squares = np.zeros(2)  # about the mean of the second half: in the first, and in the second

    def add(self, true: Float[np.ndarray, "dies windows"], estimate: Float[np.ndarray, "dies windows"]) -> None:
        """Take in dies, where their rate is constant and the run has as many windows."""
        if not self.halves[0].size or np.ptp(true[:, self.halves[0][0] :], axis=1).any():
            return
        first, second = ((estimate - true)[:, half] for half in self.halves)
        before, rest, after, begun = (
            np.mean((one - np.mean(about, axis=1, keepdims=True)) ** 2, axis=1)
            for one, about in ((first, second), (second, second), (second, first), (first, first))
        )
        self.dies += len(first)
        self.starting += int(np.sum(before > _STARTS**2 * rest))
        self.ending += int(np.sum(after > _STARTS**2 * begun))
        self.squares += np.sum(before), np.sum(rest)

    def sentence(self, loop: ClosedLoop) -> str | None:
        """How many dies still start and what that does to the scatter within a run, or that the design does; None where
        nothing tells of it, or errors wander to and fro alike.
        """
        plan, end = self.plan, self.plan.samples * self.plan.period
        early, late = np.degrees(np.sqrt(self.squares / max(self.dies, 1)))
        if self.starting <= _STARTS * self.ending or self.squares[0] <= _SWELLS**2 * self.squares[1]:
            slow = self.dies and not_at_rest(loop, plan.settle, end)
            return "may be: figures count before the design has come to rest, as a note says" if slow else None
        middle = 0.5 * (plan.settle + end)
        return (
            f"{self.starting} of {self.dies} dies still move within the settled part, which is no noise: {early:.3g} "
            f"deg/s (rms over the dies) from {plan.settle:.3g} to {middle:.3g} s, {late:.3g} deg/s from there on; run "
            f"longer, `duration` = {duration_to_settle(loop, plan.settle, end):.3g} s, until this line goes"
        )


class Order(NamedTuple):
    """Which coefficients are the stiffnesses of the axes over mass, and whether the design's y is the stiffer."""

    x: int
    y: int
    rising: bool

    @classmethod
    def of(cls, loop: ClosedLoop) -> "Order | None":
        """That of the design; None for matched modes, and for a device without such coefficients."""
        names = loop.device.model.names
        if not {"kxx", "kyy"} <= set(names):
            return None
        x, y = names.index("kxx"), names.index("kyy")
        theta = at_hand(loop.device).coefficients(0.0)
        split = float(theta[y]) - float(theta[x])
        return cls(x, y, split > 0.0) if abs(split) > _MATCHED * float(theta[x]) else None

    def crossed(self, theta: Float[np.ndarray, "dies coefficients"]) -> Bool[np.ndarray, " dies"]:
        """The dies whose modes stand the other way round."""
        return (theta[:, self.y] > theta[:, self.x]) != self.rising

    def sentence(self, dies: list[int], count: int, of: int) -> str:
        """What that means for the figures."""
        below, above = ("y", "x") if self.rising else ("x", "y")
        named = ", ".join(map(str, dies[:NAMED])) + (", ..." if count > NAMED else "")
        return (
            f"{count} of {of} ({named}): mode {below} below mode {above}, unlike the design, so devices of another "
            "kind: spread the frequencies less, or together (`shared`)"
        )
