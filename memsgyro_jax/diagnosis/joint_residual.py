"""All readings of a case as one whitened residual, and its exact sensitivities to any directions in parameter space.

A program runs the model that is asked for: the base, the effects that are present, and those that move. An effect of
strength zero is exactly absent, so that leaving it out changes nothing but the time.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from memsgyro_jax.base.concrete import strong
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.kept import kept
from memsgyro_jax.base.plainly import PLAINLY
from memsgyro_jax.base.runtime import require_float64, usable_cores
from memsgyro_jax.base.transforms import Free, Identity, fixed, from_vector, mark, to_vector
from memsgyro_jax.effects import free_numbers
from memsgyro_jax.measurement.experiments.base import Experiment
from memsgyro_jax.measurement.first_order import Absent, Contribution, Inquiry, contributions, of_first_order
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.readings import Readings


WIDTH = 12  # directions that one pass of the compiled program differentiates
CARRIED = 3  # absent effects that are carried through a model: a fit goes on with them
SHORT = 100  # rows up to which optimising a program takes longer than the calls of a whole diagnosis


def compiled(function: Callable[..., Any], most: float = SHORT) -> Callable[..., Any]:
    """A function whose last argument is an `Experiment` as a program; for up to so many rows without optimising it."""
    optimised, plain = kept(function), kept(function, PLAINLY)

    def call(*arguments: Any) -> Any:
        *others, experiment = arguments
        short = experiment.measured.shape[0] <= most and jax.default_backend() == "cpu"
        return (plain if short else optimised)(*others, strong(experiment))

    return call


@dataclass(frozen=True)
class Parameter:
    """One number of the model.

    Args:
        name, unit: for people, and in SI.
        effect: place of the effect it is a number of; `None` for the base.
        field: of the effect, `strength` or a number that it declares.
        index: `[k]` where that field has several entries.
        low, high: bounds that no fit leaves.
    """

    name: str
    unit: str
    effect: int | None = None
    field: str = ""
    index: str = ""
    low: float = -np.inf
    high: float = np.inf


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
        self.model = strong(model)
        self.readings = tuple(readings)
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
        """Places of the base parameters in the vector that the readings can hold."""
        return np.array([i for i, p in enumerate(self.parameters) if p.effect is None and i not in self.idle])

    @cached_property
    def idle(self) -> frozenset[int]:
        """Place of 1/m where no fitted record is driven by a known force: forces then scale with the declared mass."""
        driven = any(r.experiment.driven for r in self.fitted)
        return frozenset(i for i, p in enumerate(self.parameters) if p.name == "1/m" and not driven)

    def of_effect(self, effect: int) -> np.ndarray:
        """Places of the strength of one effect."""
        return np.array([i for i, p in enumerate(self.parameters) if p.effect == effect and p.field == "strength"])

    def numbers_of(self, effect: int) -> np.ndarray:
        """Places of the further numbers of one effect; at strength zero nothing depends on them."""
        places = [i for i, p in enumerate(self.parameters) if p.effect == effect and p.field != "strength"]
        return np.array(places, dtype=int)

    @cached_property
    def numbers(self) -> np.ndarray:
        """Places of all numbers of effects beside their strengths."""
        return np.concatenate([np.zeros(0, int), *(self.numbers_of(i) for i in range(len(self.model.effects)))])

    @cached_property
    def owner(self) -> np.ndarray:
        """The effect that each parameter belongs to; −1 for the base."""
        return np.array([-1 if p.effect is None else p.effect for p in self.parameters])

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest value of each parameter."""
        return np.array([p.low for p in self.parameters]), np.array([p.high for p in self.parameters])

    def residual(self, vector: np.ndarray, chosen: Sequence[Readings]) -> list[np.ndarray]:
        """Whitened residual of each of the chosen readings."""
        fitted = {_shape(r.experiment) for r in self.fitted}
        part = self._part(vector, np.zeros((0, vector.size)))
        at = vector[part.places]

        def one(r: Readings) -> np.ndarray:
            if _shape(r.experiment) in fitted:  # a program exists; to compile one without slopes takes longer
                none = np.zeros((WIDTH, at.size)), _no_lanes(r.experiment, part.model)
                return np.asarray(_linearise(at, *none, part.model, part.spec, r.experiment)[0])
            return np.asarray(_residual(at, part.model, part.spec, r.experiment))

        return self._each(chosen, one)

    def linearise(
        self, vector: np.ndarray, directions: np.ndarray, chosen: Sequence[Readings]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residual (r,) of the chosen readings and its derivative (r, k) along the rows of `directions` (k, p).

        Effects that are absent and move are carried through the model where they are few; many are told by the linear
        response of what is present to their forces, where an experiment says at which moments it asks for them.
        """
        owner = self.owner
        moved = [i for i in np.unique(owner[np.any(directions != 0, axis=0)]) if i >= 0]
        absent = [i for i in moved if not np.any(vector[self.of_effect(i)])]
        if len(absent) <= CARRIED:
            return self._carried(vector, directions, chosen)
        values, slopes = [], []
        for value, slope in self._each(chosen, lambda r: self._beside(vector, directions, absent, r)):
            values.append(value)
            slopes.append(slope)
        return np.concatenate(values), np.concatenate(slopes)

    def _beside(
        self, vector: np.ndarray, directions: np.ndarray, absent: Sequence[int], readings: Readings
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residual and derivatives of one of the readings, those by absent effects as responses where it tells them."""
        part, whole = self._part(vector, np.zeros((0, vector.size))), self.at(vector)
        at, model = vector[part.places], whole.with_only(whole.effects[i] for i in part.effects)
        quick = [i for i in absent if of_first_order(model, whole.effects[i])]
        none = _no_lanes(readings.experiment, model)
        if none is None or not quick:
            return self._carried(vector, directions, [readings])
        others = np.where(np.isin(self.owner, quick), 0.0, directions)
        rows = np.flatnonzero(np.any(others != 0, axis=1))
        along = rows if rows.size <= WIDTH and self._part(vector, others).effects == part.effects else rows[:0]
        still, first = np.zeros((WIDTH, at.size)), _lanes(others[along][:, part.places], 0)
        value, known, inquiry = _linearise(at, first, none, part.model, part.spec, readings.experiment)
        places = tuple(int(sum(k < i for k in part.effects)) for i in quick)
        added = contributions(model, Absent(tuple(whole.effects[i] for i in quick), places), inquiry)
        columns, responses = np.concatenate([self.of_effect(i) for i in quick]), []
        for begin in range(0, columns.size, WIDTH):
            lanes = jax.tree.map(lambda leaf: _lanes(leaf, begin), added)  # noqa: B023
            responses.append(_linearise(at, still, lanes, part.model, part.spec, readings.experiment)[1])
        slopes = np.concatenate(responses)[: columns.size].T @ directions[:, columns].T
        if along.size:
            slopes[:, along] += np.asarray(known)[: along.size].T
        elif rows.size:
            slopes[:, rows] += self._carried(vector, others[rows], [readings])[1]
        return np.asarray(value), slopes

    def _carried(
        self, vector: np.ndarray, directions: np.ndarray, chosen: Sequence[Readings]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residual and its derivatives, all that moves carried through the model."""
        count, part = directions.shape[0], self._part(vector, directions)
        padded = np.zeros((max(1, -(-count // WIDTH)) * WIDTH, part.places.size))
        padded[:count] = directions[:, part.places]
        at = vector[part.places]

        def one(r: Readings) -> tuple[np.ndarray, np.ndarray]:
            parts, none = [], _no_lanes(r.experiment, part.model)
            for begin in range(0, len(padded), WIDTH):
                block = padded[begin : begin + WIDTH]
                value, slope, _ = _linearise(at, block, none, part.model, part.spec, r.experiment)
                parts.append(np.asarray(slope))
            return np.asarray(value), np.concatenate(parts)[:count]

        values, slopes = zip(*self._each(chosen, one), strict=True)
        return np.concatenate(values), np.concatenate(slopes, axis=1).T

    def _part(self, vector: np.ndarray, directions: np.ndarray) -> "_Part":
        """The model of the effects that are present at a vector or move along one of the directions (k, p)."""
        owner, strength = self.owner, np.array([p.field == "strength" for p in self.parameters])
        acting = (strength & (vector != 0)) | np.any(directions != 0, axis=0)
        chosen = tuple(i for i in range(len(self.model.effects)) if np.any(acting[owner == i]))
        model = self.model.with_only(self.model.effects[i] for i in chosen)
        return _Part(chosen, model, _all_free(model), np.flatnonzero(np.isin(owner, (-1, *chosen))))

    def _each(self, chosen: Sequence[Readings], function) -> list:
        """The function of each of the chosen, side by side on the cores."""
        with ThreadPoolExecutor(max(1, min(usable_cores(), len(chosen)))) as pool:
            return list(pool.map(function, chosen))


class _Part(NamedTuple):
    """A model with some of the effects, what is free in it, and where its parameters stand among those of all."""

    effects: tuple[int, ...]
    model: Model
    spec: PyTree
    places: np.ndarray


def _shape(experiment: Experiment) -> tuple:
    """What decides which compiled program an experiment runs through."""
    leaves, structure = jax.tree.flatten(experiment)
    return structure, *(jnp.shape(leaf) for leaf in leaves)


def _predicted(vector: Array, model: Model, spec: PyTree, experiment: Experiment) -> Float[Array, " r"]:
    return experiment.residual(from_vector(vector, model, spec))


_residual = compiled(_predicted, np.inf)  # runs once or twice


@compiled
def _linearise(
    vector: Array, directions: Array, added: Contribution | None, model: Model, spec: PyTree, experiment: Experiment
) -> tuple[Array, Array, Inquiry | None]:
    """Residual, its slope along each of the directions and of what is added beside it, and what was asked."""

    def along(step: Array, more: Contribution | None) -> tuple[Array, Inquiry | None]:
        bench = from_vector(vector + step, model, spec)
        return (experiment.residual(bench), None) if more is None else experiment.residual_beside(bench, more)

    start = jnp.zeros_like(vector), jax.tree.map(lambda leaf: jnp.zeros_like(leaf[0]), added)
    # Forward mode with one primal and all directions side by side: nothing of the trajectory is stored.
    return jax.vmap(lambda *lane: jax.jvp(along, start, lane, has_aux=True), out_axes=(None, 0, None))(
        directions, added
    )


def _no_lanes(experiment: Experiment, model: Model) -> Contribution | None:
    """Nothing added, `WIDTH` times."""
    return jax.tree.map(lambda leaf: np.zeros((WIDTH, *leaf.shape), leaf.dtype), experiment.nothing(model))


def _lanes(leaf: np.ndarray, begin: int) -> np.ndarray:
    """`WIDTH` entries of the leading axis, zeros where there are no more."""
    some = np.asarray(leaf)[begin : begin + WIDTH]
    return np.concatenate([some, np.zeros((WIDTH - len(some), *some.shape[1:]), some.dtype)])


def _all_free(model: Model) -> PyTree:
    """Device, offsets, every strength and every declared number are free."""
    spec = fixed(model)
    identity = Free(Identity())
    spec = mark(spec, lambda m: (m.device.stiffness, m.device.damping, m.device.mobility, m.offset), identity)
    if not model.effects:
        return spec
    places = [(i, number.field) for i, effect in enumerate(model.effects) for number in free_numbers(effect)]
    return mark(spec, lambda m: tuple(getattr(m.effects[i], field) for i, field in places), identity)


def parameters(model: Model) -> tuple[Parameter, ...]:
    """The parameters in the order of the vector."""
    pairs = ("",) if model.axes == 1 else ("xx", "yy", "xy")
    low = [-np.inf if pair == "xy" else 0.0 for pair in pairs]  # nothing but a coupling is negative
    base = [Parameter(f"k{pair}/m", "rad²/s²", low=least) for pair, least in zip(pairs, low, strict=True)]
    base += [Parameter(f"d{pair}/m", "1/s", low=least) for pair, least in zip(pairs, low, strict=True)]
    base += [Parameter("1/m", "1/kg", low=-np.inf if model.axes == 1 else 0.0)]  # a channel may be turned round
    base += [Parameter(f"offset {a}".strip(), "V") for a in ("x", "y")[: model.axes]]
    others = []
    for place, effect in enumerate(model.effects):
        for number in free_numbers(effect):
            size = getattr(effect, number.field).size
            label = effect.label if number.field == "strength" else f"{effect.label} {number.field}"
            for index in [""] if size == 1 else [f"[{k}]" for k in range(size)]:
                more = place, number.field, index, number.low, number.high
                others.append(Parameter(label + index, number.unit, *more))
    return (*base, *others)
