"""Predictions that are resolved: a kink needs more harmonics than a smooth law, a strong law shorter steps in time."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Array

from memsgyro_jax.base.runtime import usable_cores
from memsgyro_jax.base.threads import in_threads
from memsgyro_jax.measurement.experiments import Readings
from memsgyro_jax.measurement.experiments.base import Experiment
from memsgyro_jax.measurement.model import Model

from .linearised import compiled


TOLERANCE = 0.1  # of a standard deviation, or of what is left of a reading that lies farther off: so far a finer
# resolution may move it
UNSURE = 3.0  # of the same: so far noise moves no reading but a few, and a finer resolution might change what is said


def sharpened(
    model: Model, readings: Sequence[Readings], residual: np.ndarray | None = None
) -> tuple[tuple[Readings, ...], float]:
    """The readings at the first resolution that a finer one confirms, for a fitted model; `readings` itself if that is
    theirs.

    Every experiment that has a finer one (a sweep: 3, 7 and 15 harmonics at 32, 128 and 512 samples a period; a record
    in time: steps of 0.1 rad, and halves of them) is predicted at both, and goes on until they agree within `TOLERANCE`
    of the noise, or of what is left where the model explains no better. `residual` is that of the fitted ones as they
    are, where it is known. Also by how many such units the worst still differs from the step before; zero where all
    agree.
    """
    bare, worst = model.present, 0.0
    chosen: dict[int, int] = {}
    if bare.is_linear and bare.is_read_linearly:  # it needs the first harmonic alone
        return tuple(readings), 0.0
    fitted = [r for r in readings if r.fitted]
    known: dict[int, np.ndarray] = {}
    if residual is not None:
        parts = np.split(np.nan_to_num(residual), np.cumsum([r.size for r in fitted])[:-1])
        known = {id(r): part for r, part in zip(fitted, parts, strict=True)}
    kinds = list({type(r.experiment): None for r in readings if r.experiment.finer is not None})
    every = [[r for r in readings if type(r.experiment) is kind] for kind in kinds]
    with in_threads(min(usable_cores(), len(kinds))) as over:  # each has programs of its own, which run once
        told = over(lambda mine: _steps(bare, [(r.experiment, known.get(id(r))) for r in mine if r.fitted]), every)
        for mine, (steps, apart) in zip(every, told, strict=True):
            worst = max(worst, apart if apart > TOLERANCE else 0.0)
            chosen |= {id(r): steps for r in mine}
    finer = tuple(_finer(r, chosen.get(id(r), 0)) for r in readings)
    return finer if any(chosen.values()) else tuple(readings), worst


def still_apart(model: Model, readings: Sequence[Readings]) -> float:
    """By how much a resolution beyond the last may move a reading of a model that was fitted with the finest, in units
    of `sharpened`; zero where all agree.

    What was seen before that fit is no measure of it: a model that fits badly swings otherwise, and then differs more.
    """
    return sharpened(model, [r.changed(lambda e: e.coarse) for r in readings])[1]


def in_words(apart: float) -> str:
    """What `still_apart` says; empty where all agree."""
    if apart <= 0:
        return ""
    head, remedy = "", ""
    if apart > UNSURE:
        head = "predictions are not resolved: "
        remedy = ', less without the records that are driven hardest (`role = "validation"`)'
    return (
        f"{head}they have the most harmonics and the shortest steps that there are; still more would move a reading by "
        f"up to about {apart:.2g} × noise{remedy}"
    )


def _steps(model: Model, known: Sequence[tuple[Experiment, np.ndarray | None]]) -> tuple[int, float]:
    """How many times finer all of them must be, and by how much a reading may still be wrong: what the next step would
    move, if the steps go on as they shrink.
    """
    values, steps, apart, before = (
        [_residual(model, e) if value is None else value for e, value in known],
        0,
        0.0,
        np.inf,
    )
    finer = [e.finer for e, _ in known]
    while finer and all(e is not None for e in finer):
        again = [_residual(model, e) for e in finer if e is not None]
        before, apart = (
            apart or np.inf,
            max(
                float(np.max(np.abs(a - b) / np.maximum(np.abs(a), 1.0), initial=0.0))
                for a, b in zip(values, again, strict=True)
            ),
        )
        if apart <= TOLERANCE:
            break
        values, steps = again, steps + 1
        finer = [e.finer for e in finer if e is not None]
    return steps, apart * min(apart / before, 1.0) if before < np.inf else apart


def _finer(readings: Readings, steps: int) -> Readings:
    for _ in range(steps):
        readings = readings.changed(lambda e: e.finer or e)
    return readings


def _predicted(model: Model, experiment: Experiment) -> Array:
    return experiment.residual(model)


_compiled = compiled(_predicted)


def _residual(model: Model, experiment: Experiment) -> np.ndarray:
    return np.nan_to_num(np.asarray(_compiled(model, experiment)))
