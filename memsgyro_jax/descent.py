"""Minimises a loss over few coordinates with optimistix' BFGS, one step at a time, so that a person can watch and a
stop can come from outside: validation dies that no longer gain, or patience that has ended.
"""

from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Float


Vector = Float[np.ndarray, " n"]
_LONGEST = 2.0  # the longest step in coordinates, a factor e² of a number
_TOLERANCE = 1e-3  # in coordinates and in the loss relative to its first fall
_PATIENCE = 3  # accepted steps without a gain on the validation dies


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
    loss: Callable[[Vector], tuple[float, Vector]],
    validation: Callable[[Vector], float],
    start: Vector,
    *,
    evaluations: int,
    told: Callable[[Step], None] | None = None,
) -> Descent:
    """Lower `loss` (value and gradient) from `start`, at most `evaluations` times; keep the best by `validation`."""
    solver: optx.BFGS = optx.BFGS(rtol=_TOLERANCE, atol=_TOLERANCE)
    point, state, unit, steps, status = jnp.asarray(start), None, 1.0, [], "evaluations used up"
    for count in range(1, evaluations + 1):
        trial = point if state is None else state.y_eval
        value, slope = loss(np.asarray(trial))
        if state is None:
            # The first step has length one, and the loss counts in what that step promises.
            size = float(np.linalg.norm(slope))
            if size == 0.0:
                return Descent((Step(1, value, validation(start), start),), 0, "nothing free has an effect")
            unit = 1.0 / size
            state = solver.init(_known, point, (value, slope), {}, _struct(), None, frozenset())
        before = int(state.num_accepted_steps)
        known = (jnp.asarray((value - _origin(steps, value)) * unit), jnp.asarray(slope * unit))
        point, state = _step(solver, point, known, state)
        if int(state.num_accepted_steps) > before:
            steps.append(Step(count, value, validation(np.asarray(trial)), np.asarray(trial)))
            if told:
                told(steps[-1])
            ended = _ended(steps, bool(state.terminate))
            if ended:
                status = ended
                break
        elif float(jnp.max(jnp.abs(state.y_eval - point))) < 1e-6:
            status = "converged: no shorter step lowers the loss"
            break
    best = int(np.argmin([step.validation for step in steps]))
    return Descent(tuple(steps), best, status)


def _origin(steps: list[Step], value: float) -> float:
    """The loss counts from its start, so that tolerances mean its fall."""
    return steps[0].training if steps else value


def _ended(steps: list[Step], terminate: bool) -> str | None:
    if len(steps) > 1 and terminate:
        return "converged"
    if len(steps) > _PATIENCE:
        fall = steps[0].training - steps[-1].training
        recent = steps[-1 - _PATIENCE].training - steps[-1].training
        if recent < _TOLERANCE * fall:
            return "converged: the loss has stopped falling"
        before = min(step.validation for step in steps[:-_PATIENCE])
        if min(step.validation for step in steps[-_PATIENCE:]) >= before:
            return "stopped early: the validation dies gain no more"
    return None


def _known(coordinates, known):
    """A function whose value and gradient were computed beforehand, as optimistix sees it."""
    value, slope = known
    return value + jnp.sum(slope * (coordinates - jax.lax.stop_gradient(coordinates))), None


def _struct() -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct((), jnp.zeros(()).dtype)


@eqx.filter_jit
def _step(solver: optx.BFGS, point, known: tuple, state):
    point, state, _ = solver.step(_known, point, known, {}, state, frozenset())
    away = state.y_eval - point
    size = jnp.linalg.norm(away)
    shorter = point + away * jnp.minimum(1.0, _LONGEST / jnp.where(size > 0.0, size, 1.0))
    return point, eqx.tree_at(lambda s: s.y_eval, state, shorter)
