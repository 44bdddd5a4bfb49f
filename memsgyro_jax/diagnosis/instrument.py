"""The instrument before physics: nuisance terms that a case can hold, and what is known of them before it is recorded.

A term is an effect whose strength has one entry per record or sweep; fit, scores and refits treat it like any other.
What is known beforehand of a strength enters as readings of it.
"""

from collections.abc import Mapping, Sequence
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
    FrequencyWander,
    GainDrift,
    RecordGain,
    RecordTemperature,
)
from memsgyro_jax.effects.lock_in_poles import LockInFilter
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
from memsgyro_jax.effects.section import settings_of
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.declared import QUANTITIES
from memsgyro_jax.measurement.drive_levels import levels_apart
from memsgyro_jax.measurement.experiments import Readings
from memsgyro_jax.measurement.experiments.base import Experiment, RealNoise
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.one_place import set_points

from .row_groups import Place, RowGroups, time_of, together


SEVERAL, PARTS = 3, 12  # single sweeps from which a resonance may wander, and parts of its course at most
LONGER = 1.5  # times as many, which a course may have that another is compared with
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
    groups = RowGroups.of(case)
    phasor, clocked = groups.phasor, groups.clocked
    turned = groups.turned
    every, several = together(turned), turned if len(turned) > 1 else []
    found = [
        (UnsettledRows, groups.hasty, {}),
        (LockInTime, groups.unsettled, {}),
        (LockInMemory, together(groups.swept), {}),
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


def _interference(case: Case, groups: "RowGroups") -> list[InterferingLine]:
    """The lines that stand in records over time, each with its own numbers; none where there is no line."""
    told = [
        (number, line.omega, 0.5 * (time[0] + time[-1]))
        for number, record in enumerate(case.records)
        if (time := time_of(record)) is not None
        for line in record.interference(case)
        for _ in range(2 * case.channels)
    ]
    if not told:
        return []
    numbers, omega, middle = (np.array(part) for part in zip(*told, strict=True))
    table = groups.table([{(int(number), 0)} for number in numbers])
    return [InterferingLine(np.zeros(len(told)), table, omega, middle)]


def every_term(case: Case) -> tuple[InstrumentTerm, ...]:
    """The same, and those that a search tries in the place of others alone."""
    tried = instrument_terms(case)
    others = [t for t in (undeclared_temperature(case), frequency_wander(case)) if t is not None]
    twin = [CapacitiveFeedthrough(t.strength) for t in tried if isinstance(t, LockInFeedthrough)]
    return (*tried, *twin, *_late(case), *filters_of(case), *declared_terms(case), *others)


def frequency_wander(case: Case, parts: int | None = None) -> FrequencyWander | None:
    """A resonance that wanders over sweeps which follow each other by one clock, in so many parts, else in as many as
    there are single sweeps: each passes the resonance once, and more would imitate anything. `None` where there are
    fewer than `SEVERAL`, or far less than the parts.
    """
    groups = RowGroups.of(case)
    timed = groups.in_turn
    sweeps = [own for own in groups.swept if timed and own <= timed[0]]
    most = min(PARTS, sum(map(len, sweeps)))
    size = most if parts is None else parts
    if most < SEVERAL or size > LONGER * most:
        return None
    return FrequencyWander(np.zeros(size), np.repeat(groups.table(timed), size, axis=2), **groups.whole)


def _late(case: Case) -> list[LateReadings]:
    """What comes late as a whole, of sweeps that show phasors."""
    groups = RowGroups.of(case)
    swept = [r.frequencies for r in case.records if hasattr(r, "setting") and np.iscomplexobj(r.readings)]
    if not (swept and groups.swept):
        return []
    return [LateReadings(np.zeros(1), groups.table(together(groups.swept)), np.median(np.concatenate(swept)))]


def filters_of(case: Case) -> list[LockInFilter]:
    """The filter of the lock-in behind sweeps with a clock; none where there is none."""
    groups = RowGroups.of(case)
    clocked = together([group for group in groups.clocked if group in groups.swept])
    return [LockInFilter(np.zeros(1), groups.table(clocked))] if clocked else []


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
    table = RowGroups.of(case).table(list(groups.values()))
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
        wanders = isinstance(effect, FrequencyWander)
        mine = frequency_wander(case, effect.strength.size) if wanders else offered.get(effect.label)
        if mine is None or mine.strength.shape != effect.strength.shape:
            has = "has no rows for it" if mine is None else f"has {mine.strength.size}"
            raise InputError(
                f"Model: its `{effect.label}` of the instrument, with {effect.strength.size} numbers, must be of the "
                f"case {case.name}, which {has}: leave it out of the model file, or fit this case."
            )
        kept = ("strength", *settings_of(effect))
        return eqx.tree_at(
            lambda term: [getattr(term, name) for name in kept], mine, [getattr(effect, n) for n in kept]
        )

    return model.with_only(placed(effect) for effect in model.effects)


def drive_levels(case: Case) -> int:
    """How many levels of the drive the records have."""
    drives = [getattr(record, "setting", None) for record in case.records]
    return len(levels_apart(float(level) for drive in drives if drive is not None for level in np.ravel(drive)))
