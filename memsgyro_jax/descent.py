"""Minimises a loss over few coordinates with optimistix' BFGS, one step at a time, so that a person can watch and a
stop can come from outside: validation dies that no longer gain, or patience that has ended.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Float


Vector = Float[np.ndarray, " n"]
_LONGEST = 2.0  # the longest step in coordinates, a factor e² of a number
_SHORTEST = 1e-4  # the shortest step worth an evaluation
_FLATTEST = 1e-6  # of the steepest direction's squared slope: less counts as this
_TOLERANCE = 1e-3  # of the whole fall: what the last steps together must still gain
_PATIENCE = 3  # accepted steps that may bring less, or no gain on the validation dies


@dataclass(frozen=True)
class Step:
    """One accepted step: evaluations so far, the training loss and the validation loss there, and the coordinates."""

    evaluations: int
    training: float
    validation: float
    coordinates: Vector


@dataclass(frozen=True)
class Descent:
    """The way down: `steps` from the start on, the number of the `best` by validation, and why it ended."""

    steps: tuple[Step, ...]
    best: int
    status: str

    @property
    def coordinates(self) -> Vector:
        """Those of the best step."""
        return self.steps[self.best].coordinates


def descend(
    loss: Callable[[Vector], tuple[float, Vector, Float[np.ndarray, "n dies"]]],
    validation: Callable[[Vector], float],
    start: Vector,
    *,
    evaluations: int,
    told: Callable[[Step], None] | None = None,
) -> Descent:
    """Lower `loss` from `start`, at most `evaluations` times; keep the best by `validation`.

    `loss` gives value, gradient, and the slopes of the single dies. Their scatter is the metric: where the dies' slopes
    are steep, steps are short (for a likelihood the direction of Fisher scoring). The first step has length one.
    """
    value, slope, slopes = loss(start)
    steps = [Step(1, value, validation(start), start)]
    if told:
        told(steps[0])
    root = _root(slopes)
    length = float(np.linalg.norm(root @ root @ slope))
    if length == 0.0:
        return Descent(tuple(steps), 0, "nothing free has an effect")
    unit = 1.0 / length
    walk = _Walk(value, root @ slope * unit)
    for count in range(2, evaluations + 1):
        trial = start + root @ walk.trial
        if np.max(np.abs(root @ walk.away)) < _SHORTEST:
            return _finished(steps, "converged: no longer step lowers the loss")
        value, slope, _ = loss(trial)
        if walk.took((value - steps[0].training) * unit, root @ slope * unit, root):
            steps.append(Step(count, value, validation(trial), trial))
            if told:
                told(steps[-1])
            ended = _ended(steps)
            if ended:
                return _finished(steps, ended)
    return _finished(steps, "evaluations used up")


def sought(
    down: Callable[[Vector, int], Descent], moved: Callable[[Vector], Vector | None], start: Vector, evaluations: int
) -> Descent:
    """`down` from `start`, then again from where `moved` (a rescue) puts its end, until that finds nothing to move.

    All steps in a row; `down` is told where to begin and how many evaluations are left.
    """
    steps: list[Step] = []
    while True:
        spent = steps[-1].evaluations if steps else 0
        found = down(start, evaluations - spent)
        steps += [replace(step, evaluations=spent + step.evaluations) for step in found.steps]
        best = _finished(steps, found.status)
        further = moved(best.coordinates) if steps[-1].evaluations < evaluations else None
        if further is None:
            return best
        start = further


def _finished(steps: list[Step], status: str) -> Descent:
    return Descent(tuple(steps), int(np.argmin([step.validation for step in steps])), status)


class _Walk:
    """optimistix' BFGS with its state, given the loss at one trial at a time."""

    def __init__(self, value: float, slope: Vector):
        # Its own test of convergence would judge coordinates that the metric has scaled; `_ended` decides instead.
        self.solver: optx.BFGS = optx.BFGS(rtol=0.0, atol=1e-14)
        self.point = jnp.zeros(len(slope))
        like = jax.ShapeDtypeStruct((), self.point.dtype)
        self.state = self.solver.init(_known, self.point, (0.0, slope), {}, like, None, frozenset())
        self.value, self.slope = 0.0, slope
        self.took(0.0, slope, np.eye(len(slope)))

    @property
    def trial(self) -> Vector:
        """Where the loss is wanted next."""
        return np.asarray(self.state.y_eval)

    @property
    def away(self) -> Vector:
        """The step that the trial is."""
        return self.trial - np.asarray(self.point)

    def took(self, value: float, slope: Vector, root: np.ndarray) -> bool:
        """Whether the trial, with its value and gradient, is accepted; then it chooses the next."""
        before, away = int(self.state.num_accepted_steps), self.away
        known = (jnp.asarray(value), jnp.asarray(slope))
        self.point, self.state = _step(self.solver, self.point, known, self.state)
        accepted = int(self.state.num_accepted_steps) > before
        if accepted:
            self.value, self.slope = value, slope
            length = np.linalg.norm(root @ self.away)
            shorter = self.away * min(1.0, _LONGEST / length if length > 0.0 else 1.0)
        else:
            # The parabola through what is known of this direction beats halving.
            expected = float(self.slope @ away)
            lack = value - self.value - expected
            shorter = away * float(np.clip(-0.5 * expected / lack if lack > 0.0 else 0.5, 0.1, 0.5))
        self.state = eqx.tree_at(lambda state: state.y_eval, self.state, self.point + shorter)
        return accepted


def _ended(steps: list[Step]) -> str | None:
    if len(steps) <= _PATIENCE:
        return None
    fall = steps[0].training - steps[-1].training
    if steps[-1 - _PATIENCE].training - steps[-1].training < _TOLERANCE * fall:
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


def _known(coordinates, known):
    """A function whose value and gradient were computed beforehand, as optimistix sees it."""
    value, slope = known
    return value + jnp.sum(slope * (coordinates - jax.lax.stop_gradient(coordinates))), None


@eqx.filter_jit
def _step(solver: optx.BFGS, point, known: tuple, state):
    point, state, _ = solver.step(_known, point, known, {}, state, frozenset())
    return point, state
