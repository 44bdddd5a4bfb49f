"""A fit that starts where a law was drawn.

The drawing knows no branches: each row is an equation. A fit does, and near a fold, where the drawn law is a little
off, the model may stand on another branch than the device did. Such a row says nothing of how to move: it is judged
with all others, but not fitted.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import numpy as np

from memsgyro_jax.effects import InstrumentTerm, QuadraticStiffness, load_effects
from memsgyro_jax.effects.base import Effect
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.experiments import Readings
from memsgyro_jax.measurement.readings import readings_of

from .drives import Rows, without_rows
from .fit import CaseFit, beside_case, fit_case
from .instrument import knowledge
from .joint_residual import Joint
from .law import DrawnLaw
from .law_file import LawTerm
from .optimum import optimise
from .residual_force import lowest_drive
from .resolved import sharpened, still_apart
from .result import validation_error


AWAY = 6.0  # times the median of what is left: from there on a row does not guide the fit
MOST = 0.25  # share of a record's rows that may lie so far off
ROUNDS = 4
SHAPE = ("exponent", "threshold")  # what makes the shape of a term, beside its strength
FALLEN = 100.0  # times the χ² of a few harmonics, beyond which more of them stand on another branch
EVEN = 12.0  # of χ², in units of what is left per reading, that an even part must take


def beside_known(case: Case, effects: Sequence[Effect]) -> CaseFit:
    """The base model with effects that are known to be there, as a law is drawn beside it: fitted to the sweeps of the
    lowest drive alone, where the law shows least and takes nothing from their strengths, and laid beside all records.
    """
    fit = fit_case(case, effects, held=True)
    places = np.array([i for i in range(fit.joint.start.size) if i not in fit.joint.idle])
    lowest = lowest_drive(fit, places)
    return fit_case(case, effects) if lowest is None else _beside_all(case, fit.joint, lowest.vector, places)


def fit_law(law: DrawnLaw, path: str | Path) -> CaseFit:
    """The fit of the case with the law of an effect file, as drawn or as edited, from where the drawing left off.

    Rows far off all others, as those are that the model has on another branch of a folded resonance, do not guide it.

    **Raises:** `InputError` where the file is no effect file.
    """
    case, effects = law.measured, load_effects(path, law.beside.axes, as_written=True)
    terms = [effect for effect in law.beside.effects if isinstance(effect, InstrumentTerm)]
    joint = Joint(law.beside.with_effect(*effects), (*readings_of(case), *knowledge(terms)))
    # A corner near a fold asks for many harmonics: with fewer the fit would leave the law that was drawn.
    begin = np.concatenate(joint.residual(joint.start, joint.fitted))
    finest = sharpened(joint.model, joint.readings, begin)[0]
    fit = _guided(case, _with_shape_held(_at_resolution(joint, finest, float(begin @ begin))))
    kept, apart = sharpened(fit.model, without_rows(joint.readings, _far_rows(fit)))
    finer = tuple(_with_all_rows(fewer, whole) for fewer, whole in zip(kept, joint.readings, strict=True))
    if any(_resolution(new) != _resolution(old) for new, old in zip(finer, joint.readings, strict=True)):
        fit = _guided(case, Joint(fit.model, finer))
        apart = still_apart(fit.model, without_rows(finer, _far_rows(fit))) if apart else apart
    return replace(fit, apart=apart)


def with_even_part(law: DrawnLaw, fit: CaseFit) -> DrawnLaw:
    """The law with an even stiffness, which shifts the mean and makes a second harmonic, where waveforms bear it out.

    Rows of amplitude and phase do not tell it. Beside a fit with the law as it is, one that starts at no even part
    keeps it if it is significant and lowers the error of what was not fitted; else the law itself is returned.
    """
    (low, high), waves = law.seen[0], [r for r in fit.joint.fitted if not np.iscomplexobj(r.experiment.measured)]
    if not waves or law.knots:
        return law
    joint = Joint(fit.model.with_effect(QuadraticStiffness(law.axis)), fit.joint.readings)
    places = np.array([i for i in range(joint.start.size) if i not in joint.idle])
    found = optimise(joint, joint.start, places, joint.fitted)
    more = _beside_all(fit.case, joint, found.vector, places)
    strength = float(more.model.effects[-1].strength)
    worth = more.optimum.chi2 < fit.optimum.chi2 - EVEN * max(1.0, fit.chi2_per_dof)
    if not worth or validation_error(more) >= validation_error(fit):
        return law
    return replace(law, terms=(*law.terms, LawTerm("even_stiffness", high * strength, 1.0, None, high, low)))


def of_the_catalogue(law: DrawnLaw, fit: CaseFit) -> dict[str, str]:
    """Terms of a fitted law that the catalogue has, by the exponent that the fit found: name in the file to label."""
    axis, found = "xy"[law.axis], {estimate.name: estimate.value for estimate in fit.estimates}
    known = {
        name: term.known_as(found.get(f"{name} {axis} exponent", np.nan))
        for name, term in zip(law.names, law.terms, strict=False)
    }
    return {name: f"{label} {axis}" for name, label in known.items() if label}


def with_held_terms(law: DrawnLaw, fit: CaseFit) -> DrawnLaw:
    """The law without the terms whose strength a fit of it finds that the records do not hold."""
    loose = {estimate.name.split(" ")[0] for estimate in fit.estimates if not np.isfinite(estimate.std)}
    if law.knots or not loose & set(law.names):
        return law
    return replace(law, terms=tuple(t for name, t in zip(law.names, law.terms, strict=True) if name not in loose))


def _at_resolution(joint: Joint, finest: Sequence[Readings], chi2: float) -> Joint:
    """The same at a finer resolution, which is led to step by step, the shape held, where the law as drawn falls to
    another branch there: where it leaves far more than `chi2`, which it leaves with a few harmonics.
    """
    fine = Joint(joint.model, finest)
    left = np.concatenate(fine.residual(fine.start, fine.fitted))
    if left @ left <= FALLEN * chi2:
        return fine
    while any(_resolution(one) != _resolution(last) for one, last in zip(joint.readings, finest, strict=True)):
        held = _with_shape_held(joint)
        steps = [
            one if _resolution(one) == _resolution(last) else one.changed(lambda e: e.finer or e)
            for one, last in zip(held.readings, finest, strict=True)
        ]  # fmt: skip
        joint = Joint(held.model, steps)
    return joint


def _with_shape_held(joint: Joint) -> Joint:
    """The same from the optimum at the exponents and thresholds as they are: while all else is off, they would run
    away to where nothing leads back.
    """
    held = [i for i, p in enumerate(joint.parameters) if p.name.endswith(SHAPE)]
    places = np.array([i for i in range(joint.start.size) if i not in joint.idle and i not in held])
    return Joint(joint.at(optimise(joint, joint.start, places, joint.fitted).vector), joint.readings)


def _guided(case: Case, joint: Joint) -> CaseFit:
    """The optimum of the rows that are not far off, and all rows beside it."""
    places = np.array([i for i in range(joint.start.size) if i not in joint.idle])
    fit, left_out = _beside_all(case, joint, joint.start, places), None
    for _ in range(ROUNDS):
        away = _far_rows(fit)
        if away == left_out:
            break
        left_out = away
        found = optimise(joint, fit.optimum.vector, places, without_rows(joint.fitted, away))
        fit = _beside_all(case, joint, found.vector, places)
        fit = replace(fit, optimum=replace(fit.optimum, converged=found.converged, evaluations=found.evaluations))
    return fit


def _beside_all(case: Case, joint: Joint, vector: np.ndarray, places: np.ndarray) -> CaseFit:
    return beside_case(case, joint, optimise(joint, vector, places, joint.fitted, max_evaluations=0))


def _far_rows(fit: CaseFit) -> Rows:
    """Rows of each record that lie far off, as few of the record do."""
    out = {}
    for number, white in enumerate(fit.whitened):
        size = np.sqrt(np.mean(white**2, axis=(1, 2)))
        seen = np.isfinite(size)
        if not seen.any():
            continue
        far = np.flatnonzero(seen & (size > AWAY * max(1.0, float(np.median(size[seen])))))
        if 0 < len(far) <= MOST * seen.sum():
            out[number] = tuple(far.tolist())
    return out


def _with_all_rows(fewer: Readings, whole: Readings) -> Readings:
    """Readings as finely resolved as those without some rows."""
    experiment = eqx.tree_at(lambda e: e.noise, fewer.experiment, whole.experiment.noise)
    return replace(whole, experiment=experiment)


def _resolution(readings: Readings) -> object:
    return getattr(readings.experiment, "fineness", None), getattr(readings.experiment, "parts", None)
