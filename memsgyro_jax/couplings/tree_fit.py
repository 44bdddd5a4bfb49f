"""Maximum likelihood over any experiments: what is free of a tree is moved until every record is met within its noise.

`fit_tree` is a pure function of arrays: jit it, vmap it over noise draws, differentiate its result by the data (by the
implicit function theorem).
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.runtime import require_float64
from memsgyro_jax.base.transforms import from_vector, prior_residual, to_vector
from memsgyro_jax.base.transforms import logarithmic as which_logarithmic
from memsgyro_jax.base.transforms import names as free_names
from memsgyro_jax.measurement.experiments.base import Experiment
from memsgyro_jax.measurement.least_squares import Information, NullDirection, gate, least_squares


DAMPING = 1e-4  # nearly a Gauss-Newton step, right from the good starts used here, and soon tamed from a bad one
SETTLED = 100.0  # standard deviations per unit of `tolerance`
OPEN_STEP = 5.0  # in natural logarithms


class Fit(eqx.Module):
    """Outcome of a maximum-likelihood fit.

    Args:
        values: the tree with the free leaves at the optimum.
        spec: which leaves were free.
        chi2: sum of squared whitened residuals (and priors).
        dof: their number less the number of free parameters.
        information: what the data hold of the unbounded coordinates.
        residual: whitened residual at the optimum.
        converged: whether the optimiser met its tolerance.
        steps: optimiser steps taken.
    """

    values: PyTree
    spec: PyTree
    chi2: Array
    dof: int = eqx.field(static=True)
    information: Information
    residual: Float[Array, " r"]
    converged: Array
    steps: Array

    @property
    def chi2_per_dof(self) -> Array:
        """1 within √(2/dof) where model and noise are right."""
        return self.chi2 / self.dof

    @property
    def covariance(self) -> Float[Array, "n n"]:
        """Of the unbounded coordinates; infinite where the data do not hold them."""
        return self.information.covariance

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return free_names(self.values, self.spec)

    @property
    def status(self) -> str:
        """A sentence for humans: converged or not, and what the data leave open."""
        if not bool(self.converged):
            return f"not converged after {int(self.steps)} steps"
        nulls = [*self.open_parameters(), *map(str, self.null_directions())]
        return "converged" if not nulls else "converged; the data leave open: " + "; ".join(nulls)

    def open_parameters(self) -> tuple[str, ...]:
        """Positive parameters that may change by orders of magnitude alone without moving the residual by one standard
        deviation.
        """
        logarithmic = which_logarithmic(self.values, self.spec)
        sizes = np.asarray(self.information.size)
        return tuple(
            name
            for name, log, size in zip(self.names, logarithmic, sizes, strict=True)
            if log and not size > 1 / OPEN_STEP
        )

    def std_of(self, function, *, values: PyTree | None = None) -> PyTree:
        """Standard deviation of any function of the fitted tree, by linear propagation of the covariance."""
        tree = self.values if values is None else values
        vector = to_vector(tree, self.spec)
        jacobian = jax.jacfwd(lambda v: function(from_vector(v, tree, self.spec)))(vector)
        return jax.tree.map(lambda j: jnp.linalg.norm(j @ self.information.root, axis=-1), jacobian)

    def null_directions(self) -> tuple[NullDirection, ...]:
        """Combinations of coordinates that the data do not hold."""
        return self.information.null_directions(self.names)


def fit_tree(
    values: PyTree, spec: PyTree, experiments: Sequence[Experiment], *, max_steps: int = 200, tolerance: float = 1e-6
) -> Fit:
    """Move the free leaves of `values` to the maximum of the likelihood of all `experiments`.

    Args:
        values: the start, and what stays fixed: anything the experiments predict from, e.g. a `Bench`.
        spec: the tree of `memsgyro_jax.base.free` beside it.
        experiments: records with their noise; their residuals are concatenated.
        max_steps: bound on the steps of Levenberg and Marquardt's method.
        tolerance: stop when a step changes χ² and every scaled coordinate relatively by less than this.

    **Raises:** `InputError` in float32, without experiments, with more free parameters than data, or if a start
    violates a bound.
    """
    require_float64("Fitting")
    experiments = tuple(experiments)
    if not experiments:
        raise InputError("Argument `experiments` must hold at least one record, but is empty.")
    tree, converged, steps = _optimised(values, spec, experiments, max_steps, tolerance)
    return evaluate(tree, spec, experiments, converged=converged, steps=steps)


def fit_tree_from(
    candidates: PyTree, spec: PyTree, experiments: Sequence[Experiment], *, max_steps: int = 60, tolerance: float = 1e-6
) -> Fit:
    """Fit from every member of a batch of starts (leading axis on every leaf), then once more from the best end;
    arguments as of `fit_tree`.

    The starts run one after the other through one compiled optimiser (as lanes of a `vmap` all would wait for the
    slowest), and no further ones once two were tried and the record is explained.
    """
    require_float64("Fitting")
    experiments = tuple(experiments)
    count = jax.tree.leaves(candidates)[0].shape[0]
    readings = sum(experiment.noise.whiten(experiment.measured, experiment.measured).size for experiment in experiments)

    def attempt(best: tuple, index: Array) -> tuple:
        tree, cost, *_ = best
        begin = jax.tree.map(
            lambda starts, one: jnp.where(index < count, starts[jnp.minimum(index, count - 1)], one), candidates, tree
        )
        end, converged, steps = _optimised(begin, spec, experiments, max_steps, tolerance)
        reached = _cost(end, experiments)
        better = (reached <= cost) | ~jnp.isfinite(cost)
        return jax.tree.map(lambda a, b: jnp.where(better, a, b), (end, reached, converged, steps), best)

    def run(best: tuple, index: Array) -> tuple[tuple, None]:
        _, cost, converged, _ = best
        # Noise alone explains the record already: what the starts left could find is the same optimum.
        enough = converged & (cost < readings * gate(readings)) & (index >= 2)
        return jax.lax.cond(enough, lambda: best, lambda: attempt(best, index)), None

    first = jax.tree.map(lambda leaf: leaf[0], candidates)
    begin = (first, jnp.asarray(jnp.inf), jnp.asarray(False), jnp.asarray(0))
    (tree, _, converged, steps), _ = jax.lax.scan(run, begin, jnp.arange(count + 1))
    return evaluate(tree, spec, experiments, converged=converged, steps=steps)


def evaluate(
    values: PyTree,
    spec: PyTree,
    experiments: Sequence[Experiment],
    *,
    converged: bool | Array = True,
    steps: int | Array = 0,
) -> Fit:
    """The `Fit` at given values, without moving them: residual, χ², covariance."""
    vector = to_vector(values, spec)
    result, jacobian = _linearise(vector, values, spec, tuple(experiments))
    count, size = jacobian.shape
    if count <= size:
        raise InputError(
            f"Argument `experiments` must hold more than {size} real readings for {size} free parameters, "
            f"but holds {count}."
        )
    return Fit(
        values=values,
        spec=spec,
        chi2=jnp.sum(result**2),
        dof=count - size,
        information=Information.of(jacobian),
        residual=result,
        converged=jnp.asarray(converged),
        steps=jnp.asarray(steps),
    )


def best_start(candidates: PyTree, experiments: Sequence[Experiment], keep: int) -> PyTree:
    """The `keep` members of a batch of value trees (leading axis on every leaf) with the smallest sum of squares, best
    first.
    """
    cost = jax.vmap(lambda tree: _cost(tree, experiments))(candidates)
    order = jnp.argsort(jnp.where(jnp.isfinite(cost), cost, jnp.inf))[:keep]
    return jax.tree.map(lambda leaf: leaf[order], candidates)


def _residual(vector: Array, values: PyTree, spec: PyTree, experiments: Sequence[Experiment]) -> Array:
    tree = from_vector(vector, values, spec)
    parts = [experiment.residual(tree) for experiment in experiments]
    return jnp.concatenate([*parts, prior_residual(vector, values, spec)])


def _cost(tree: PyTree, experiments: Sequence[Experiment]) -> Array:
    return sum(jnp.sum(experiment.residual(tree) ** 2) for experiment in experiments)


def _linearise(vector: Array, values: PyTree, spec: PyTree, experiments: Sequence[Experiment]) -> tuple[Array, Array]:
    def function(v: Array) -> Array:
        return _residual(v, values, spec, experiments)

    value, push = jax.linearize(function, vector)
    return value, jax.vmap(push, out_axes=1)(jnp.eye(vector.size))


def _optimised(values, spec, experiments, max_steps, tolerance) -> tuple[PyTree, Array, Array]:
    vector, converged, steps = _optimum(values, spec, experiments, max_steps=max_steps, tolerance=tolerance)
    return from_vector(vector, values, spec), converged, steps


@eqx.filter_custom_jvp
def _optimum(values, spec, experiments, *, max_steps, tolerance) -> tuple[Array, Array, Array]:
    """The free coordinates at the optimum, whether it is one, and steps taken."""
    start = to_vector(values, spec)
    residual, jacobian = _linearise(start, values, spec, experiments)
    norm = jnp.linalg.norm(jacobian, axis=0)
    scale = 1 / jnp.where(norm > 0, norm, 1.0)

    def linearise(place: Array) -> tuple[Array, Array]:
        value, slope = _linearise(start + scale * place, values, spec, experiments)
        return value, slope * scale

    tolerance = SETTLED * tolerance
    end = least_squares(
        linearise,
        (residual, jacobian * scale),
        damping=DAMPING,
        tolerance=tolerance,
        evaluations=max_steps + 1,
        loop=jax.lax.while_loop,
    )
    settled = end.settled(tolerance)
    # The last step is known, but too small to be worth another evaluation.
    return start + scale * (end.place + jnp.where(settled, end.move, 0.0)), settled, end.evaluations - 1


@_optimum.def_jvp
def _optimum_jvp(primals, tangents, *, max_steps, tolerance):
    """dx = −H⁻¹·∂g with g = Jᵀr, which vanishes at the optimum, and H its exact derivative by x."""
    vector, converged, steps = _optimum(*primals, max_steps=max_steps, tolerance=tolerance)

    def gradient(at: Array, values, spec, experiments) -> Array:
        residual, jacobian = _linearise(at, values, spec, experiments)
        return jacobian.T @ residual

    _, push = eqx.filter_jvp(lambda *arguments: gradient(vector, *arguments), primals, tangents)
    hessian = jax.jacfwd(lambda at: gradient(at, *primals))(vector)
    norm = jnp.linalg.norm(hessian, axis=0)
    scale = jnp.where(norm > 0, norm, 1.0) ** -0.5
    move = scale * jnp.linalg.solve(hessian * scale * scale[:, None], scale * push)
    return (vector, converged, steps), (-move, None, None)
