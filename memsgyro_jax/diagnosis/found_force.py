"""The force of an effect that was found, over displacement, velocity or amplitude, beside what records show of it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from memsgyro_jax.effects.base import Effect, ForceEffect
from memsgyro_jax.measurement.experiments.missing_force import BLOCKS, Binned, in_bins

from .describing import describing_function, force_of
from .findings import Accepted
from .fit import CaseFit
from .residual_force import beside_lowest_drive, sweep_forces, time_forces
from .result import Diagnosis


_POINTS = 60


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
    """A law and the rows of all sweeps of an axis as a stiffness or a damping (`part`) over amplitude.

    `seen` is the law and what the final model leaves of each row (rows,), `left` that alone, `std` the noise of both.
    """

    record: str
    part: str
    place: Float[np.ndarray, " points"]
    law: Float[np.ndarray, " points"]
    spread: float
    amplitude: Float[np.ndarray, " rows"]
    seen: Float[np.ndarray, " rows"]
    left: Float[np.ndarray, " rows"]
    std: Float[np.ndarray, " rows"]


def found_forces(diagnosis: Diagnosis) -> list[tuple[Accepted, LawOverWaveform | LawOverAmplitude]]:
    """A view of each accepted force that follows the motion, the waveform's where one shows it, else the sweeps'."""
    base, out = beside_lowest_drive(diagnosis.base), []
    for accepted in diagnosis.accepted:
        effect = next((e for e in diagnosis.final.model.effects if e.label == accepted.label), None)
        if not isinstance(effect, ForceEffect) or effect.own_size or len(accepted.estimate) != 1:
            continue
        spread = 1.96 * diagnosis.scale * accepted.std[0] / max(abs(accepted.estimate[0]), 1e-300)
        view = _over_waveform(diagnosis, base, effect, spread) or _over_amplitude(diagnosis, effect, spread)
        if view is not None:
            out.append((accepted, view))
    return out


def _over_waveform(diagnosis: Diagnosis, base: CaseFit, effect: Effect, spread: float) -> LawOverWaveform | None:
    model, left = diagnosis.final.model, {one.record: one for one in time_forces(diagnosis.final)}
    best: tuple[float, LawOverWaveform] | None = None
    for course in time_forces(base):
        if course.record not in left:
            continue
        moved = left[course.record] if left[course.record].window.size == course.window.size else course
        # What a waveform lacks is seen in a band alone, without its mean: so is the law, along the same motion.
        force = course.as_seen(force_of(model, effect, moved.motion, moved.speed))
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


def _over_amplitude(diagnosis: Diagnosis, effect: Effect, spread: float) -> LawOverAmplitude | None:
    """Component and residual, as of a regression with several terms: what else the final model has, effects and the
    instrument, is taken as it says. Beside the base model, all that is missing would stand in one place.
    """
    best: tuple[float, LawOverAmplitude] | None = None
    every = sweep_forces(diagnosis.final)
    for driven in {sweep.axis for sweep in every}:
        sweeps = [sweep for sweep in every if sweep.axis == driven]
        amplitude, omega = (np.concatenate([getattr(s, of) for s in sweeps]) for of in ("amplitude", "frequency"))
        place = np.linspace(0.02, 1.0, _POINTS) * float(np.max(amplitude))
        laws = describing_function(diagnosis.final.model, effect, driven, float(np.median(omega)), place)
        for axis, law in enumerate(laws):
            for part, values in law.items():
                left, std = (np.concatenate([getattr(s, of)[:, axis] for s in sweeps]) for of in (part, f"{part}_std"))
                size = float(np.max(np.abs(np.diff(values)).sum() / np.median(std)))
                if size > 3.0 and (best is None or size > best[0]):
                    seen = np.interp(amplitude, place, values) + left
                    view = (part, place, values, spread, amplitude, seen, left, std)
                    best = size, LawOverAmplitude(", ".join(s.record for s in sweeps), *view)
    return None if best is None else best[1]
