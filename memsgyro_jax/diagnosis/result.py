"""What a diagnosis found: verdict, effects, candidates, groups that cannot be told apart, and what to measure next."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from textwrap import indent
from typing import TYPE_CHECKING, Literal

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import finite, json_text
from memsgyro_jax.base.joint_normal import JointNormal
from memsgyro_jax.base.labelled import Labelled, columns_of, labelled
from memsgyro_jax.base.provenance import versions
from memsgyro_jax.base.text import said_in
from memsgyro_jax.device.gyro import SingleMassGyro
from memsgyro_jax.device.resonator import Resonator
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.drive_levels import clear_drives
from memsgyro_jax.measurement.experiments import AbstractRecord
from memsgyro_jax.measurement.model import Model

from .compare import judged
from .describing import consequence, drift_over
from .estimates import whose_forces
from .findings import NOT_HELD, Accepted, Candidate, Prospect, Stage, told_with
from .fit import CaseFit
from .fit_table import effects_table, errors_table, parameters_table, readings_table
from .fitted import ParameterEstimate, errors_figure, with_calibration
from .linear_device import LinearDevice, linear_device
from .settings_apart import in_each_place, moves
from .settings_table import settings_table


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

Verdict = Literal["nothing_missing", "instrument_only", "found", "cannot_tell", "partly_explained", "unknown_effect"]
UNEXPLAINED: tuple[Verdict, ...] = ("partly_explained", "unknown_effect")
ONLY_IF = (
    "without ±: these numbers would hold only if the model explained the records, which they deny; what is missing may "
    "have gone into any of them, and two may cancel"
)
SLIGHTLY = "slightly more than noise"  # within the gate on which the verdict rests, which is wider for what is fitted
DRAW = "memsgyro law {} --out my_law.py"
_PLANNED = 5  # next experiments that are printed


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Labelled):
    """Outcome of `diagnose`; prints itself.

    Args:
        case: what was measured.
        base, final: the base model and the model with all accepted effects, beside every record.
        verdict: one of the words of `Verdict`; `sentence` says it in words.
        accepted: effects of the final model, the strongest first.
        first, candidates: all candidates beside the base model, and those left beside the final one, best first.
        groups: labels that these records cannot tell apart.
        next_experiment: what would decide, or `None`.
        next_experiments: all that are feasible within what was recorded, the best first.
        steps: how the error fell.
        level: probability of a false alarm that was allowed.
        given: labels of the effects that the model had from the beginning.
        tried: where an unknown effect is missing, what was tried and is not enough.
        instrument: terms of the instrument that the records need, beside which everything else is judged.
        scale: factor of all standard deviations of effects: above one where the model leaves more than noise. Where it
            leaves more than any noise explains, none is told.
        outlying: rows of records, from zero, that stand alone and were left out.
        whence: what the base model is that of, where none is near all records: of the lowest drive, or of some
            surroundings; `first` then holds what was followed from there. Empty otherwise.
        noise: of records whose noise is not as declared and explains what is left, how it differs.
    """

    case: Case
    base: CaseFit
    final: CaseFit
    verdict: Verdict
    sentence: str
    accepted: tuple[Accepted, ...]
    first: tuple[Candidate, ...]
    candidates: tuple[Candidate, ...]
    groups: tuple[tuple[str, ...], ...]
    next_experiment: str | None
    steps: tuple[Stage, ...]
    level: float
    given: tuple[str, ...] = ()
    tried: tuple[Stage, ...] = ()
    instrument: tuple[Accepted, ...] = ()
    scale: float = 1.0
    outlying: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    next_experiments: tuple[Prospect, ...] = ()
    noise: Mapping[str, str] = field(default_factory=dict)
    whence: str = ""

    @property
    def unexplained(self) -> bool:
        """Whether the final model leaves more than noise: then no power, no promise and no ± that rests on it holds."""
        return self.verdict in UNEXPLAINED

    @property
    def model(self) -> Model:
        """The final model with the effects it was given, those accepted and what the instrument does."""
        whole, labels = self.final.model, {*self.given, *(a.label for a in (*self.accepted, *self.instrument))}
        return whole.with_only(effect for effect in whole.effects if effect.label in labels)

    @property
    def device(self) -> SingleMassGyro | Resonator:
        """The device of the final model with its effects, as a loop runs it."""
        return self.final.device

    @property
    def uncertainty(self) -> JointNormal:
        """Numbers of `device` that were fitted, by their paths there, with their joint uncertainty.

        **Raises:** `InputError` where something is left unexplained, which may have gone into any of them.
        """
        if self.unexplained:
            raise InputError(
                f"A diagnosis that ends with {self.verdict.replace('_', ' ')} has no uncertainty: what is missing may "
                "have gone into any number; that of a fit, `diagnosis.final.uncertainty`, holds only if nothing has."
            )
        return self.final.uncertainty

    @property
    def laws(self) -> dict[str, str]:
        """By label of an accepted effect or term of the instrument, what it does, as the catalogue says."""
        told = {effect.label: effect.law for effect in self.final.model.effects}
        return {a.label: told.get(a.label, "") for a in (*self.instrument, *self.accepted)}

    @cached_property
    def consequences(self) -> dict[str, str]:
        """By label of an accepted force, what it does to resonance and quality factor at the largest swing of the
        sweeps; of a drift, how long it goes on. Of a model that does not explain the records, nothing.
        """
        if self.unexplained:
            return {}
        effects = {effect.label: effect for effect in self.final.model.effects}
        told = {a.label: consequence(self.final, effects[a.label]) for a in self.accepted if a.label in effects}
        told |= {a.label: drift_over(self.final, effects[a.label]) for a in self.instrument if a.label in effects}
        return {label: text for label, text in told.items() if text}

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the records themselves warn of, as `memsgyro check` prints it."""
        return tuple(warning for record in self.case.records for warning in record.warnings(self.case))

    @cached_property
    def linear(self) -> LinearDevice:
        """The modes of the final base device; where the final model does not explain the records, which drag it, of the
        base device of the lowest drive.
        """
        return linear_device(self.final, self.base, explained=not self.unexplained)

    @property
    def modes(self) -> tuple[ParameterEstimate, ...]:
        """Resonance frequency [Hz] and quality factor of each mode of `linear`."""
        return self.linear.estimates

    @cached_property
    def by_setting(self) -> str:
        """A table of the device in each of its surroundings, where something is left unexplained; else empty."""
        return settings_table(self.case) if self.unexplained else ""

    @property
    def onwards(self) -> tuple[tuple[str, str], ...]:
        """What to look at next where something is left unexplained, each with the command that does; else none."""
        if not self.unexplained:
            return ()
        drawn = "the law that is missing, drawn, written and fitted", DRAW.format(self.case.folder)
        if (levels := len(clear_drives(self.case))) < 2:
            return () if moves(in_each_place(self.case)) else (drawn,)  # what moves it is no law of the amplitude
        fewer = f"memsgyro diagnose {self.case.folder} --drives {(levels + 1) // 2}"
        return drawn, ("what is missing at the lowest drives by themselves", fewer)

    def __str__(self) -> str:
        lines = [f"{self.case.name}: {self.verdict.replace('_', ' ')}", self.sentence, ""]
        if not self.final.optimum.converged:
            lines[2:] = [f"The fit is {self.final.status}: what it says may still move.", ""]
        lines += map(_line, self.steps)
        if self.whence:
            lines.append(f"  ({self.whence})")
        lines += [f"  {mode}" for mode in self.linear.told]
        lines += [f"  outside its design: {one}" for one in self.linear.outside]
        if self.linear.about:
            lines.append(f"  (resonance and quality factor: {self.linear.about})")
        if self.by_setting:
            lines += ["  as each of the surroundings shows it by itself:", indent(self.by_setting, "    ")]
        for a in (*self.instrument, *self.accepted):
            more = "".join(f", {name} {_in_unit(v, s, unit)}" for name, (v, s, unit) in a.numbers.items())
            lines.append(f"  {a.label}: {a.told_in_unit}{with_calibration(a.calibration)}{more}" + _confused(a))
            if about := "; ".join(filter(None, (self.laws.get(a.label), self.consequences.get(a.label)))):
                lines.append(f"    {about}")
        if whose := whose_forces(self.final):
            lines.append(f"  ({whose})")
        if self.unexplained and (self.instrument or self.accepted):
            lines.append(f"  ({ONLY_IF})")
        elif self.scale > 1.0 and not self.unexplained:
            lines.append(f"  (standard deviations times {self.scale:.3g}, as the model leaves more than the noise)")
        if self.tried:
            lines += ["", "  tried, and not enough", *map(_line, self.tried)]
        before = {(e.name, e.role): e.rms for e in self.base.errors}
        lines += ["", "  error over noise, base -> final model"]
        lines += [
            f"  {e.name:<16} {e.role:<10} {before[e.name, e.role]:9.4g} -> {e.rms:.4g}"
            + ("" if e.explained else f"   {self.noise.get(e.name, 'not explained' if self.unexplained else SLIGHTLY)}")
            for e in self.final.errors
        ]
        if rest := judged(self.final).without(self.noise).beside_size:
            lines += ["", f"  {rest}"]
        if self.next_experiment:
            lines += ["", f"  next experiment: {self.next_experiment}"]
            lines += [f"    Δχ² {p.chi2:8.3g}  {p.experiment}" for p in self.next_experiments if p.chi2 >= 0][:_PLANNED]
        lines += ["", *(f"  {what}: {command}" for what, command in self.onwards)] if self.onwards else []
        return "\n".join(lines)

    def to_dict(self) -> dict:
        """Everything in numbers and text, schema `memsgyro-diagnosis/1`."""
        entries = {
            "schema": "memsgyro-diagnosis/1",
            "case": self.case.name,
            "level": self.level,
            "verdict": self.verdict,
            "sentence": self.sentence,
            "base": _fit(self.base, with_std=not self.unexplained),
            "final": _fit(self.final, with_std=not self.unexplained),
            "effects": [_accepted(a) | {"at_largest": self.consequences.get(a.label)} for a in self.accepted],
            "instrument": [_accepted(a) for a in self.instrument],
            "candidates": [asdict(c) for c in self.candidates],
            "candidates_of_base": [asdict(c) for c in self.first],
            "groups": [list(group) for group in self.groups],
            "next_experiment": self.next_experiment,
            "next_experiments": [asdict(p) for p in self.next_experiments],
            "residual": {e.name: e.rms for e in self.final.errors if not (e.explained or e.name in self.noise)},
            "steps": [asdict(s) for s in self.steps],
            "tried": [asdict(s) for s in self.tried],
            "modes": [mode.to_dict() for mode in self.modes],
            "modes_are": self.linear.about,
            "std_scale": self.scale,
            "outlying": {name: list(rows) for name, rows in self.outlying.items()},
            "base_is": self.whence,
            "versions": dict(versions()),
        }
        return finite(entries)

    def to_xarray(self) -> "xr.Dataset":
        """Over `reading` what was measured and what base and final model predict, over `entry` the errors of both, over
        `effect` what was accepted, over `candidate` what was tried beside the final model, over `step` how it came.
        """
        fits = {"_base": self.base, "_final": self.final}
        readings, settings = readings_table(self.case, fits)
        units = {"score": "1", "p_value": "1", "explained_share": "1", "kept_share": "1", "smallest_visible": None}
        tried = columns_of("candidate", self.candidates, **units, unit=None, excited="1")
        variables = {
            **readings,
            **errors_table(fits),
            **parameters_table(self.final, with_std=not self.unexplained),
            **effects_table(self),
            **{f"candidate_{name}": held for name, held in tried.items()},
            "candidate": ("candidate", [c.label for c in self.candidates], None),
            "step": ("step", [s.added or "base model" for s in self.steps], None),
            **columns_of("step", self.steps, chi2_per_dof="1", validation_error="1"),
        }
        about = self.to_dict()
        names = ("schema", "case", "level", "verdict", "sentence", "groups", "next_experiment", "std_scale", "versions")
        return labelled(self, variables, settings, {name: about[name] for name in names})

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Deviation over noise of every record beside the base and the final model; returns the axes."""
        return errors_figure(self.final.errors, ax, before=self.base.errors)

    def to_json(self) -> str:
        """The same as text."""
        return json_text(self.to_dict())


def unfinished(fit: CaseFit, stages: Sequence[Stage]) -> dict:
    """What is known of a case while its diagnosis goes on, in the schema of its result."""
    added = ", ".join(stage.added for stage in stages if stage.added) or "nothing"
    entries = {
        "schema": "memsgyro-diagnosis/1",
        "case": fit.case.name,
        "verdict": "unfinished",
        "sentence": f"The diagnosis has not ended; added so far: {added}.",
        "final": _fit(fit),
        "steps": [asdict(stage) for stage in stages],
        "versions": dict(versions()),
    }
    return finite(entries)


def validation_error(fit: CaseFit) -> float:
    """Root mean square of residual over noise of all validation readings; of all readings where none validates."""
    errors = [e for e in fit.errors if e.role == "validation"] or list(fit.errors)
    return float(np.sqrt(sum(e.chi2 for e in errors) / sum(e.count for e in errors)))


def _line(stage: Stage) -> str:
    kept = stage.added.startswith("without") or " in place of " in stage.added
    label = stage.added if kept else f"+ {stage.added}" if stage.added else "base model"
    return f"  {label:<36} χ²/dof {stage.chi2_per_dof:10.4g}   validation error {stage.validation_error:9.4g} × noise"


def _confused(a: Accepted) -> str:
    return f"; these records cannot tell it from {' or '.join(a.confused_with)}" if a.confused_with else ""


def _fit(fit: CaseFit, *, with_std: bool = True) -> dict:
    return {
        "chi2_per_dof": fit.chi2_per_dof,
        "status": fit.status,
        "per_experiment": [
            {"name": e.name, "role": e.role, "count": e.count, "chi2_per_n": e.chi2 / e.count, "error": e.rms}
            | {"gate": e.gate, "explained": e.explained, "noise_std": _noise(fit.case.record(e.name))}
            for e in fit.errors
        ],
        "parameters": [p.to_dict() | ({} if with_std else {"std": None}) for p in fit.estimates],
    }


def _in_unit(value: float, std: float, unit: str) -> str:
    told = told_with(value, std)
    return told if told == NOT_HELD else said_in(told, unit)


def _noise(record: AbstractRecord) -> dict[str, float]:
    return {"xy"[channel]: float(record.noise_levels[channel]) for channel in record.channels}


def _accepted(a: Accepted) -> dict:
    single = len(a.estimate) == 1
    return {
        "name": a.name,
        "axis": a.where or None,
        "estimate": a.estimate[0] if single else list(a.estimate),
        "std": a.std[0] if single else list(a.std),
        "unit": a.unit,
        "p_value": a.p_value,
        "validation_error_before": a.error_before,
        "validation_error_after": a.error_after,
        "confused_with": list(a.confused_with),
        "calibration": a.calibration,
        "chi2": a.chi2,
        "stopped": any(a.stopped),
        "numbers": {name: {"value": v, "std": s, "unit": unit} for name, (v, s, unit) in a.numbers.items()},
    }
