"""The instrument before physics: nuisance terms that a case can hold, and what is known of them before it is recorded.

A term is an effect whose strength has one entry per record or sweep; fit, scores and refits treat it like any other.
What is known beforehand of a strength enters as readings of it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.effects import BY_RECORD, TERMS, THROUGHOUT, Effect, InstrumentTerm
from memsgyro_jax.effects.instrument import (
    DampingDrift,
    DriveLevel,
    FrequencyDrift,
    FrequencyOffset,
    GainDrift,
    RecordGain,
    RecordTemperature,
)
from memsgyro_jax.effects.lock_in_terms import (
    CapacitiveFeedthrough,
    InterferingLine,
    LateReadings,
    LockInBackground,
    LockInFeedthrough,
    LockInMemory,
    LockInTime,
    PhaseDrift,
    ReferencePhase,
    UnsettledRows,
)
from memsgyro_jax.measurement.case import AbstractRecord, Case
from memsgyro_jax.measurement.declared import QUANTITIES
from memsgyro_jax.measurement.drive_levels import levels_apart
from memsgyro_jax.measurement.experiments import Readings
from memsgyro_jax.measurement.experiments.base import Experiment, RealNoise
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.one_place import set_points


UNDECLARED = 1.0  # K to which set points are known of which a case says nothing, where somebody asks


class Knowledge(Experiment):
    """What is known of a strength beforehand, as readings of zero.

    Args:
        name: the label of the effect.
        measured: zeros (k, 1).
        noise: with the standard deviation of each number.
    """

    driven: ClassVar[bool] = False
    reads_constants: ClassVar[bool] = False

    name: str = eqx.field(static=True)
    measured: Float[Array, "k 1"]
    noise: RealNoise

    def predict(self, bench: Model) -> Float[Array, "k 1"]:
        """The strength; zero where the model lacks the effect."""
        mine = [effect.strength for effect in bench.effects if effect.label == self.name]
        return mine[0][:, None] if mine else jnp.zeros_like(self.measured)


def knowledge(terms: Sequence[InstrumentTerm]) -> tuple[Readings, ...]:
    """The readings that stand for what is known of the terms beforehand; they belong to no record."""
    return tuple(_prior(term.label, std) for term in terms if (std := term.known_to) is not None)


def _prior(label: str, std: np.ndarray) -> Readings:
    nobody = np.full(std.size, -1)
    return Readings(Knowledge(label, jnp.zeros((std.size, 1)), RealNoise(std[:, None])), nobody, nobody, True)


def instrument_terms(case: Case) -> tuple[InstrumentTerm, ...]:
    """The terms that the records of a case can hold and a search tries, each at zero; those of which they have but one
    group have none.
    """
    groups = _Groups.of(case)
    phasor, clocked = groups.phasor, groups.clocked
    turned = groups.turned
    every, several = _together(turned), turned if len(turned) > 1 else []
    found = [
        (UnsettledRows, groups.hasty, {}),
        (LockInTime, groups.unsettled, {}),
        (LockInMemory, _together(groups.swept), {}),
        (LockInMemory, groups.swept if len(groups.swept) > 1 else [], {"of": BY_RECORD}),
        (ReferencePhase, every, {}),
        (ReferencePhase, several, {"of": BY_RECORD}),
        (DriveLevel, groups.levels[1:], {}),
        (RecordGain, groups.records[1:], {}),
        (FrequencyOffset, groups.sweeps[1:], {}),
        (FrequencyDrift, groups.one_clock, groups.whole | {"of": THROUGHOUT}),
        *((kind, clocked, groups.clock) for kind in (FrequencyDrift, DampingDrift, GainDrift, PhaseDrift)),
    ]
    terms = [kind(np.zeros(len(g)), groups.table(g), **more) for kind, g, more in found if g]
    if phasor:
        both = np.zeros(2 * case.channels)
        terms += [LockInBackground(both), LockInFeedthrough(both)]
    terms += _interference(case, groups)
    return tuple(sorted(terms, key=lambda term: TERMS.index(type(term))))


def _interference(case: Case, groups: "_Groups") -> list[InterferingLine]:
    """The lines that stand in records over time, each with its own numbers; none where there is no line."""
    told = [
        (number, line.omega, 0.5 * (time[0] + time[-1]))
        for number, record in enumerate(case.records)
        if (time := _time(record)) is not None
        for line in record.interference(case)
        for _ in range(2 * case.channels)
    ]
    if not told:
        return []
    numbers, omega, middle = (np.array(part) for part in zip(*told, strict=True))
    table = groups.table([{(int(number), 0)} for number in numbers])
    return [InterferingLine(np.zeros(len(told)), table, omega, middle)]


def every_term(case: Case) -> tuple[InstrumentTerm, ...]:
    """The same, and the one that a search puts in the place of another alone."""
    tried = instrument_terms(case)
    twin = [CapacitiveFeedthrough(t.strength) for t in tried if isinstance(t, LockInFeedthrough)]
    warm = undeclared_temperature(case)
    return (*tried, *twin, *_late(case), *declared_terms(case), *([] if warm is None else [warm]))


def _late(case: Case) -> list[LateReadings]:
    """What comes late as a whole, of sweeps that show phasors."""
    groups = _Groups.of(case)
    swept = [r.frequencies for r in case.records if hasattr(r, "setting") and np.iscomplexobj(r.readings)]
    if not (swept and groups.swept):
        return []
    together = _together(groups.swept)
    return [LateReadings(np.zeros(1), groups.table(together), np.median(np.concatenate(swept)))]


def declared_terms(case: Case) -> tuple[InstrumentTerm, ...]:
    """What the case declares to be known only so far, which is free in every fit: how warm its records were."""
    spread = {number: record.temperature_std for number, record in enumerate(case.records) if record.temperature_std}
    return (record_temperature(case, spread),) if spread else ()


def undeclared_temperature(case: Case) -> RecordTemperature | None:
    """The same of a case that says nothing of it; `None` where it does, or would have but one number."""
    if declared_terms(case):
        return None
    term = record_temperature(case, dict.fromkeys(range(len(case.records)), UNDECLARED))
    return term if term.strength.size > 1 else None


def record_temperature(case: Case, spread: Mapping[int, float]) -> RecordTemperature:
    """Of some records, a number for each of their set points, at zero.

    No two records share one: whether an oven was set anew between them no file says, and one number for two visits
    would leave what they differ by as a misfit.

    Args:
        case: of the records.
        spread: by the number of a record, the standard deviation of its temperatures [K].
    """
    groups: dict[tuple[int, int], set[Place]] = {}
    for number in spread:
        for sweep, point in enumerate(set_points(_warmth(case, number))):
            groups.setdefault((number, int(point)), set()).add((number, sweep))
    table = _Groups.of(case).table(list(groups.values()))
    return RecordTemperature(np.zeros(len(groups)), table, np.array([spread[number] for number, _ in groups]))


def temperatures_of(case: Case, term: RecordTemperature) -> np.ndarray:
    """(k,) the temperature [K] that the records have where each number of a term of theirs holds."""
    table, every = np.asarray(term.entry), [_warmth(case, number) for number in range(len(case.records))]
    total = sum(warm @ table[number, : warm.size] for number, warm in enumerate(every))
    return total / table.sum(axis=(0, 1))


def _warmth(case: Case, number: int) -> np.ndarray:
    """The mean temperature [K] of each single sweep of a record."""
    record = case.records[number]
    told = getattr(record, "temperature", None)  # of a record that does not tell it, that of the case
    warm = np.broadcast_to(case.environment.temperature if told is None else told, record.rows)
    return np.array([np.mean(warm[piece]) for piece in getattr(record, "sweeps", (slice(None),))])


def with_declared(case: Case, model: Model) -> Model:
    """The model with those terms of the case that it lacks."""
    held = {effect.label for effect in model.effects}
    return model.with_effect(*(term for term in declared_terms(case) if term.label not in held))


def beside_case_of(case: Case, model: Model) -> Model:
    """The model, each of whose terms of the instrument says which rows of the case take which of its numbers.

    **Raises:** `InputError` where the case cannot hold such a term, has other groups of rows for it, or reads another
    quantity.
    """
    if model.order != case.readout.order:
        theirs, ours = (QUANTITIES[order] for order in (model.order, case.readout.order))
        raise InputError(
            f"Model: its read-out shows {theirs}, that of the case {case.name} {ours}; they must show the same."
        )
    offered = {term.label: term for term in every_term(case)}

    def placed(effect: Effect) -> Effect:
        if not isinstance(effect, TERMS):
            return effect
        mine = offered.get(effect.label)
        if mine is None or mine.strength.shape != effect.strength.shape:
            has = "has no rows for it" if mine is None else f"has {mine.strength.size}"
            raise InputError(
                f"Model: its `{effect.label}` of the instrument, with {effect.strength.size} numbers, must be of the "
                f"case {case.name}, which {has}: leave it out of the model file, or fit this case."
            )
        return eqx.tree_at(lambda term: term.strength, mine, effect.strength)

    return model.with_only(placed(effect) for effect in model.effects)


Place = tuple[int, int]  # record, and single sweep within it


@dataclass(frozen=True)
class _Groups:
    """Groups of rows that may share a number, each a set of places."""

    shape: tuple[int, int]
    records: list[set[Place]]
    sweeps: list[set[Place]]
    levels: list[set[Place]]
    phasor: list[set[Place]]
    turned: list[set[Place]]
    swept: list[set[Place]]
    clocked: list[set[Place]]
    hasty: list[set[Place]]
    unsettled: list[set[Place]]
    clock: dict[str, np.ndarray]

    @classmethod
    def of(cls, case: Case) -> "_Groups":
        pieces = [getattr(record, "sweeps", (slice(None),)) for record in case.records]
        places = [[(number, sweep) for sweep in range(len(p))] for number, p in enumerate(pieces)]
        phasor = [np.iscomplexobj(record.readings) for record in case.records]
        times = [_time(record) for record in case.records]
        clocked = [t is not None and wave for t, wave in zip(times, phasor, strict=True)]
        timed = [set(own) for own, mine in zip(places, clocked, strict=True) if mine]
        stepped = [
            (getattr(record, "settled", True), set(own))
            for record, own, mine in zip(case.records, places, clocked, strict=True)
            if mine and record.stepped
        ]
        levels: dict[tuple, set[Place]] = {}
        for (record, rows), own in zip(zip(case.records, pieces, strict=True), places, strict=True):
            for piece, place in zip(rows, own, strict=True):
                levels.setdefault((record.name, _level(record, piece)), set()).add(place)
        return cls(
            (len(places), max(map(len, places))),
            [set(own) for own in places],
            [{place} for own in places for place in own],
            list(levels.values()),
            [set(own) for own, wave in zip(places, phasor, strict=True) if wave],
            [set(own) for own, wave, r in zip(places, phasor, case.records, strict=True) if wave and r.driven],
            [set(own) for own, wave, r in zip(places, phasor, case.records, strict=True) if wave and r.stepped],
            timed,
            _together([own for settled, own in stepped if settled]),
            _together([own for settled, own in stepped if not settled]),
            {
                "begin": np.array([0.0 if t is None else t[0] for t in times]),
                "span": np.array([1.0 if t is None else t[-1] - t[0] for t in times]),
            },
        )

    @property
    def one_clock(self) -> list[set[Place]]:
        """All places with a clock as one group, where there are several records and each begins after another ended."""
        timed = [{place[0] for place in group}.pop() for group in self.clocked]
        begin, span = (self.clock[of][timed] for of in ("begin", "span"))
        order = np.argsort(begin)
        follow = np.all(begin[order][1:] >= (begin + span)[order][:-1])
        return _together(self.clocked) if len(timed) > 1 and follow else []

    @property
    def whole(self) -> dict[str, np.ndarray]:
        """The clock of all records together."""
        timed = [{place[0] for place in group}.pop() for group in self.clocked]
        begin, span = (self.clock[of] for of in ("begin", "span"))
        first = min(begin[timed], default=0.0)
        last = max((begin + span)[timed], default=1.0)
        return {"begin": np.full(begin.shape, first), "span": np.full(begin.shape, last - first)}

    def table(self, groups: Sequence[set[Place]]) -> np.ndarray:
        """Which number a row takes (records, sweeps, k)."""
        out = np.zeros((*self.shape, len(groups)))
        for k, group in enumerate(groups):
            for place in group:
                out[(*place, k)] = 1.0
        return out


def drive_levels(case: Case) -> int:
    """How many levels of the drive the records have."""
    drives = [getattr(record, "setting", None) for record in case.records]
    return len(levels_apart(float(level) for drive in drives if drive is not None for level in np.ravel(drive)))


def _together(groups: Sequence[set[Place]]) -> list[set[Place]]:
    """All places as one group; none where there is none."""
    return [set().union(*groups)] if groups else []


def _level(record: AbstractRecord, piece: slice) -> float:
    """The drive level of a single sweep; records without levels have one."""
    drive = getattr(record, "setting", None)
    return 0.0 if drive is None else float(np.mean(drive[piece]))


def _time(record: AbstractRecord) -> np.ndarray | None:
    time = getattr(record, "time", None)
    return time if time is not None and len(time) > 1 and time[-1] > time[0] else None
