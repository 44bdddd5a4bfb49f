"""Maximum likelihood over any experiments: what is free is moved until every record is met within its noise.

`fit` is a pure function of arrays: jit it, vmap it over noise draws, differentiate its result by the data (implicit
function theorem, through optimistix).
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, PyTree

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.runtime import require_float64
from memsgyro_jax.base.transforms import from_vector, prior_residual, to_vector
from memsgyro_jax.base.transforms import logarithmic as which_logarithmic
from memsgyro_jax.base.transforms import names as free_names
from memsgyro_jax.measurement.experiments.base import Experiment


# The optimiser's damping starts at one in its own coordinates. With a unit of a hundred standard deviations that is
# nearly a Gauss-Newton step, right from the good starts used here, and enough to be tamed within a few steps from a
# bad one.
REACH = 100.0
OPEN_STEP = 5.0  # in natural logarithms


class NullDirection(eqx.Module):
    """A combination of free parameters that the data do not hold: `std` of the combination and its largest parts, by
    name.
    """

    std: float
    parts: tuple[tuple[str, float], ...] = eqx.field(static=True)

    def __str__(self) -> str:
        return " ".join(f"{weight:+.2f}·{name}" for name, weight in self.parts)


class Fit(eqx.Module):
    """Outcome of a maximum-likelihood fit.

    Args:
        values: the tree with the free leaves at the optimum.
        spec: which leaves were free.
        chi2: sum of squared whitened residuals (and priors).
        dof: their number less the number of free parameters.
        covariance: inverse Fisher information of the unbounded coordinates (n, n); the pseudo-inverse where directions
            are null.
        sensitivity: right singular vectors (n, n) and `singular` values (n,) of the whitened Jacobian in scaled
            coordinates.
        scale: coordinate step that moves the residual by one standard deviation (n,).
        residual: whitened residual at the optimum.
        converged: whether the optimiser met its tolerance.
        steps: optimiser steps taken.
    """

    values: PyTree
    spec: PyTree
    chi2: Array
    dof: int = eqx.field(static=True)
    covariance: Float[Array, "n n"]
    sensitivity: Float[Array, "n n"]
    singular: Float[Array, " n"]
    scale: Float[Array, " n"]
    residual: Float[Array, " r"]
    converged: Array
    steps: Array

    @property
    def chi2_per_dof(self) -> Array:
        """1 within √(2/dof) where model and noise are right."""
        return self.chi2 / self.dof

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
        return tuple(
            name
            for name, log, step in zip(self.names, logarithmic, np.asarray(self.scale), strict=True)
            if log and not step < OPEN_STEP
        )

    def std_of(self, function, *, values: PyTree | None = None) -> PyTree:
        """Standard deviation of any function of the fitted tree, by linear propagation of the covariance."""
        tree = self.values if values is None else values
        vector = to_vector(tree, self.spec)
        jacobian = jax.jacfwd(lambda v: function(from_vector(v, tree, self.spec)))(vector)
        return jax.tree.map(
            lambda j: jnp.sqrt(jnp.maximum(jnp.einsum("...i,ij,...j->...", j, self.covariance, j), 0.0)), jacobian
        )

    def null_directions(self, tolerance: float = 1e-6) -> tuple[NullDirection, ...]:
        """Directions whose information is below `tolerance` of the best one, or that the data do not hold at all."""
        singular, names = np.asarray(self.singular), self.names
        out = []
        for value, vector in zip(singular, np.asarray(self.sensitivity), strict=True):
            if value > tolerance * singular.max():
                continue
            order = np.argsort(-np.abs(vector))[:4]
            parts = tuple((names[i], float(vector[i])) for i in order if abs(vector[i]) > 0.1)
            out.append(NullDirection(float(1 / value) if value > 0 else float("inf"), parts))
        return tuple(out)


def fit(
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
    tree, converged, steps = _optimise(values, spec, experiments, max_steps, tolerance)
    return evaluate(tree, spec, experiments, converged=converged, steps=steps)


def fit_from(
    candidates: PyTree, spec: PyTree, experiments: Sequence[Experiment], *, max_steps: int = 60, tolerance: float = 1e-6
) -> Fit:
    """Fit from every member of a batch of starts (leading axis on every leaf), then once more from the best end;
    arguments as of `fit`.

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
        end, converged, steps = _optimise(begin, spec, experiments, max_steps, tolerance)
        reached = _cost(end, experiments)
        better = (reached <= cost) | ~jnp.isfinite(cost)
        return jax.tree.map(lambda a, b: jnp.where(better, a, b), (end, reached, converged, steps), best)

    def run(best: tuple, index: Array) -> tuple[tuple, None]:
        _, cost, converged, _ = best
        # Noise alone explains the record already: what the starts left could find is the same optimum.
        enough = converged & (cost < readings + 3 * (2 * readings) ** 0.5) & (index >= 2)
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
    covariance, sensitivity, singular, step = _information(jacobian)
    return Fit(
        values=values,
        spec=spec,
        chi2=jnp.sum(result**2),
        dof=count - size,
        covariance=covariance,
        sensitivity=sensitivity,
        singular=singular,
        scale=step,
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


def fisher_covariance(values: PyTree, spec: PyTree, experiments: Sequence[Experiment]) -> Float[Array, "n n"]:
    """Cramér-Rao bound: inverse Fisher information of the coordinates at given values, no data needed."""
    require_float64("The Cramér-Rao bound")
    return _information(_linearise(to_vector(values, spec), values, spec, experiments)[1])[0]


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


def _optimise(values, spec, experiments, max_steps, tolerance):
    """Levenberg-Marquardt in coordinates scaled so that a unit step of each alone moves the residual by `REACH`
    standard deviations.

    In these coordinates the normal equations are well enough conditioned, and ten times cheaper than a QR of the tall
    Jacobian.
    """
    start = to_vector(values, spec)
    _, jacobian = _linearise(start, values, spec, experiments)
    norm = jnp.linalg.norm(jacobian, axis=0)
    scale = jax.lax.stop_gradient(REACH / jnp.where(norm > 0, norm, 1.0))

    def residual(step: Array, arguments: tuple) -> Array:
        begin, tree, records = arguments
        return _residual(begin + scale * step, tree, spec, records)

    solver: optx.AbstractLeastSquaresSolver = optx.LevenbergMarquardt(
        rtol=tolerance, atol=tolerance, linear_solver=lx.Normal(lx.Cholesky())
    )
    solution: optx.Solution = optx.least_squares(
        residual,
        solver,
        jnp.zeros_like(start),
        (start, values, experiments),
        options={"jac": "fwd"},
        max_steps=max_steps,
        throw=False,
    )
    tree = from_vector(start + scale * solution.value, values, spec)
    return tree, solution.result == optx.RESULTS.successful, solution.stats["num_steps"]


def _information(jacobian: Array) -> tuple[Array, Array, Array, Array]:
    """Covariance, right singular vectors, singular values and scale of the Jacobian.

    Through the eigenvalues of JᵀJ with unit columns: exact enough down to the 1e-7 below which a direction counts as
    not held at all, and twenty times cheaper than a decomposition of the tall Jacobian.
    """
    norm = jnp.linalg.norm(jacobian, axis=0)
    step = 1 / jnp.where(norm > 0, norm, 1.0)
    scaled = jacobian * step
    squares, vectors = jnp.linalg.eigh(scaled.T @ scaled)
    singular = jnp.sqrt(jnp.maximum(squares, 0.0))
    held = singular > 1e-7 * singular[-1]
    inverse = jnp.where(held, 1 / jnp.where(held, singular, 1.0), 0.0)
    spread = (vectors * inverse) * step[:, None]
    return spread @ spread.T, vectors.T, singular, jnp.where(norm > 0, step, jnp.inf)
