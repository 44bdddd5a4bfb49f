"""All readings of a case as one whitened residual, and its exact sensitivities to any directions in parameter space.

A program runs the model that is asked for: the base, the effects that are present, and those that move. An effect of
strength zero is exactly absent, so that leaving it out changes nothing but the time.
"""

from collections.abc import Iterable, Sequence
from functools import cached_property

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.concrete import strong
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.runtime import require_float64, usable_cores
from memsgyro_jax.base.threads import in_threads
from memsgyro_jax.base.transforms import from_vector, to_vector
from memsgyro_jax.effects import Effect, ForceEffect, SweepEffect, free_numbers
from memsgyro_jax.measurement.absent import Absent, of_first_order
from memsgyro_jax.measurement.first_order import Contribution, Inquiry, contributions
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.readings import Readings

from .instrument import Knowledge
from .linearised import WIDER, WIDTH, Calls, Linear, Part, lanes, nothing
from .parameters import MOBILITY, Parameter, all_free, parameters, untold
from .programs import SPARE, Programs, is_idle
from .rows_of_their_own import SideBySide, by_row


CARRIED = 3  # absent effects that are carried through a model: a fit goes on with them
NUDGE, LOOSE = 1e-9, 0.1  # of the base parameters; of a sensitivity, which then moves by so much of itself
CALLS = 2  # of each experiment that are kept: where a fit stands, and its last trial


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
        self.spec = all_free(model)
        self.parameters: tuple[Parameter, ...] = parameters(model)
        self.programs = Programs() if programs is None else programs
        self.programs.know(self._names)
        self.calls = Calls(CALLS * len(self.readings), [r.experiment for r in self.fitted])

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
        model = from_vector(jnp.asarray(vector), self.model, self.spec)
        if self.gain is None:
            return model
        return eqx.tree_at(lambda m: m.device.mobility, model, self.gain * model.device.stiffness[0])

    def base(self) -> np.ndarray:
        """Places of the base parameters in the vector that the readings can hold."""
        return np.array([i for i, p in enumerate(self.parameters) if p.effect is None and i not in self.idle])

    @cached_property
    def idle(self) -> frozenset[int]:
        """Places of what no reading that is fitted can tell, whatever it reads."""
        return untold(self.parameters, self.fitted)

    @cached_property
    def gain(self) -> float | None:
        """Displacement per force at rest where that stands in the place of a mass that nothing tells; else `None`."""
        device = self.model.device
        return float(device.mobility / device.stiffness[0]) if self.model.holds_gain and self.undriven else None

    @property
    def undriven(self) -> bool:
        """Whether no known force drives what is fitted, so that forces are those of a mass, or a gain, as declared."""
        return any(self.parameters[i].name == MOBILITY for i in self.idle)

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
        parts = self._parts(vector, np.zeros((0, vector.size)))

        def one(r: Readings) -> np.ndarray:
            if isinstance(r.experiment, Knowledge):
                return self._known(vector, np.zeros((0, vector.size)), r.experiment)[0]
            part = parts[r.experiment.swept]
            if r.whole is None:
                return self.calls.residual(part, vector, r.experiment)
            return np.where(r.weightless, 0.0, self.calls.residual(part, vector, r.whole))

        return self._each(chosen, one)

    def linearise(
        self, vector: np.ndarray, directions: np.ndarray, chosen: Sequence[Readings]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residual (r,) of the chosen readings and its derivative (r, k) along the rows of `directions` (k, p).

        Effects that are absent and move are carried through the model where they are few; many are told by the linear
        response of what is present to their forces, where an experiment says at which moments it asks for them.
        """
        owner = self.owner
        self.programs.effort.take(len(chosen) * max(1, -(-len(directions) // WIDTH)))
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
        part = self._part(vector, np.zeros((0, vector.size)), readings.experiment.swept)
        model = whole.with_only(whole.effects[i] for i in present)
        # All that could be asked for, forces that are present too, so that one program tells whichever is.
        told = [i for i, effect in enumerate(whole.effects) if i not in present or isinstance(effect, ForceEffect)]
        told = [i for i in told if of_first_order(model, whole.effects[i])]
        quick = [i for i in absent if i in told]
        if not quick or nothing(readings.experiment, part) is None:
            return self._carried(vector, directions, [readings])
        others = np.where(np.isin(self.owner, quick), 0.0, directions)
        rows = np.flatnonzero(np.any(others != 0, axis=1))
        along = (
            rows
            if rows.size <= part.width and self._acting(vector, others, readings.experiment.swept) <= set(part.effects)
            else rows[:0]
        )
        first = lanes(part.along(others[along]), part.width) if along.size else None
        here = self._linear(part, vector, readings, first, asked=True)
        places = tuple(int(sum(k < i for k in present)) for i in told)
        added = contributions(model, Absent(tuple(whole.effects[i] for i in told), places), here.inquiry)
        every, columns = (np.concatenate([self.of_effect(i) for i in some]) for some in (told, quick))
        wanted = np.flatnonzero(np.isin(every, columns))
        ways, back = directions[:, every[wanted]], np.eye(len(directions))
        added = jax.tree.map(lambda leaf: np.asarray(leaf)[wanted], added)
        if len(ways) < wanted.size:  # a response is linear in what is added: sums are sent where they are fewer
            added = jax.tree.map(lambda leaf: np.tensordot(ways, leaf, 1), added)
        else:
            back = ways
        slopes = self.calls.responses(part, vector, added, readings).T @ back.T
        if along.size:
            slopes[:, along] += here.slopes[: along.size].T
        elif rows.size:
            slopes[:, rows] += self._carried(vector, others[rows], [readings])[1]
        return here.value, slopes

    def rounding(self, vector: np.ndarray, directions: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Which of the sensitivities (r, k) of what is fitted, along the rows of `directions` (k, p), are rounding: a
        true one stays what it was where the base moves in its ninth digit.

        They are asked for in sums first, a program's `WIDTH` at a time, and one by one where a sum moved.
        """
        moved = vector.copy()
        moved[self.base()] *= 1.0 + NUDGE
        size = np.linalg.norm(slopes, axis=0)
        seen = np.flatnonzero(np.isfinite(size) & (size > 0))
        sums = np.zeros((min(WIDTH, seen.size), size.size))
        sums[np.arange(seen.size) % WIDTH, seen] = 1.0 / size[seen]

        def shifts(ways: np.ndarray) -> np.ndarray:
            again = self.linearise(moved, ways @ directions, self.fitted)[1]
            return np.linalg.norm(again - slopes[:, seen] @ ways[:, seen].T, axis=0)

        out = np.zeros(size.size, bool)
        loose = seen[np.any(sums[shifts(sums) > LOOSE][:, seen] > 0, axis=0)] if seen.size else seen
        if loose.size:
            out[loose] = shifts(np.eye(size.size)[loose] / size[loose, None]) > LOOSE
        return out

    def asked(self, vector: np.ndarray, readings: Readings) -> Inquiry | None:
        """All that a prediction asks of the model at a vector; `None` where nothing can be added on its way."""
        part = self._part(vector, np.zeros((0, vector.size)), readings.experiment.swept)
        if nothing(readings.experiment, part) is None:
            return None
        return self.calls.linear(part, vector, readings.experiment, asked=True).inquiry

    def responses(self, vector: np.ndarray, added: Contribution, readings: Readings) -> np.ndarray:
        """(k, r) what each of k contributions, side by side, adds to a residual."""
        part = self._part(vector, np.zeros((0, vector.size)), readings.experiment.swept)
        return self.calls.responses(part, vector, added, readings)

    def _carried(
        self, vector: np.ndarray, directions: np.ndarray, chosen: Sequence[Readings]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residual and its derivatives, all that moves carried through the model."""
        parts = self._parts(vector, directions)

        def along(part: Part, ways: np.ndarray, r: Readings) -> tuple[np.ndarray, np.ndarray]:
            begins = range(0, max(1, len(ways)), part.width)
            blocks = [lanes(ways[i : i + part.width], part.width) for i in begins]
            told = [self._linear(part, vector, r, block) for block in blocks]
            return told[0].value, np.concatenate([each.slopes for each in told])[: len(ways)]

        def one(r: Readings) -> tuple[np.ndarray, np.ndarray]:
            if isinstance(r.experiment, Knowledge):
                return self._known(vector, directions, r.experiment)
            part = parts[r.experiment.swept]
            ways = part.along(directions)
            if len(ways) <= part.width:
                return along(part, ways, r)
            together = SideBySide.of(part.model, r, np.any(ways != 0, axis=0))
            if -(-len(together.ways) // part.width) >= -(-len(ways) // part.width):
                return along(part, ways, r)
            value, slopes = along(part, together.ways, r)
            return (value, ways @ together.apart(slopes)) if np.all(np.isfinite(slopes)) else along(part, ways, r)

        values, slopes = zip(*self._each(chosen, one), strict=True)
        return np.concatenate(values), np.concatenate(slopes, axis=1).T

    def _linear(
        self, part: Part, vector: np.ndarray, readings: Readings, block: np.ndarray | None, *, asked: bool = False
    ) -> Linear:
        """Of some readings, through the calls of all that differ from them in what is left out."""
        if readings.whole is None:
            return self.calls.linear(part, vector, readings.experiment, block, asked=asked)
        return self.calls.linear(part, vector, readings.whole, block, asked=asked).without(readings.weightless)

    def _known(self, vector: np.ndarray, directions: np.ndarray, knowledge: Knowledge) -> tuple[np.ndarray, np.ndarray]:
        """The residual of what is known of a strength, and its derivatives: linear, so that no program is needed."""
        mine = [self.of_effect(i) for i, effect in enumerate(self.model.effects) if effect.label == knowledge.name]
        if not mine:
            return np.zeros(len(knowledge.measured)), np.zeros((len(directions), len(knowledge.measured)))
        std = np.ravel(knowledge.noise.std)
        return -vector[mine[0]] / std, -directions[:, mine[0]] / std

    def together(self, effects: Iterable[int], later: Iterable[tuple[str, Effect]] = (), spare: int = SPARE) -> None:
        """One program for all models of some of these effects, which are going to be asked for one after the other, the
        likeliest first, so many of them absent at once; and of effects `named` by another joint of the case, of which
        none makes the read-out nonlinear, as a rate table then takes twice as long.
        """
        plain = [(name, effect) for name, effect in later if self.model.with_only([effect]).is_read_linearly]
        self.programs.announce([*self.named(effects), *plain], spare)

    def named(self, effects: Iterable[int]) -> list[tuple[str, Effect]]:
        """Some effects with the names by which programs know them."""
        return [(self._names[i], self.model.effects[i]) for i in effects]

    def _parts(self, vector: np.ndarray, directions: np.ndarray) -> dict[bool, Part]:
        """The part for experiments whose frequency moves, and for all others."""
        whole = self._part(vector, directions)
        swept = any(isinstance(effect, SweepEffect) for effect in whole.model.effects)
        return {True: whole, False: self._part(vector, directions, False) if swept else whole}

    def _part(self, vector: np.ndarray, directions: np.ndarray, swept: bool = True) -> Part:
        """The model of the effects that are present at a vector or move along one of the directions (k, p), and of
        others that are absent where there is a program for all of them. What is linear stays so: it is quick.
        """
        names, programs = self._names, self.programs
        acting = frozenset(names[i] for i in self._acting(vector, directions, swept))

        def idle(name: str) -> bool:
            if name not in names and name not in programs.absent:  # announced for another model
                return False
            cheap = self._is_linear(name) or not all(map(self._is_linear, acting))
            return is_idle(self._named(name)) and cheap

        with programs.one_at_a_time:
            chosen = programs.chosen(acting, idle)
            order = programs.in_order(chosen, list(zip(names, self.model.effects, strict=True)))
        model = self.model.with_only(map(self._named, order))
        mine = tuple(names.index(name) if name in names else None for name in order)
        spec = all_free(model)
        rest = np.asarray(to_vector(model, spec))
        places = [np.flatnonzero(self.owner == -1)]
        for place, effect in zip(mine, model.effects, strict=True):
            lacking = np.full(sum(np.size(getattr(effect, number.field)) for number in free_numbers(effect)), -1)
            places.append(lacking if place is None else np.flatnonzero(self.owner == place))
        width = WIDER if any(map(by_row, model.effects)) else WIDTH
        own = tuple(i for i in mine if i is not None)
        return Part(own, model, spec, np.concatenate(places), rest, width, self.gain)

    def _named(self, name: str) -> Effect:
        """An effect of the model; of a program that is there, where the model lacks it."""
        return self.model.effects[self._names.index(name)] if name in self._names else self.programs.absent[name]

    def _is_linear(self, name: str) -> bool:
        """Whether an effect by itself leaves the model, and what is read of it, linear."""
        known = self.programs.linear
        if name not in known:
            alone = self.model.with_only([self._named(name)])
            known[name] = alone.is_linear and alone.is_read_linearly
        return known[name]

    @cached_property
    def _names(self) -> list[str]:
        """What the effects are called, one like another by its number too."""
        labels = [effect.label for effect in self.model.effects]
        return [f"{label} {labels[:k].count(label)}" for k, label in enumerate(labels)]

    def _acting(self, vector: np.ndarray, directions: np.ndarray, swept: bool = True) -> frozenset[int]:
        """Effects that are present or move; of a record at steady frequencies without those of a moving one."""
        strength = np.array([p.field == "strength" for p in self.parameters])
        acting = (strength & (vector != 0)) | np.any(directions != 0, axis=0)
        every, effects = np.unique(self.owner[acting]).tolist(), self.model.effects
        return frozenset(i for i in every if i >= 0 and (swept or not isinstance(effects[i], SweepEffect)))

    def _each(self, chosen: Sequence[Readings], function) -> list:
        """The function of each of the chosen, side by side on the cores."""
        with in_threads(min(usable_cores(), len(chosen))) as over:
            return list(over(function, chosen))
