"""The linear device that each setting of temperature and bias voltage shows, and what effects make of how they differ.

A narrow resonance moves by many of its widths over some tens of kelvins, or some volts of bias. A fit to all settings
at once then has no valley to the truth, and what an effect would do to first order says nothing. But each setting by
itself tells a stiffness, a damping and a gain without a guess, and how these go with temperature and bias tells which
effects moved them, and by how much.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.plainly import plainly
from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.effects import DriveEffect, Effect, ForceEffect, ReadoutEffect, Scanned, SurroundingsEffect
from memsgyro_jax.effects.evaluation import Acting, moment
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.experiments.base import Phasors
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.one_place import NEAR, with_place
from memsgyro_jax.measurement.phasor_fit import device_of_phasors

from .joint_residual import Joint


WIDTHS = 1.0  # of the resonance: over less of them, in all settings, a fit has its valley
HALF = 0.5  # of the squares that an effect must explain, of how settings differ, to be tried
MOST = 3  # effects that are tried together
FEWEST = 7  # rows of a setting
TWINS = 1.0 - 1e-9  # cosine from which two effects move a linear device in the same way
ALIKE, ODD = 0.1, 30.0  # widths that settings may be off where effects explain them; squares by which one stands out


class Surrounded(NamedTuple):
    """What one axis of the device is in some surroundings: stiffness and damping per mass, and gain [1/kg], NaN where a
    free decay does not tell it.
    """

    axis: int
    temperature: float
    bias_voltage: float
    stiffness: float
    damping: float
    gain: float


class Trend(NamedTuple):
    """How the settings of a device differ, and what effects make of it.

    Args:
        differences: (n, 3) stiffness in widths of the resonance, damping in dampings, logarithm of the gain; NaN where
            it is not known.
        columns: (n, 3) the same by the strength of each of the effects, by its place in the model.
        constant: (3n, b) what all settings of an axis share.
    """

    differences: np.ndarray
    columns: dict[int, np.ndarray]
    constant: np.ndarray

    def without(self, one: int) -> "Trend":
        """The same without one of the settings."""
        kept = np.arange(len(self.differences)) != one
        shared = self.constant.reshape(*self.differences.shape, -1)[kept]
        columns = {place: column[kept] for place, column in self.columns.items()}
        return Trend(self.differences[kept], columns, shared.reshape(-1, shared.shape[-1]))

    def explained(self, places: Sequence[int]) -> tuple[np.ndarray, float]:
        """What settings share and the strengths of some effects that explain the differences best; squares left."""
        known = np.column_stack([self.constant, *(self.columns[i].ravel() for i in places)])[self.seen]
        found = np.linalg.lstsq(known, self.differences.ravel()[self.seen], rcond=1e-10)[0]
        return found, float(np.sum((self.differences.ravel()[self.seen] - known @ found) ** 2))

    @property
    def seen(self) -> np.ndarray:
        """(3n,) which of the differences are known."""
        return np.isfinite(self.differences.ravel())

    @property
    def spare(self) -> int:
        """How many of them are left beside what settings share."""
        return int(self.seen.sum()) - int(np.linalg.matrix_rank(self.constant[self.seen]))


def in_each_place(case: Case, but: tuple[int, int] | None = None) -> list[Surrounded]:
    """The linear device that the weakest clear drive of each axis shows in each of the surroundings, at rest; where it
    was not swept, that of a free decay. Of sweeps without one row of so many, the first of them as `but` says.
    """
    offered: dict[tuple[int, float, float], list[Phasors]] = {}
    record: Any
    for record in case.records:
        if record.role == "validation" or not hasattr(record, "calm"):
            continue
        for temperature, volts, rows in _surroundings(record):
            told = record.only(rows if but is None else _without(rows, *but)).starting_phasors(case)
            if told is not None:
                offered.setdefault((record.axis, temperature, volts), []).append(told)
    found = []
    for (axis, temperature, volts), there in offered.items():
        device, own = device_of_phasors(there), 0 if there[0].motion.shape[1] == 1 else axis
        if device is not None:
            numbers = float(device.stiffness[own]), float(device.damping[own]), float(device.mobility)
            found.append(Surrounded(axis, temperature, volts, *numbers))
    swept = {(one.axis, round(one.temperature / NEAR), one.bias_voltage) for one in found}
    heard = {(one.axis, round(one.temperature / NEAR), one.bias_voltage): one for one in _heard(case)}
    return [*found, *(one for place, one in heard.items() if place not in swept)]


def _without(rows: np.ndarray, first: int, step: int) -> np.ndarray:
    """The rows (n,) that are chosen but for one of so many of them."""
    kept = rows.copy()
    kept[np.flatnonzero(rows)[first::step]] = False
    return kept


def _heard(case: Case) -> Iterator[Surrounded]:
    """What the axis that vibrates most in each free decay shows of itself, where the record tells its surroundings."""
    for record in with_place(case.records):
        if record.role == "validation":
            continue
        heard = {c: track.seen for c in record.channels if (track := record.decay(case, c)) is not None}
        axis = max(heard, key=lambda c: float(np.max(heard[c].amplitude, initial=0.0)), default=None)
        if axis is not None and (track := heard[axis]).time.size:
            omega, rate = (np.average(values, weights=track.amplitude**2) for values in (track.omega, track.decay))
            around = float(np.mean(record.temperature)), float(np.mean(record.bias_voltage))
            yield Surrounded(axis, *around, float(omega**2 + rate**2), float(2.0 * rate), np.nan)


def _surroundings(record: Any) -> Iterator[tuple[float, float, np.ndarray]]:
    """Temperature and bias voltage of a record's sweeps at rest, and their rows (n,)."""
    still = record.rate == 0
    temperature = NEAR * np.round(record.temperature / NEAR)
    for pair in np.unique(np.stack([temperature, record.bias_voltage], axis=1)[still], axis=0):
        rows = still & (temperature == pair[0]) & (record.bias_voltage == pair[1])
        if rows.sum() >= FEWEST:
            yield float(np.mean(record.temperature[rows])), float(pair[1]), rows


def odd_one(joint: Joint, every: Sequence[Surrounded]) -> tuple[Surrounded, list[int]] | None:
    """The one setting without which some effects explain how all others differ, and their places; `None` where there is
    none, or more than one.
    """
    if len(every) < MOST + 2:
        return None
    start = joint.at(_of_device(joint, every, _trend(joint.model, every, ()).explained(())[0]))
    trend = _trend(start, every, [i for i, e in enumerate(joint.model.effects) if _may_move(e)])
    rest = [trend.without(one) for one in range(len(every))]
    chosen = [_chosen(some) for some in rest]
    left = [some.explained(places)[1] for some, places in zip(rest, chosen, strict=True)]
    best, second = np.argsort(left)[:2]
    if not chosen[best] or left[best] > trend.spare * ALIKE**2 or left[second] < ODD * max(left[best], 1e-6):
        return None
    return every[best], chosen[best]


def as_many_as_settings(joint: Joint, every: Sequence[Surrounded], places: Sequence[int]) -> set[int]:
    """Those of some effects that go with temperature or bias and that settings at which both vary cannot bear out: to
    what they change, stiffness, damping or gain, there are as many strengths as ways in which settings differ.
    """
    if len({one.temperature for one in every}) < 2 or len({one.bias_voltage for one in every}) < 2:
        return set()
    found: set[int] = set()
    trend = _trend(joint.model, every, [i for i in places if _may_move(joint.model.effects[i])])
    for axis in {one.axis for one in every}:
        mine = np.array([one.axis == axis for one in every])
        for part in range(2 if np.isnan([one.gain for one in every]).any() else 3):
            columns = {i: column[mine, part] for i, column in trend.columns.items()}
            moving = {i for i, c in columns.items() if np.ptp(c) > 1e-9 * np.max(np.abs(trend.columns[i]))}
            if len(moving) > 1 and len(moving) >= mine.sum() - 1:
                found |= moving
    return found


def moves(every: Sequence[Surrounded]) -> bool:
    """Whether the resonance of an axis moves by more than its width between its settings."""
    for axis in {one.axis for one in every}:
        mine = [one for one in every if one.axis == axis]
        away = np.ptp([np.sqrt(one.stiffness) for one in mine])
        if away > WIDTHS * np.median([one.damping for one in mine]):
            return True
    return False


def begun(joint: Joint, every: Sequence[Surrounded], candidates: Sequence[int]) -> tuple[np.ndarray, list[int]]:
    """Parameters from which a fit may begin, with the strengths of those of some effects that explain how settings
    differ, and the places of these; none where none does.
    """
    able = [i for i in candidates if _may_move(joint.model.effects[i])]
    model = joint.at(_of_device(joint, every, _trend(joint.model, every, ()).explained(())[0]))
    chosen = _chosen(_trend(model, every, able))
    return put_beside(joint, every, chosen), chosen


def twins_of(joint: Joint, every: Sequence[Surrounded], chosen: Sequence[int], others: Sequence[int]) -> list[int]:
    """Places of other effects that move a linear device as one of the chosen ones does. Driven hard they differ: what
    the drive gains bends it further, what the pick-off gains does not.
    """
    able = [i for i in (*chosen, *others) if _may_move(joint.model.effects[i])]
    columns = {i: column.ravel() for i, column in _trend(joint.model, every, able).columns.items()}
    units = {i: column / np.linalg.norm(column) for i, column in columns.items()}
    return [i for i in units if i not in chosen and any(units[i] @ units[k] > TWINS for k in chosen if k in units)]


def put_beside(joint: Joint, every: Sequence[Surrounded], places: Sequence[int]) -> np.ndarray:
    """Parameters of the device that settings share, with the strengths of some effects that explain best how they
    differ. Twice, as forces move it by the gain at which its numbers hold.
    """
    able, vector = [i for i in places if _may_move(joint.model.effects[i])], joint.start
    for _ in range(2):
        trend = _trend(joint.at(vector), every, able)
        found, _ = trend.explained(known := [*trend.columns])
        vector = _of_device(joint, every, found)
    return with_strengths(joint, vector, dict(zip(known, found[len(found) - len(known) :], strict=True)))


def _trend(model: Model, every: Sequence[Surrounded], places: Sequence[int]) -> Trend:
    """How settings differ, beside what each of some candidates makes of it."""
    axes = sorted({one.axis for one in every})
    number = np.array([axes.index(one.axis) for one in every])
    units = np.stack([_units([one for one in every if one.axis == axis]) for axis in axes])[number]
    shared = np.eye(3 * len(axes)).reshape(len(axes), 3, -1)[number].reshape(3 * len(every), -1)
    columns = {}
    for place, answers in zip(places, _answers(model, [model.effects[i] for i in places], every), strict=True):
        column = answers / units
        own = column.ravel() - shared @ np.linalg.lstsq(shared, column.ravel(), rcond=None)[0]
        if np.isfinite(column).all() and np.linalg.norm(own) > 1e-9 * np.linalg.norm(column):
            columns[place] = column
    return Trend(np.array([_numbers(one) for one in every]) / units, columns, shared)


def _numbers(one: Surrounded) -> tuple[float, float, float]:
    return one.stiffness, one.damping, float(np.log(abs(one.gain)))


def _units(mine: Sequence[Surrounded]) -> np.ndarray:
    """The stiffness that moves a resonance by its width, its damping, and a factor e of the gain."""
    damping = float(np.median([one.damping for one in mine]))
    return np.array([2.0 * np.sqrt(np.median([one.stiffness for one in mine])) * damping, damping, 1.0])


def _may_move(effect: Effect) -> bool:
    """Whether an effect may change the linear device with its surroundings, by one number."""
    acts = isinstance(effect, ForceEffect | DriveEffect | ReadoutEffect)
    other = isinstance(effect, Scanned | SurroundingsEffect) or effect.of_instrument or effect.own_size
    return acts and not other and effect.strength.size == 1


def _answers(model: Model, effects: Sequence[Effect], every: Sequence[Surrounded]) -> list[np.ndarray]:
    """For each of some effects (n, 3) stiffness, damping and logarithm of the gain of each setting by its strength, at
    none.
    """
    if not effects:
        return []
    one = np.eye(model.axes)[[setting.axis for setting in every]]
    around = Conditions(
        temperature=np.array([setting.temperature for setting in every]),
        bias_voltage=np.array([setting.bias_voltage for setting in every]),
    ).rows(len(every))
    return [np.asarray(answers) for answers in _slopes_of_all(model, tuple(effects), one, around)]


@plainly
def _slopes_of_all(model: Model, effects: tuple[Effect, ...], one: jax.Array, around: Conditions) -> list[jax.Array]:
    """One program in place of one for each operation of each effect."""
    by_strength = [jax.jacfwd(partial(_of_strength, model, effect)) for effect in effects]
    return [jax.vmap(slopes, in_axes=(None, 0, 0))(jnp.zeros(()), one, around) for slopes in by_strength]


def _of_strength(model: Model, effect: Effect, strength: jax.Array, one: jax.Array, around: Conditions) -> jax.Array:
    """(3,) what an effect of some strength adds to stiffness, damping and logarithm of the gain along an axis."""
    mass, still = jnp.abs(model.device.mobility), jnp.zeros(model.axes)
    acting = Acting.of((eqx.tree_at(lambda e: e.strength, effect, jnp.reshape(strength, effect.strength.shape)),))

    def answer(amounts: jax.Array) -> jax.Array:
        motion, speed, command = amounts[:, None] * one
        now = moment(
            motion, speed, command, around, device=model.device, scale=model.scale,
            reference_temperature=model.reference_temperature, reference_bias=model.reference_bias,
            order=model.order,
        )  # fmt: skip
        now = eqx.tree_at(lambda m: (m.acceleration, m.jerk), now, (motion, still), is_leaf=lambda v: v is None)
        now = acting.driven(now)
        shown = acting.signal(model.scale * now.seen, now) / model.scale
        return jnp.stack([acting.force(now, jnp.zeros(0))[0] @ one, now.force @ one, shown @ one])

    by = jax.jacfwd(answer)(jnp.zeros(3))
    return jnp.stack([-mass * by[0, 0], -mass * by[0, 1], jnp.log(jnp.abs(by[1, 2] * by[2, model.order % 2]))])


def _chosen(trend: Trend) -> list[int]:
    """Places of effects that explain, one after the other, more than half of how the settings differ."""
    chosen: list[int] = []
    left = trend.explained([])[1]
    while len(chosen) < min(MOST, len(trend.columns)):
        offers = [(trend.explained([*chosen, i])[1], i) for i in trend.columns if i not in chosen]
        least = min(offers)[0]
        best = min(i for squares, i in offers if squares <= 1.001 * least + 1e-12)  # of twins the catalogue's first
        if least > HALF * left:
            break
        chosen, left = [*chosen, best], least
    return chosen


def _of_device(joint: Joint, every: Sequence[Surrounded], found: np.ndarray) -> np.ndarray:
    """Parameters of the device that settings share, by the numbers of each axis that was found."""
    axes = sorted({one.axis for one in every})
    vector, names, gains = joint.start.copy(), [parameter.name for parameter in joint.parameters], []
    for k, axis in enumerate(axes):
        mine = [one for one in every if one.axis == axis]
        stiffness, damping, gain = found[3 * k : 3 * k + 3] * _units(mine)
        pair = "" if joint.model.axes == 1 else 2 * "xy"[axis]
        vector[names.index(f"k{pair}/m")] = max(stiffness, 0.5 * min(one.stiffness for one in mine))
        vector[names.index(f"d{pair}/m")] = max(damping, 0.1 * min(one.damping for one in mine))
        gains += [gain] if np.isfinite([one.gain for one in mine]).any() else []
    if (place := names.index("1/m")) not in joint.idle and gains:
        vector[place] = np.copysign(np.exp(np.mean(gains)), np.nanmedian([one.gain for one in every]))
    return vector


def with_strengths(joint: Joint, vector: np.ndarray, strengths: Mapping[int, float]) -> np.ndarray:
    """The parameters with some effects, by place, within the bounds of their strengths."""
    out, (low, high) = vector.copy(), joint.bounds
    for place, strength in strengths.items():
        mine = joint.of_effect(place)
        out[mine] = np.clip(strength, low[mine], high[mine])
    return out
