"""Coupling errors of a gyroscope from frequency sweeps, each with its uncertainty and a verdict whether these sweeps
hold it.
"""

from collections.abc import Mapping, Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.runtime import require_float64
from memsgyro_jax.measurement.experiments import CartesianNoise, Noise, PolarNoise
from memsgyro_jax.measurement.least_squares import gate
from memsgyro_jax.measurement.noise import noise_beside_misfit

from .frequency_sweep import FrequencySweep
from .likelihood import fit_sweeps, refit
from .modal import SingleMode, coupled_poles
from .record import SweepRecord
from .result import CouplingCoefficient, Identification
from .sense_view import SeenBench
from .tree_fit import Fit
from .wrong_rows import without_wrong_rows


# What a sweep may show beyond two linear modes, by its name in the catalogue of effects: the switch of the fit that
# models it.
EFFECTS: Mapping[str, str] = {"electrical_feedthrough": "leak", "finite_sweep_rate": "moving"}


def identify(
    records: Sequence[SweepRecord],
    *,
    noise: Noise | None = None,
    mass: float | None = None,
    effects: Sequence[str] = (),
) -> Identification:
    """Maximum likelihood on both complex responses of every sweep, jointly with modes, gain ratio and phase asymmetry.

    A row that stands alone, as a wrong digit leaves it, is named in the notes and left out.

    Args:
        records: one or several sweeps of one device, with the x electrode, the y electrode or each of them driven.
        noise: of every reading; `None` estimates it from the scatter of neighbouring points.
        mass: of the mode [kg]; without it cxy and kxy are per unit mass.
        effects: of `EFFECTS`, to be modelled too.

    **Raises:** `InputError` in float32, for unknown effects, for too short records.
    """
    require_float64("Identification")
    _check(records, mass, effects)
    sweeps = tuple(sweep_of(record, noise) for record in records)
    estimate = noise is None
    (outcome, sweeps), wrong = without_wrong_rows(
        sweeps, records, partial(_fit, effects=effects, estimate=estimate), partial(_again, estimate=estimate)
    )
    repairs = {}
    if outcome.chi2_per_dof > gate(outcome.dof):
        for name in EFFECTS.keys() - set(effects):
            other, _ = _fit(sweeps, (*effects, name), noise is None)
            repairs[name] = float(other.chi2_per_dof)
    return _judged(outcome, sweeps, mass, tuple(effects), repairs, (*wrong, *_notes(records, noise, mass)))


def sweep_of(record: SweepRecord, noise: Noise | None = None) -> FrequencySweep:
    """The experiment of a record; without `noise` one with the shape of its format, to be scaled later."""
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


def _notes(records: Sequence[SweepRecord], noise: Noise | None, mass: float | None) -> tuple[str, ...]:
    notes = [note for record in records for note in record.notes]
    if noise is None:
        notes.append("The noise was estimated from the scatter of neighbouring points.")
    if mass is None:
        notes.append("Without a mass, c_xy and k_xy are per unit mass.")
    return tuple(dict.fromkeys(notes))


def _judged(
    outcome: Fit,
    sweeps: tuple[FrequencySweep, ...],
    mass: float | None,
    effects: tuple[str, ...],
    repairs: Mapping[str, float],
    notes: tuple[str, ...],
) -> Identification:
    chi2 = float(outcome.chi2_per_dof)
    estimates = jax.tree.map(np.asarray, _estimates(outcome))
    readout = _readout(*estimates["readout"])
    doubt = _doubt(outcome, sweeps, chi2, repairs, readout["phase_asymmetry_deg"].std)
    return Identification(
        coefficients=_coefficients(estimates["couplings"], outcome, sweeps, mass, doubt),
        modal=_modal(*estimates["modal"]),
        readout=readout,
        chi2_per_dof=chi2,
        dof=outcome.dof,
        method="maximum likelihood",
        effects=effects,
        repairs=repairs,
        notes=notes,
        effect_values=_effect_values(estimates),
        status=outcome.status,
        fit=outcome,
        sweeps=sweeps,
        mass=mass,
    )


def _doubt(
    outcome: Fit, sweeps: Sequence[FrequencySweep], chi2: float, repairs: Mapping[str, float], phase_std: float
) -> str:
    """Why no coefficient of this fit can be trusted, or the empty string."""
    if chi2 > gate(outcome.dof):
        text = f"not trusted: two linear modes miss the record (chi2/dof {chi2:.3g})"
        cures = [
            name for name, value in sorted(repairs.items(), key=lambda item: item[1]) if value <= gate(outcome.dof)
        ]
        return text + (f"; add {' or '.join(cures)}" if cures else "")
    # A flat likelihood keeps the optimiser walking: what is open then is the data, not the method.
    if not phase_std < 30.0 or outcome.open_parameters() or not (bool(outcome.converged) or _covers(outcome, sweeps)):
        return f"not identified by this sweep: {_advice(outcome, sweeps)}"
    return "" if bool(outcome.converged) else "not trusted: the fit did not converge"


def _covers(outcome: Fit, sweeps: Sequence[FrequencySweep]) -> bool:
    """Whether some sweep passes each of both resonances."""
    poles = np.asarray(coupled_poles(outcome.values.device).imag)
    spans = [(float(sweep.frequency.min()), float(sweep.frequency.max())) for sweep in sweeps]
    return all(any(low < pole < high for low, high in spans) for pole in poles)


def _advice(outcome: Fit, sweeps: Sequence[FrequencySweep]) -> str:
    """What would help: the resonance that the sweeps leave out, else better data."""
    return "more points or less noise are needed" if _covers(outcome, sweeps) else "sweep both resonances"


def _couplings(seen: SeenBench) -> jnp.ndarray:
    device = seen.device
    return jnp.stack([device.force_yx, device.force_xy, device.damping_coupling, device.stiffness_coupling])


def _modes(seen: SeenBench) -> jnp.ndarray:
    coupled = SingleMode.of_pole(coupled_poles(seen.device))
    turns = jnp.stack([seen.omega, coupled.omega]) / (2 * jnp.pi)
    return jnp.stack([turns, jnp.stack([seen.quality, coupled.quality])], axis=1)


@eqx.filter_jit
def _estimates(outcome: Fit) -> dict[str, tuple[jnp.ndarray, jnp.ndarray]]:
    """Value and standard deviation of everything reported, in one compiled function."""
    functions = {
        "couplings": _couplings,
        "modal": _modes,
        "readout": lambda seen: jnp.stack([seen.readout.gain_ratio, jnp.rad2deg(seen.readout.phase_asymmetry)]),
    }
    seen = outcome.values
    if seen.sweep_rate is not None:
        functions["sweep_speed"] = lambda seen: seen.sweep_rate.strength / (2 * jnp.pi)
    if seen.feedthrough is not None and seen.feedthrough.x_drive is not None:
        functions["x_leak"] = lambda seen: seen.feedthrough.x_drive
    if seen.feedthrough is not None and seen.feedthrough.y_drive is not None:
        functions["y_leak"] = lambda seen: seen.feedthrough.y_drive
    return {name: (function(seen), outcome.std_of(function)) for name, function in functions.items()}


def _coefficients(
    estimate: tuple[np.ndarray, np.ndarray],
    outcome: Fit,
    sweeps: Sequence[FrequencySweep],
    mass: float | None,
    doubt: str,
) -> dict[str, CouplingCoefficient]:
    scale = np.array([1.0, 1.0, mass or 1.0, mass or 1.0])
    value, std = (part * scale for part in estimate)
    device = outcome.values.device
    # What each could be at most: λ of order one, |cxy| ≤ √(cxx·cyy), |kxy| ≤ √(kxx·kyy).
    ceiling = scale * np.array([1.0, 1.0, np.sqrt(np.prod(device.omega / device.quality)), np.prod(device.omega)])
    units = ("1", "1", "N*s/m", "N/m") if mass else ("1", "1", "1/s", "1/s^2")
    axes = {sweep.axis for sweep in sweeps}
    out = {}
    for i, name in enumerate(("lambda_yx", "lambda_xy", "c_xy", "k_xy")):
        if i < 2 and i not in axes:
            electrode = "xy"[i]
            out[name] = CouplingCoefficient(
                None, None, units[i], f"not identified by this sweep: drive the {electrode} electrode too"
            )
        else:
            verdict = doubt or _verdict(value[i], std[i], ceiling[i], lambda: _advice(outcome, sweeps))
            out[name] = CouplingCoefficient(float(value[i]), float(std[i]), units[i], verdict)
    return out


def _verdict(value: float, std: float, ceiling: float, advice) -> str:
    """Identified to a tenth, roughly, bounded near zero, or not at all."""
    if not std < 0.1 * ceiling:
        return f"not identified by this sweep: {advice()}"
    if std <= 0.1 * abs(value):
        return "identified"
    if std <= abs(value) / 3:
        return f"identified roughly (± {100 * std / abs(value):.0f} %)"
    return f"not distinguishable from zero (|value| below {abs(value) + 2 * std:.2g} at 95 %)"


def _modal(value: np.ndarray, std: np.ndarray) -> dict[str, CouplingCoefficient]:
    out = {}
    for axis, letter in enumerate("xy"):
        for i, (label, what) in enumerate((("", "uncoupled axis"), ("pole_", "coupled resonance"))):
            out[f"{label}f_{letter}"] = CouplingCoefficient(
                float(value[i, 0, axis]), float(std[i, 0, axis]), "Hz", what
            )
            out[f"{label}q_{letter}"] = CouplingCoefficient(float(value[i, 1, axis]), float(std[i, 1, axis]), "1", what)
    return out


def _readout(value: np.ndarray, std: np.ndarray) -> dict[str, CouplingCoefficient]:
    return {
        "gain_ratio": CouplingCoefficient(float(value[0]), float(std[0]), "1", "sense over drive channel"),
        "phase_asymmetry_deg": CouplingCoefficient(float(value[1]), float(std[1]), "deg", "sense less drive channel"),
    }


def _effect_values(estimates: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> dict[str, CouplingCoefficient]:
    out = {}
    if "sweep_speed" in estimates:
        value, std = estimates["sweep_speed"]
        out["sweep_speed"] = CouplingCoefficient(float(value), float(std), "Hz/s", "finite_sweep_rate")
    for axis in "xy":
        if f"{axis}_leak" not in estimates:
            continue
        value, std = estimates[f"{axis}_leak"]
        for channel, part in np.ndindex(2, 2):
            name = f"leak_{'xy'[channel]}_{'IQ'[part]}_{axis}_driven"
            out[name] = CouplingCoefficient(
                float(value[channel, part]),
                float(std[channel, part]),
                "1",
                "electrical_feedthrough, record unit per drive",
            )
    return out
