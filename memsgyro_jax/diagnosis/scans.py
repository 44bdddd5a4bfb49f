"""Effects that no gradient at zero finds: tried at every point of a grid, on the records in which they would show."""

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from memsgyro_jax.effects import Coverage, DampingStep, ParasiticMode, Scanned, catalogue, free_numbers
from memsgyro_jax.measurement.absent import Absent
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.experiments import Readings
from memsgyro_jax.measurement.first_order import AskedRows, Periods, contributions
from memsgyro_jax.measurement.model import Model

from .joint_residual import Joint
from .linearised import compiled
from .optimum import Optimum
from .programs import Programs
from .score import Score, basis, score, within_bounds


COARSE = 32  # points at most that are tried where each takes long
CHUNK = 8  # grid points evaluated side by side
BEYOND = 2.0  # times what an effect does at a point of its grid: so much it may do between that and the next
LOW = 4  # harmonics, the mean included, at which a scan looks


@dataclass(frozen=True, eq=False)
class ScannedPoint:
    """The best point of a scan: the effect there, its score, and how many points were tried."""

    effect: Scanned
    score: Score
    points: int


def coverage(case: Case) -> Coverage:
    """What the records of a case cover."""
    low, high = case.resonances
    every = np.concatenate([*(r.frequencies for r in case.records), [0.8 * low, 1.2 * high]])
    volts = max(float(np.max(np.abs(r.readings))) for r in case.records)
    band = float(every.min()), float(every.max())
    return Coverage(band, volts, tuple(r.duration for r in case.records), max(r.sweep_rate for r in case.records))


def scans(case: Case) -> tuple[tuple[Scanned, ...], ...]:
    """The grids worth scanning for a case, one per effect and variant."""
    covered = coverage(case)
    grids = [e.grid(covered) for e in catalogue(case.channels) if isinstance(e, Scanned)]
    return tuple(grid for grid in grids if grid)


def scan(
    model: Model,
    optimum: Optimum,
    readings: Sequence[Readings],
    grid: Sequence[Scanned],
    programs: Programs | None = None,
) -> ScannedPoint | None:
    """Score of every point of a grid beside the fitted model; the best one, or `None` where no record would show it.

    All points are tried with few harmonics, whatever the fit needs: the refit judges the best of them with as many.

    Args:
        model: at the optimum, without the effect.
        optimum: the residual and Jacobian of the fitted readings.
        readings: the fitted readings, in the order of that residual.
        grid: the effect at every point.
        programs: those of the fit.
    """
    q, best, joint = basis(optimum.jacobian), None, Joint(model, readings, programs)
    starts = np.concatenate([[0], np.cumsum([r.size for r in readings])])
    for place, chosen in enumerate(readings):
        points = [e for e in grid if _shows(e, chosen, readings)]
        if not points:
            continue
        if chosen.experiment.slow:
            points = points[:: -(-len(points) // COARSE)]
        span = slice(starts[place], starts[place + 1])
        columns = _stepped(joint, chosen, points) if isinstance(points[0], DampingStep) else None
        columns = _settled(joint, chosen, points) if columns is None else columns
        columns = _run(joint.model, chosen, points) if columns is None else columns
        for effect, column in zip(points, columns, strict=True):
            whole = np.zeros((optimum.residual.size, 1))
            whole[span, 0] = np.where(np.isfinite(column), column, 0.0)
            (number,) = [n for n in free_numbers(effect) if n.field == "strength"]
            low, high = np.array([number.low]), np.array([number.high])
            if "strength" in effect.scanned:  # then it is a step, of which a fit finds a part or some more
                low, high = np.zeros(1), np.full(1, BEYOND)
            mine = within_bounds(score(optimum.residual, q, whole), optimum.residual, whole, low, high)
            found = ScannedPoint(effect, mine, len(grid))
            if best is None or found.score.statistic > best.score.statistic:
                best = found
    return best


def _stepped(joint: Joint, chosen: Readings, points: Sequence[Scanned]) -> np.ndarray | None:
    """(points, r) what each step adds to a residual per strength: the response to what a change that always was there
    would add, from the moment of the step on; `None` where an experiment does not tell its moments.
    """
    inquiry, steps = joint.asked(joint.start, chosen), [point for point in points if isinstance(point, DampingStep)]
    if inquiry is None:
        return None
    model = joint.model.present
    records = sorted({float(step.record) for step in steps})
    lasting = Absent(
        tuple(DampingStep(0.0, time=-np.inf, record=r) for r in records), (len(model.effects),) * len(records)
    )
    always = contributions(model, lasting, eqx.tree_at(lambda one: one.base, inquiry, None))
    mine = [records.index(float(step.record)) for step in steps]

    def since(values: np.ndarray, rows: AskedRows) -> np.ndarray:
        late = np.stack([np.asarray(rows.conditions.time) >= float(step.time) for step in steps])
        return values[mine] * late.reshape(*late.shape, *(1,) * (values.ndim - 2))

    pushes = tuple(since(push, rows) for push, rows in zip(always.forced, inquiry.forced, strict=True))
    lanes = jax.tree.map(lambda leaf: np.zeros((len(steps), *leaf.shape), leaf.dtype), chosen.experiment.nothing(model))
    added = eqx.tree_at(lambda one: (one.forced, one.seen), lanes, (pushes, since(always.seen, inquiry.read)))
    return joint.responses(joint.start, added, chosen)


def _settled(joint: Joint, chosen: Readings, points: Sequence[Scanned]) -> np.ndarray | None:
    """(points, r) what each effect adds to a residual per strength, in closed form beside how the model moves; `None`
    where there is none.

    Rows stand alone: what a unit of acceleration does to each of them, harmonic by harmonic, tells what any does. What
    a read-out that looks back sees of the acceleration itself is left out, beside the motion that it makes. Rows of
    phasors that are integrated from one to the next, as those of a free decay, are no such rows.
    """
    if joint.model.order == 2 or points[0].carried(np.zeros((0, LOW, joint.model.axes)), np.zeros(0)) is None:
        return None
    inquiry = joint.asked(joint.start, chosen)
    if inquiry is None or len(inquiry.forced) != 1 or not isinstance(inquiry.forced[0], Periods):
        return None
    settled = inquiry.forced[0]
    motion = np.asarray(settled.state)[..., : joint.model.axes]
    if len(motion) != len(chosen.experiment.measured):  # several moments a row: it goes on from that before
        return None
    added = [effect.carried(motion, np.asarray(settled.frequency)) for effect in points]
    parts = [part for part in added if part is not None]
    if len(parts) < len(added):
        return None
    waves = np.stack(parts)
    acting = [(h, axis) for h, axis in np.argwhere(np.any(waves != 0, axis=(0, 1))) if h < LOW]
    units = np.zeros((2 * len(acting), *motion.shape), complex)
    for k, (h, axis) in enumerate(acting):
        units[2 * k, :, h, axis], units[2 * k + 1, :, h, axis] = 1.0, 1j
    nothing = chosen.experiment.nothing(joint.model.present)
    lanes = jax.tree.map(lambda leaf: np.zeros((len(units), *leaf.shape), leaf.dtype), nothing)
    known = joint.responses(joint.start, eqx.tree_at(lambda one: one.forced, lanes, (units,)), chosen)
    rows = known[: len(units)].reshape(len(units), len(motion), -1)
    sizes = [part for h, axis in acting for part in (waves[..., h, axis].real, waves[..., h, axis].imag)]
    return np.einsum("kpr,krm->prm", np.stack(sizes), rows).reshape(len(points), -1)


def _run(model: Model, chosen: Readings, points: Sequence[Scanned]) -> np.ndarray:
    """The same through a program that carries the effects, some at a time.

    What a small force does is looked at without what the read-out bends: slopes of many waveforms and the waveforms
    themselves side by side took XLA twenty seconds a lot, and the refit judges what is found.
    """
    columns = []
    if "strength" not in points[0].scanned:
        model = model.with_only(e for e in model.effects if model.with_only([e]).is_read_linearly)
    for begin in range(0, len(points), CHUNK):
        some = [*points[begin : begin + CHUNK]]
        padded = some + [some[-1]] * (CHUNK - len(some))
        columns += list(np.asarray(_slopes(model, _stacked(padded), chosen.experiment.coarse)))[: len(some)]
    return np.stack(columns)


def _shows(effect: Scanned, chosen: Readings, readings: Sequence[Readings]) -> bool:
    """Whether a scan looks at this record for this effect."""
    if isinstance(effect, DampingStep):
        return bool(np.any(chosen.record == int(effect.record)))
    return chosen.experiment.shows_modes or not any(r.experiment.shows_modes for r in readings)


def _stacked(effects: Sequence[Scanned]) -> Scanned:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *effects)


@compiled
def _slopes(model: Model, effects: Scanned, experiment) -> Array:
    """What each effect adds to the residual: per strength, or by the step from zero where the strength is scanned."""

    def one(effect: Scanned) -> Array:
        def residual(strength: Array) -> Array:
            return experiment.residual(model.with_effect(eqx.tree_at(lambda e: e.strength, effect, strength)))

        if "strength" in effect.scanned:
            return residual(effect.strength) - experiment.residual(model)
        return jax.jvp(residual, (jnp.zeros_like(effect.strength),), (jnp.ones_like(effect.strength),))[1]

    return jax.vmap(one)(effects)


def refined(effect: Scanned, grid: Sequence[Scanned]) -> tuple[Scanned, ...]:
    """A finer grid around a point: frequencies a quarter of a width apart, moments an eighth of those tried; elsewhere
    the point alone.
    """
    if isinstance(effect, DampingStep):
        moments = sorted(float(e.time) for e in grid if isinstance(e, DampingStep) and e.record == effect.record)
        apart = moments[1] - moments[0] if len(moments) > 1 else 0.0
        times = float(effect.time) + apart * np.linspace(-0.875, 0.875, 15)
        return tuple(DampingStep(effect.strength, time=float(t), record=effect.record) for t in times)
    if not isinstance(effect, ParasiticMode):
        return (effect,)
    width = float(effect.omega / effect.quality)
    qualities = np.array([0.25, 0.5, 1.0, 2.0, 4.0]) * float(effect.quality)
    return tuple(
        ParasiticMode(effect.axis, effect.strength, omega=float(effect.omega) + part * width, quality=float(quality))
        for part in np.linspace(-0.75, 0.75, 13)
        for quality in qualities
    )
