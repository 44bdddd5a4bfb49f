"""All readings of a case as one whitened residual, and its exact sensitivities to any directions in parameter space.

One program per kind of record is compiled for the model with *all* effects in question; which parameters move is then
a matter of numbers: fits of any subset, scores of every candidate and refits all reuse it.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.runtime import require_float64, usable_cores
from memsgyro_jax.base.transforms import Free, Identity, fixed, from_vector, mark, to_vector
from memsgyro_jax.measurement.experiments.base import Experiment
from memsgyro_jax.measurement.least_squares import Information, least_squares
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.readings import Readings


WIDTH = 12  # directions that one pass of the compiled program differentiates


@dataclass(frozen=True)
class Parameter:
    """One number of the model: its name for people, SI unit, and the effect it is a strength of (`None`: base)."""

    name: str
    unit: str
    effect: int | None = None


class Joint:
    """The residual of a set of readings as a function of the parameter vector of a model.

    Args:
        model: base values, and every effect that may take part, at the strengths to start from.
        readings: from `readings_of`.
    """

    def __init__(self, model: Model, readings: Sequence[Readings]):
        require_float64("Comparing a model with measurements")
        if not any(r.fitted for r in readings):
            raise InputError(
                'A case must have a record that may be fitted, but all have the role "validation"; leave the role of '
                "one out."
            )
        self.model, self.readings = model, tuple(readings)
        self.spec = _all_free(model)
        self.parameters = parameters(model)

    @cached_property
    def start(self) -> np.ndarray:
        """The parameter vector of the model."""
        return np.asarray(to_vector(self.model, self.spec))

    @cached_property
    def fitted(self) -> tuple[Readings, ...]:
        """The readings that are fitted, in their order."""
        return tuple(r for r in self.readings if r.fitted)

    def at(self, vector: np.ndarray) -> Model:
        """The model with the parameters of a vector."""
        return from_vector(jnp.asarray(vector), self.model, self.spec)

    def base(self) -> np.ndarray:
        """Places of the base parameters in the vector."""
        return np.array([i for i, p in enumerate(self.parameters) if p.effect is None])

    def of_effect(self, effect: int) -> np.ndarray:
        """Places of the strength of one effect."""
        return np.array([i for i, p in enumerate(self.parameters) if p.effect == effect])

    def residual(self, vector: np.ndarray, chosen: Sequence[Readings]) -> list[np.ndarray]:
        """Whitened residual of each of the chosen readings."""
        fitted = {_shape(r.experiment) for r in self.fitted}

        def one(r: Readings) -> np.ndarray:
            at = jnp.asarray(vector)
            if _shape(r.experiment) in fitted:  # a program exists; to compile one without slopes takes longer
                return np.asarray(_linearise(at, jnp.zeros((WIDTH, at.size)), self.model, self.spec, r.experiment)[0])
            return np.asarray(_residual(at, self.model, self.spec, r.experiment))

        return self._each(chosen, one)

    def linearise(
        self, vector: np.ndarray, directions: np.ndarray, chosen: Sequence[Readings]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residual (r,) of the chosen readings and its derivative (r, k) along the rows of `directions` (k, p)."""
        count = directions.shape[0]
        padded = np.zeros((max(1, -(-count // WIDTH)) * WIDTH, directions.shape[1]))
        padded[:count] = directions

        def one(r: Readings) -> tuple[np.ndarray, np.ndarray]:
            parts = []
            for begin in range(0, len(padded), WIDTH):
                block = jnp.asarray(padded[begin : begin + WIDTH])
                value, slope = _linearise(jnp.asarray(vector), block, self.model, self.spec, r.experiment)
                parts.append(np.asarray(slope))
            return np.asarray(value), np.concatenate(parts)[:count]

        values, slopes = zip(*self._each(chosen, one), strict=True)
        return np.concatenate(values), np.concatenate(slopes, axis=1).T

    def _each(self, chosen: Sequence[Readings], function) -> list:
        """The function of each of the chosen, side by side on the cores."""
        with ThreadPoolExecutor(max(1, min(usable_cores(), len(chosen)))) as pool:
            return list(pool.map(function, chosen))


def _shape(experiment: Experiment) -> tuple:
    """What decides which compiled program an experiment runs through."""
    leaves, structure = jax.tree.flatten(experiment)
    return structure, *(jnp.shape(leaf) for leaf in leaves)


@eqx.filter_jit
def _residual(vector: Array, model: Model, spec: PyTree, experiment: Experiment) -> Float[Array, " r"]:
    return experiment.residual(from_vector(vector, model, spec))


@eqx.filter_jit
def _linearise(vector: Array, directions: Array, model: Model, spec: PyTree, experiment: Experiment):
    def along(step: Array) -> Array:
        return experiment.residual(from_vector(vector + step @ directions, model, spec))

    none = jnp.zeros(directions.shape[0])
    # Forward mode with one primal and all directions side by side: nothing of the trajectory is stored.
    return jax.vmap(lambda e: jax.jvp(along, (none,), (e,)), out_axes=(None, 0))(jnp.eye(directions.shape[0]))


def _all_free(model: Model) -> PyTree:
    """Device, offsets and every strength are free."""
    spec = fixed(model)
    identity = Free(Identity())
    spec = mark(spec, lambda m: (m.device.stiffness, m.device.damping, m.device.mobility, m.offset), identity)
    if not model.effects:
        return spec
    return mark(spec, lambda m: tuple(effect.strength for effect in m.effects), identity)


def parameters(model: Model) -> tuple[Parameter, ...]:
    """The parameters in the order of the vector."""
    pairs = ("",) if model.axes == 1 else ("xx", "yy", "xy")
    base = [Parameter(f"k{p}/m", "rad²/s²") for p in pairs] + [Parameter(f"d{p}/m", "1/s") for p in pairs]
    base += [Parameter("1/m", "1/kg")] + [Parameter(f"offset {a}".strip(), "V") for a in ("x", "y")[: model.axes]]
    strengths = []
    for place, effect in enumerate(model.effects):
        size = effect.strength.size
        labels = [effect.label] if size == 1 else [f"{effect.label}[{k}]" for k in range(size)]
        strengths += [Parameter(label, effect.unit, place) for label in labels]
    return (*base, *strengths)


@dataclass(frozen=True)
class Optimum:
    """Where a fit ended.

    Args:
        vector: all parameters.
        free: places of those that moved.
        residual: whitened, of the fitted readings (r,).
        jacobian: of the residual by the free parameters (r, k).
        frozen: null directions that were held, each a combination (k,) of the free parameters over their scales.
        converged: whether the optimiser met its tolerance.
        evaluations: of residual and Jacobian.
    """

    vector: np.ndarray
    free: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    frozen: np.ndarray
    converged: bool
    evaluations: int

    @property
    def chi2(self) -> float:
        """Sum of squared whitened residuals."""
        return float(self.residual @ self.residual)

    @cached_property
    def information(self) -> Information:
        """What the fitted readings hold of the free parameters."""
        return Information.of(self.jacobian)

    @property
    def covariance(self) -> np.ndarray:
        """Of the free parameters (k, k); infinite along parameters with a part in a null direction."""
        return np.asarray(self.information.covariance)

    @property
    def std(self) -> np.ndarray:
        """Standard deviation of each free parameter; infinite where the data do not hold it."""
        return np.asarray(self.information.std)


GAUSS_NEWTON = 1e-12  # damping to begin with: none, in units of a standard deviation
STATIONARY = 0.02  # standard deviations by which the residual may miss the optimum


def optimise(
    joint: Joint,
    vector: np.ndarray,
    places: np.ndarray,
    chosen: Sequence[Readings],
    *,
    known: tuple[np.ndarray, np.ndarray] | None = None,
    max_evaluations: int = 30,
) -> Optimum:
    """Move the parameters at `places` to the maximum of the likelihood of the chosen readings.

    Directions that the data do not hold are frozen where they are, for a drifting nuisance destroys every later test.

    Args:
        joint: residual and sensitivities.
        vector: all parameters at the start.
        places: of those that move.
        chosen: the readings.
        known: residual and Jacobian by those parameters at the start, where they are known already.
        max_evaluations: bound on evaluations; 0 only evaluates.
    """
    units = np.eye(vector.size)[places]
    value, slope = joint.linearise(vector, units, chosen) if known is None else known
    begin = Information.of(slope)
    size, held = np.where(begin.size > 0, begin.size, 1.0), begin.held
    frozen = begin.directions[~held]
    if max_evaluations == 0:
        return Optimum(vector, places, value, slope, frozen, True, 1)
    ways = np.where(begin.size > 0, begin.directions[held], 0.0)  # rounding must not move what no record sees

    def linearise(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        new, along = joint.linearise(vector + (place @ ways / size) @ units, ways / size @ units, chosen)
        return np.where(np.abs(new) < 1e100, new, 1e6), np.where(np.isfinite(along), along, 0.0)

    end = least_squares(
        linearise,
        (value, slope @ (ways / size).T),
        damping=GAUSS_NEWTON,
        tolerance=STATIONARY,
        evaluations=max_evaluations,
    )
    at = vector + (end.place @ ways / size) @ units
    done = bool(end.settled(STATIONARY))
    return Optimum(at, places, end.residual, end.slope @ ways * size, frozen, done, int(end.evaluations))
