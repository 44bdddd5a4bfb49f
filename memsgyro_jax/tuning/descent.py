"""Minimises a loss over few coordinates by BFGS, one step at a time, so that a person can watch and a stop can come
from outside: validation dies that no longer gain, or patience that has ended.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import BFGS


Vector = Float[np.ndarray, " n"]
_LONGEST = 2.0  # the longest step in coordinates, a factor e² of a number
_SHORTEST = 1e-4  # the shortest step worth an evaluation
_ARMIJO = 0.1  # of the fall that the slope promises: what a step must bring to be accepted
_FLATTEST = 1e-6  # of the steepest direction's squared slope: less counts as this
_COARSE = "what stands is the best of a coarse grid, from which no step made the validation dies fare better"
_PATIENCE = 3  # accepted steps that may bring next to nothing, or no gain on the validation dies
_WORTH = 0.02  # of the standard error of the loss: what these steps together must bring
_QUIET = np.errstate(all="ignore")  # what overflows is no step that is accepted; nobody else must know
_RENEWED = 0.2  # of the standard error where the metric was taken: from there on it is taken anew


@dataclass(frozen=True)
class DescentStep:
    """One accepted step: evaluations so far, the training loss and the validation loss there, and the coordinates."""

    evaluations: int
    training: float
    validation: float
    coordinates: Vector


@dataclass(frozen=True)
class Descent:
    """The way down: `steps` from the start on, the number of the `best` by validation, and why it ended."""

    steps: tuple[DescentStep, ...]
    best: int
    status: str

    @property
    def coordinates(self) -> Vector:
        """Those of the best step."""
        return self.steps[self.best].coordinates


class Judged(NamedTuple):
    """A loss at some coordinates: value, gradient, the slopes of its single dies, and the standard error of the value,
    below which a fall is worth nothing.
    """

    value: float
    slope: Vector
    slopes: Float[np.ndarray, "n dies"]
    error: float


def descend(
    loss: Callable[[Vector], Judged],
    validation: Callable[[Vector], float],
    start: Vector,
    *,
    evaluations: int,
    told: Callable[[DescentStep], None] | None = None,
) -> Descent:
    """Lower `loss` from `start`, at most `evaluations` times; keep the best by `validation`.

    The scatter of the dies' slopes is the metric: where they are steep, steps are short (for a likelihood the direction
    of Fisher scoring). The first step has length one. Where the scatter has changed much, it is taken anew.
    """
    steps: list[DescentStep] = []

    def accepted(count: int, value: float, at: Vector) -> None:
        steps.append(DescentStep(count, value, validation(at), at))
        if told:
            told(steps[-1])

    here = loss(start)
    accepted(1, here.value, start)
    walk = _Walk(here, start, 1.0)
    for count in range(2, evaluations + 1):
        if walk.stuck:
            return _finished(steps, "nothing free has an effect")
        before, trial = walk.point, walk.trial
        if np.max(np.abs(trial - before)) < _SHORTEST:
            return _finished(steps, "converged: no longer step lowers the loss")
        found = loss(trial)
        if walk.took(found):
            accepted(count, found.value, trial)
            ended = _ended(steps, found.error)
            if ended:
                return _finished(steps, ended)
            if found.error < _RENEWED * walk.error:
                walk = _Walk(found, trial, min(1.0, 2.0 * float(np.linalg.norm(trial - before))))
    return _finished(steps, "evaluations used up")


def sought(
    down: Callable[[Vector, int], Descent], moved: Callable[[Vector], Vector | None], start: Vector, evaluations: int,
    *, of_grid: bool = False,
) -> Descent:  # fmt: skip
    """`down` from `start` (`of_grid`: found by one), then again from where `moved` (a rescue by a grid) puts its end,
    until that finds nothing to move.

    All steps in a row; `down` is told where to begin and how many evaluations are left. A best place that no step has
    bettered since a grid found it is said to be that.
    """
    steps: list[DescentStep] = []
    coarse: set[int] = set()  # steps at which a grid stands
    while True:
        spent = steps[-1].evaluations if steps else 0
        found = down(start, evaluations - spent)
        coarse |= {len(steps)} if steps or of_grid else set()
        steps += [replace(step, evaluations=spent + step.evaluations) for step in found.steps]
        best = _finished(steps, found.status)
        further = moved(best.coordinates) if steps[-1].evaluations < evaluations else None
        if further is None:
            return replace(best, status=f"{best.status}; {_COARSE}") if best.best in coarse else best
        start = further


def _finished(steps: list[DescentStep], status: str) -> Descent:
    return Descent(tuple(steps), int(np.argmin([step.validation for step in steps])), status)


class _Walk:
    """BFGS with Armijo's rule, given the loss at one trial at a time, in coordinates that the metric makes round:
    `origin + root @ theirs`.
    """

    @_QUIET
    def __init__(self, here: Judged, origin: Vector, length: float):
        self.origin, self.root, self.first, self.error = origin, _root(here.slopes), here.value, here.error
        natural = float(np.linalg.norm(self.root @ self.root @ here.slope))
        self.stuck, self.unit = natural == 0.0, length / natural if natural > 0.0 else 0.0
        self.curvature = BFGS(exception_strategy="skip_update", init_scale=1.0)
        self.curvature.initialize(len(origin), "inv_hess")
        self.at, self.value, self.slope = np.zeros(len(origin)), 0.0, self.root @ here.slope * self.unit
        self.step = -self.slope

    @property
    def point(self) -> Vector:
        """The last accepted coordinates."""
        return self.origin + self.root @ self.at

    @property
    def trial(self) -> Vector:
        """Where the loss is wanted next."""
        return self.origin + self.root @ (self.at + self.step)

    @_QUIET
    def took(self, found: Judged) -> bool:
        """Whether the trial is accepted; then it chooses the next."""
        value, slope = (found.value - self.first) * self.unit, self.root @ found.slope * self.unit
        gain, expected = value - self.value, float(self.slope @ self.step)
        if not gain <= _ARMIJO * expected:
            # The parabola through what is known of this direction beats halving.
            lack = gain - expected
            self.step = self.step * float(np.clip(-0.5 * expected / lack if lack > 0.0 else 0.5, 0.1, 0.5))
            return False
        if np.any(slope != self.slope):  # SciPy warns of a slope that stays, and takes nothing from it
            self.curvature.update(self.step, slope - self.slope)
        self.at, self.value, self.slope = self.at + self.step, value, slope
        step = -self.curvature.dot(slope)
        length = np.linalg.norm(self.root @ step)
        self.step = step * min(1.0, _LONGEST / length if length > 0.0 else 1.0)
        return True


def _ended(steps: list[DescentStep], error: float) -> str | None:
    if len(steps) <= _PATIENCE:
        return None
    if steps[-1 - _PATIENCE].training - steps[-1].training < _WORTH * error:
        return "converged: the loss has stopped falling"
    before = min(step.validation for step in steps[:-_PATIENCE])
    if min(step.validation for step in steps[-_PATIENCE:]) >= before:
        return "stopped early: the validation dies gain no more"
    return None


def _root(slopes: Float[np.ndarray, "n dies"]) -> Float[np.ndarray, "n n"]:
    """Inverse square root of the mean outer product of the slopes; directions without slope count as nearly flat."""
    scatter = slopes @ slopes.T / slopes.shape[1]
    squares, vectors = np.linalg.eigh(scatter)
    if not squares[-1] > 0.0:
        return np.eye(len(slopes))
    return (vectors / np.sqrt(np.maximum(squares, _FLATTEST * squares[-1]))) @ vectors.T
