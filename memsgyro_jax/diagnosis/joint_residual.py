"""All readings of a case as one whitened residual, and its exact sensitivities to any directions in parameter space.

A program runs the model that is asked for: the base, the effects that are present, and those that move. An effect of
strength zero is exactly absent, so that leaving it out changes nothing but the time.
"""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
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

from .instrument import Knowledge
from .parameters import Parameter, parameters
from .programs import Programs, is_idle, of_lock_in


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


class Joint:
    """The residual of a set of readings as a function of the parameter vector of a model.

    Args:
        model: base values, and every effect that may take part, at the strengths to start from.
        readings: from `readings_of`.
        programs: those that another one of the same case has.
    """

    def __init__(self, model: Model, readings: Sequence[Readings], programs: "Programs | None" = None):
        require_float64("Comparing a model with measurements")
        if not any(r.fitted for r in readings):
            raise InputError(
                'A case must have a record that may be fitted, but all have the role "validation"; leave the role of '
                "one out."
            )
        self.model = strong(model)
        self.readings = tuple(readings)
        self.spec = _all_free(model)
        self.parameters: tuple[Parameter, ...] = parameters(model)
        self.programs = Programs() if programs is None else programs

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
            if isinstance(r.experiment, Knowledge):
                return self._known(vector, np.zeros((0, vector.size)), r.experiment)[0]
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
        whole, present = self.at(vector), sorted(self._acting(vector, np.zeros((0, vector.size))))
        part = self._part(vector, np.zeros((0, vector.size)))
        at, model = vector[part.places], whole.with_only(whole.effects[i] for i in present)
        # All that could be asked for, so that one program tells whichever is.
        lacking = [i for i in range(len(whole.effects)) if i not in present and of_first_order(model, whole.effects[i])]
        quick = [i for i in absent if i in lacking]
        none = _no_lanes(readings.experiment, part.model)
        if none is None or not quick:
            return self._carried(vector, directions, [readings])
        others = np.where(np.isin(self.owner, quick), 0.0, directions)
        rows = np.flatnonzero(np.any(others != 0, axis=1))
        along = rows if rows.size <= WIDTH and self._acting(vector, others) <= set(part.effects) else rows[:0]
        first = _lanes(others[along][:, part.places], 0)
        value, known, inquiry = _linearise(at, first, none, part.model, part.spec, readings.experiment)
        places = tuple(int(sum(k < i for k in present)) for i in lacking)
        added = contributions(model, Absent(tuple(whole.effects[i] for i in lacking), places), inquiry)
        every, columns = (np.concatenate([self.of_effect(i) for i in some]) for some in (lacking, quick))
        wanted = np.flatnonzero(np.isin(every, columns))
        added = jax.tree.map(lambda leaf: np.asarray(leaf)[wanted], added)
        responses = self._responses(part, at, added, readings.experiment)
        slopes = responses[: columns.size].T @ directions[:, every[wanted]].T
        if along.size:
            slopes[:, along] += np.asarray(known)[: along.size].T
        elif rows.size:
            slopes[:, rows] += self._carried(vector, others[rows], [readings])[1]
        return np.asarray(value), slopes

    def asked(self, vector: np.ndarray, readings: Readings) -> Inquiry | None:
        """All that a prediction asks of the model at a vector; `None` where nothing can be added on its way."""
        part = self._part(vector, np.zeros((0, vector.size)))
        none, at = _no_lanes(readings.experiment, part.model), vector[part.places]
        if none is None:
            return None
        return _linearise(at, np.zeros((WIDTH, at.size)), none, part.model, part.spec, readings.experiment)[2]

    def responses(self, vector: np.ndarray, added: Contribution, readings: Readings) -> np.ndarray:
        """(k or more, r) what each of k contributions, side by side, adds to a residual."""
        part = self._part(vector, np.zeros((0, vector.size)))
        return self._responses(part, vector[part.places], added, readings.experiment)

    def _responses(self, part: "_Part", at: np.ndarray, added: Contribution, experiment: Experiment) -> np.ndarray:
        found, still = [], np.zeros((WIDTH, at.size))
        for begin in range(0, len(added.seen), WIDTH):
            lanes = jax.tree.map(lambda leaf: _lanes(leaf, begin), added)  # noqa: B023
            found.append(np.asarray(_linearise(at, still, lanes, part.model, part.spec, experiment)[1]))
        return np.concatenate(found)

    def _carried(
        self, vector: np.ndarray, directions: np.ndarray, chosen: Sequence[Readings]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residual and its derivatives, all that moves carried through the model."""
        count, part = directions.shape[0], self._part(vector, directions)
        padded = np.zeros((max(1, -(-count // WIDTH)) * WIDTH, part.places.size))
        padded[:count] = directions[:, part.places]
        at = vector[part.places]

        def one(r: Readings) -> tuple[np.ndarray, np.ndarray]:
            if isinstance(r.experiment, Knowledge):
                return self._known(vector, directions, r.experiment)
            parts, none = [], _no_lanes(r.experiment, part.model)
            for begin in range(0, len(padded), WIDTH):
                block = padded[begin : begin + WIDTH]
                value, slope, _ = _linearise(at, block, none, part.model, part.spec, r.experiment)
                parts.append(np.asarray(slope))
            return np.asarray(value), np.concatenate(parts)[:count]

        values, slopes = zip(*self._each(chosen, one), strict=True)
        return np.concatenate(values), np.concatenate(slopes, axis=1).T

    def _known(self, vector: np.ndarray, directions: np.ndarray, knowledge: Knowledge) -> tuple[np.ndarray, np.ndarray]:
        """The residual of what is known of a strength, and its derivatives: linear, so that no program is needed."""
        mine = [self.of_effect(i) for i, effect in enumerate(self.model.effects) if effect.label == knowledge.name]
        if not mine:
            return np.zeros(len(knowledge.measured)), np.zeros((len(directions), len(knowledge.measured)))
        std = np.asarray(knowledge.noise.std)
        return -vector[mine[0]] / std, -directions[:, mine[0]] / std

    def together(self, effects: Iterable[int]) -> None:
        """One program for all models of some of these effects, which are going to be asked for one after the other."""
        self.programs.announced = frozenset(self._names[i] for i in effects)

    def _part(self, vector: np.ndarray, directions: np.ndarray) -> "_Part":
        """The model of the effects that are present at a vector or move along one of the directions (k, p), and of
        others that are absent where there is a program for all of them.
        """
        effects, names = self.model.effects, self._names
        idle = {name for name, effect in zip(names, effects, strict=True) if is_idle(effect)}
        chosen = self.programs.chosen(frozenset(names[i] for i in self._acting(vector, directions)), idle)
        # What the lock-in does comes last, in whichever order effects and terms were found.
        mine = sorted((i for i, name in enumerate(names) if name in chosen), key=lambda i: (of_lock_in(effects[i]), i))
        model = self.model.with_only(effects[i] for i in mine)
        return _Part(tuple(mine), model, _all_free(model), self._places(mine))

    @cached_property
    def _names(self) -> list[str]:
        """What the effects are called, one like another by its number too."""
        labels = [effect.label for effect in self.model.effects]
        return [f"{label} {labels[:k].count(label)}" for k, label in enumerate(labels)]

    def _places(self, effects: Sequence[int]) -> np.ndarray:
        """Places of the parameters of the base and of some effects, one after the other, in the vector."""
        return np.concatenate([np.flatnonzero(self.owner == i) for i in (-1, *effects)])

    def _acting(self, vector: np.ndarray, directions: np.ndarray) -> frozenset[int]:
        """Effects that are present or move."""
        strength = np.array([p.field == "strength" for p in self.parameters])
        acting = (strength & (vector != 0)) | np.any(directions != 0, axis=0)
        return frozenset(int(i) for i in np.unique(self.owner[acting]) if i >= 0)

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
