"""Coupling errors of a gyroscope from frequency sweeps, each with its uncertainty and a verdict whether these sweeps
hold it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.runtime import require_float64
from memsgyro_jax.measurement.exchanged_axes import all_exchanged, phasors_of_sweep, refuse, surely_exchanged
from memsgyro_jax.measurement.experiments import CartesianNoise, Noise, Phasors, PolarNoise
from memsgyro_jax.measurement.noise import noise_beside_misfit

from .doubts import Explanation, doubt, rivals
from .estimates import channel_values, coefficients, effect_values, estimates, modal, products
from .frequency_sweep import FrequencySweep
from .likelihood import fit_sweeps, refit
from .record import SweepRecord
from .result import Identification
from .sense_view import SeenBench
from .tree_fit import Fit
from .wrong_rows import without_wrong_rows


# What a sweep may show beyond two linear modes, by its name in the catalogue of effects: the switch of the fit that
# models it.
EFFECTS: Mapping[str, str] = {
    "electrical_feedthrough": "leak",
    "finite_sweep_rate": "moving",
    "readout_delay": "late",
    "frequency_offset": "apart",
}


BETWEEN = "frequency_offset"  # what sweeps differ by, and one alone cannot

# What no sweep can tell: the pick-offs are what the axes are known by.
RELATIVE = (
    "Angles and couplings are relative to the axes of the pick-offs: a turn or crosstalk of these counts as lambda and "
    "k_xy, a rate during the sweep that the file does not tell as phase asymmetry and c_xy."
)


def identify(
    records: Sequence[SweepRecord],
    *,
    noise: Noise | None = None,
    mass: float | None = None,
    effects: Sequence[str] = (),
) -> Identification:
    """Maximum likelihood on both complex responses of every sweep, jointly with modes, gain ratio and phase asymmetry.

    A row that stands alone, as a wrong digit leaves it, is named in the notes and left out. Angles and couplings are
    relative to the axes of the pick-offs: a turn or crosstalk of these counts as λ and kxy, and a rate during the sweep
    that the record does not tell as phase asymmetry and cxy.

    Sweeps that two linear modes miss are fitted with each effect, and the verdicts name what explains them. Where an
    effect is modelled, each other one is tried in its place: what is explained as well so, is not trusted.

    Args:
        records: one or several sweeps of one device, with the x electrode, the y electrode or each of them driven.
        noise: of every reading; `None` estimates it from the scatter of neighbouring points.
        mass: of the mode [kg]; without it cxy and kxy are per unit mass.
        effects: of `EFFECTS`, to be modelled too.

    **Raises:** `InputError` in float32, for unknown effects, for too short records, for sweeps of which some
    read as if x and y were exchanged.
    """
    require_float64("Identification")
    _check(records, mass, effects)
    refuse(surely_exchanged(_told(records)))
    sweeps = tuple(sweep_of(record, noise, number) for number, record in enumerate(records))
    known = [name for name in EFFECTS if len(records) > 1 or name != BETWEEN]
    estimate = noise is None
    (outcome, sweeps), wrong = without_wrong_rows(
        sweeps, records, partial(_fit, effects=effects, estimate=estimate), partial(_again, estimate=estimate)
    )
    own = Explanation.of(effects, outcome)
    repairs = {}
    if not own.explains:
        for name in [name for name in known if name not in effects]:
            every = (*effects, name)
            repairs[name] = Explanation.of(every, _fit(sweeps, every, estimate)[0])
    told = estimates(outcome)
    others = rivals(own, told["couplings"][1], known, lambda every: _fit(sweeps, every, False)[0])
    why = doubt(outcome, sweeps, repairs, others, float(told["readout"][1][1]))
    found = _judged(outcome, told, sweeps, mass, why)
    return replace(
        found,
        effects=tuple(effects),
        repairs={name: one.chi2_per_dof for name, one in repairs.items()},
        notes=(*wrong, *_notes(records, noise, mass)),
    )


def sweep_of(record: SweepRecord, noise: Noise | None = None, number: int = 0) -> FrequencySweep:
    """The experiment of a record, one of several by its number from 0; without `noise` one with the shape of its
    format, to be scaled later.
    """
    if noise is None:
        noise = (
            PolarNoise(jnp.full(2, 1e-3), jnp.full(2, 1e-3))
            if record.polar
            else CartesianNoise(jnp.full(2, np.abs(record.phasors).max() * 1e-3))
        )
    return FrequencySweep(
        record.name,
        record.frequency,
        record.phasors,
        noise,
        drive=record.drive,
        start=record.start,
        axis=record.axis,
        rate=record.rate,
        number=number,
    )


def _fit(
    sweeps: tuple[FrequencySweep, ...], effects: Sequence[str], estimate: bool
) -> tuple[Fit, tuple[FrequencySweep, ...]]:
    switches = {switch: name in effects for name, switch in EFFECTS.items()}
    outcome = fit_sweeps(sweeps, **switches)
    return _again(outcome.values, _with_scatter(outcome, sweeps), True) if estimate else (outcome, sweeps)


def _again(
    start: SeenBench, sweeps: tuple[FrequencySweep, ...], estimate: bool
) -> tuple[Fit, tuple[FrequencySweep, ...]]:
    """A further fit from a start; to estimate the noise takes some."""
    outcome = refit(start, sweeps)
    for _ in range(2 if estimate else 0):
        sweeps = _with_scatter(outcome, sweeps)
        outcome = refit(outcome.values, sweeps)
    return outcome, sweeps


def _with_scatter(outcome: Fit, sweeps: tuple[FrequencySweep, ...]) -> tuple[FrequencySweep, ...]:
    """The sweeps with their noise scaled to the scatter of neighbouring residuals."""
    position, out = 0, []
    for sweep in sweeps:
        size = 4 * len(sweep.frequency)
        rows = np.asarray(outcome.residual[position : position + size]).reshape(-1, 2, 2)
        scatter = noise_beside_misfit(rows)
        position += size
        if isinstance(sweep.noise, PolarNoise):
            noise: Noise = PolarNoise(sweep.noise.amplitude * scatter[:, 0], sweep.noise.phase * scatter[:, 1])
        elif isinstance(sweep.noise, CartesianNoise):
            noise = CartesianNoise(sweep.noise.std * jnp.sqrt(jnp.mean(scatter**2, axis=1)))
        out.append(eqx.tree_at(lambda s: s.noise, sweep, noise))
    return tuple(out)


def _check(records: Sequence[SweepRecord], mass: float | None, effects: Sequence[str]) -> None:
    if not records:
        raise InputError("Argument `records` must hold at least one sweep, but is empty.")
    for record in records:
        if len(record.frequency) < 20:
            raise InputError(
                f"{record.name}: a sweep must have at least 20 rows to be identified, but has {len(record.frequency)}."
            )
    if len({record.unit for record in records}) > 1:
        raise InputError(
            "Argument `records` must share one unit of the channels, but they are in "
            + ", ".join(r.unit for r in records)
            + "."
        )
    if mass is not None and not (np.isfinite(mass) and mass > 0):
        raise InputError(f"Argument `mass` must be a positive number of kilograms, but is {mass}.")
    for name in effects:
        if name not in EFFECTS:
            raise InputError(f"Argument `effects` must be among {', '.join(EFFECTS)}, but is {name}.")
    if BETWEEN in effects and len(records) == 1:
        raise InputError(f"Effect `{BETWEEN}` must have two sweeps to lie between, but there is one; leave it out.")


def _notes(records: Sequence[SweepRecord], noise: Noise | None, mass: float | None) -> tuple[str, ...]:
    notes = [note for record in records for note in record.notes]
    notes += [f"{said[0].upper()}{said[1:]}."] if (said := all_exchanged(_told(records))) else []
    notes.append(RELATIVE)
    if noise is None:
        notes.append("The noise was estimated from the scatter of neighbouring points.")
    if mass is None:
        notes.append("Without a mass, c_xy and k_xy are per unit mass.")
    return tuple(dict.fromkeys(notes))


def _told(records: Sequence[SweepRecord]) -> list[tuple[str, Phasors | None]]:
    """The phasors of each sweep, by name."""
    return [(r.name, phasors_of_sweep(r.frequency, r.phasors, r.axis, r.drive)) for r in records]


def _judged(
    outcome: Fit,
    told: Mapping[str, tuple[np.ndarray, np.ndarray]],
    sweeps: tuple[FrequencySweep, ...],
    mass: float | None,
    why: str,
) -> Identification:
    """What a fit tells, with a verdict each; `why` is the doubt about all of it."""
    channels = channel_values(*told["readout"])
    ratio, std = (float(part[0]) for part in told["readout"])
    held = {} if std < 0.1 * ratio else products(told["products"], sweeps, mass)
    return Identification(
        coefficients=coefficients(told["couplings"], outcome, sweeps, mass, why),
        modal=modal(*told["modal"]),
        readout={**channels, **held},
        chi2_per_dof=float(outcome.chi2_per_dof),
        dof=outcome.dof,
        method="maximum likelihood",
        effect_values=effect_values(told, sweeps),
        status=outcome.status,
        fit=outcome,
        sweeps=sweeps,
        mass=mass,
    )
