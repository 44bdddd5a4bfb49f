"""The force of an effect that was found, over displacement, velocity or amplitude, beside what records show of it."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.effects.base import Effect, ForceEffect
from memsgyro_jax.effects.evaluation import moment
from memsgyro_jax.measurement.experiments.missing_force import BLOCKS, Binned, SweepForce, in_bins
from memsgyro_jax.measurement.model import Model

from .fit import CaseFit
from .residual_force import beside_lowest_drive, sweep_forces, time_forces
from .result import Accepted, Diagnosis


_PHASES = 64  # of a period, over which a force is averaged
_POINTS = 60
_MATTERS = 1e-3  # of the larger part of a law, below which the other is left out


@dataclass(frozen=True, eq=False)
class LawOverWaveform:
    """A law and the force that waveforms show, less the straight line that the base model takes up.

    `over` is "displacement" or "velocity", `place` and `law` the curve in SI, `spread` the relative half width of its
    95 % band, `base` and `final` what is missing beside these models, in bins.
    """

    record: str
    over: str
    place: Float[np.ndarray, " points"]
    law: Float[np.ndarray, " points"]
    spread: float
    base: Binned
    final: Binned


@dataclass(frozen=True, eq=False)
class LawOverAmplitude:
    """A law and the rows of a sweep as a stiffness or a damping (`part`) over amplitude, less that of the base model.

    `base` and `final` are what is missing beside these models (rows,), `std` the noise of both.
    """

    record: str
    part: str
    place: Float[np.ndarray, " points"]
    law: Float[np.ndarray, " points"]
    spread: float
    amplitude: Float[np.ndarray, " rows"]
    base: Float[np.ndarray, " rows"]
    final: Float[np.ndarray, " rows"]
    std: Float[np.ndarray, " rows"]


def found_forces(diagnosis: Diagnosis) -> list[tuple[Accepted, LawOverWaveform | LawOverAmplitude]]:
    """A view of each accepted force that follows the motion, the waveform's where one shows it, else a sweep's."""
    base, out = beside_lowest_drive(diagnosis.base), []
    for accepted in diagnosis.accepted:
        effect = next((e for e in diagnosis.final.model.effects if e.label == accepted.label), None)
        if not isinstance(effect, ForceEffect) or effect.own_size or len(accepted.estimate) != 1:
            continue
        spread = 1.96 * diagnosis.scale * accepted.std[0] / max(abs(accepted.estimate[0]), 1e-300)
        view = _over_waveform(diagnosis, base, effect, spread) or _over_amplitude(diagnosis, base, effect, spread)
        if view is not None:
            out.append((accepted, view))
    return out


def _force(model: Model, effect: Effect, displacement: Array, velocity: Array) -> np.ndarray:
    """Force (rows, axes) [N] at displacements and velocities (rows, axes), at the reference conditions."""

    def one(q: Array, v: Array) -> Array:
        conditions = Conditions(temperature=None, bias_voltage=None)
        now = moment(
            q, v, jnp.zeros_like(q), conditions, device=model.device, scale=model.scale,
            reference_temperature=model.reference_temperature, reference_bias=model.reference_bias, order=model.order,
        )  # fmt: skip
        return effect.force(now)  # type: ignore[attr-defined]

    return np.asarray(jax.vmap(one)(jnp.asarray(displacement), jnp.asarray(velocity)))


def _along(axis: int, axes: int, values: np.ndarray) -> np.ndarray:
    out = np.zeros((len(values), axes))
    out[:, axis] = values
    return out


def _over_waveform(diagnosis: Diagnosis, base: CaseFit, effect: Effect, spread: float) -> LawOverWaveform | None:
    model, left = diagnosis.final.model, {one.record: one for one in time_forces(diagnosis.final)}
    best: tuple[float, LawOverWaveform] | None = None
    for course in time_forces(base):
        if course.record not in left:
            continue
        moved = left[course.record] if left[course.record].window.size == course.window.size else course
        # What a waveform lacks is seen in a band alone, without its mean: so is the law, along the same motion.
        force = course.as_seen(_force(model, effect, moved.motion, moved.speed))
        for axis in np.flatnonzero(course.force.any(axis=0)):
            for over in ("displacement", "velocity"):
                # Along the motion of the final model: beside it the base model falls out of step.
                along = getattr(moved, over)[:, axis]
                points, law = (in_bins(part[:, axis], along, blocks=BLOCKS) for part in (course.force, force))
                # The base model takes the straight line that fits best: from law and points alike.
                bent, mean = (part.mean - _line(points.centre, part.mean)(points.centre) for part in (law, points))
                size = float(np.max(np.abs(bent)))
                if size > 3.0 * float(np.median(points.error)) and (best is None or size > best[0]):
                    beside = getattr(left[course.record], f"against_{over}")(axis)
                    shown = Binned(points.centre, mean, points.error)
                    best = size, LawOverWaveform(course.record, over, points.centre, bent, spread, shown, beside)
    return None if best is None else best[1]


def _line(across: np.ndarray, values: np.ndarray) -> np.poly1d:
    return np.poly1d(np.polyfit(across, values, 1))


def _over_amplitude(diagnosis: Diagnosis, base: CaseFit, effect: Effect, spread: float) -> LawOverAmplitude | None:
    left = {one.record: one for one in sweep_forces(diagnosis.final)}
    best: tuple[float, LawOverAmplitude] | None = None
    for sweep in sweep_forces(base):
        if sweep.record not in left:
            continue
        place = np.linspace(0.02, 1.0, _POINTS) * float(np.max(sweep.amplitude))
        for axis, law in enumerate(_describing(diagnosis.final.model, effect, sweep, place)):
            for part, values in law.items():
                seen = getattr(sweep, part)[:, axis]
                std, other = getattr(sweep, f"{part}_std")[:, axis], getattr(left[sweep.record], part)[:, axis]
                bent = np.interp(sweep.amplitude, place, values)
                size = float(np.max(np.abs(np.diff(values)).sum() / np.median(std)))
                if size > 3.0 and (best is None or size > best[0]):
                    # What the base model holds already is one number.
                    held = np.sum((seen - bent) / std**2) / np.sum(1.0 / std**2)
                    view = (part, place, values, spread, sweep.amplitude, seen - held, other, std)
                    best = size, LawOverAmplitude(sweep.record, *view)
    return None if best is None else best[1]


def _describing(model: Model, effect: Effect, sweep: SweepForce, place: np.ndarray) -> list[dict[str, np.ndarray]]:
    """Per axis of the force, the stiffness and the damping that the law amounts to in a swing of each amplitude."""
    omega, angle = float(np.median(sweep.frequency)), 2.0 * np.pi * np.arange(_PHASES) / _PHASES
    turned, rate = np.outer(place, np.cos(angle)), -omega * np.outer(place, np.sin(angle))
    motion = [_along(sweep.axis, model.axes, values.ravel()) for values in (turned, rate)]
    force = _force(model, effect, *motion).reshape(len(place), _PHASES, model.axes)
    stiffness = -2.0 * np.mean(force * np.cos(angle)[:, None], axis=1) / place[:, None]
    damping = 2.0 * np.mean(force * np.sin(angle)[:, None], axis=1) / (omega * place[:, None])
    out = []
    for axis in range(model.axes):
        parts = {"stiffness": stiffness[:, axis], "damping": damping[:, axis]}
        sizes = {"stiffness": np.ptp(stiffness[:, axis]), "damping": omega * np.ptp(damping[:, axis])}
        out.append({name: parts[name] for name, size in sizes.items() if size > _MATTERS * max(sizes.values()) > 0.0})
    return out
