"""The page of a diagnosis: what is missing from the model, how much it helps, and what the records cannot tell."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from memsgyro_jax.base.text import beside, listed
from memsgyro_jax.diagnosis.compare import as_times, judged
from memsgyro_jax.diagnosis.estimates import whose_forces
from memsgyro_jax.diagnosis.findings import Accepted, Candidate, told_with
from memsgyro_jax.diagnosis.found_force import LawOverWaveform, found_forces
from memsgyro_jax.diagnosis.residual_force import beside_lowest_drive, rate_residuals, sweep_forces, time_forces
from memsgyro_jax.diagnosis.result import ONLY_IF, Diagnosis
from memsgyro_jax.measurement.calibration import unit_of_records
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.channel_noise import spoken_levels

from . import diagnosis_figures as figures
from . import force_figures
from .page import Page
from .record_settings import settings_in_words


VERDICTS = {
    "nothing_missing": "nothing is missing",
    "instrument_only": "the instrument explains it",
    "found": "the missing effect was found",
    "cannot_tell": "these records cannot tell which effect is missing",
    "partly_explained": "partly explained",
    "unknown_effect": "an unknown law is missing",
}
_FEW = 2  # steps, whose errors the table of effects tells
_BEST = 12  # candidates of the base model that are listed


def diagnosis_page(diagnosis: Diagnosis) -> Page:
    """Build the page of a diagnosis."""
    out = Page(f"Diagnosis of {diagnosis.case.name}", diagnosis.case.description)
    out.section(f"Verdict: {VERDICTS[diagnosis.verdict]}").text(diagnosis.sentence)
    if told := diagnosis.linear.told:
        about = f" ({diagnosis.linear.about})" if diagnosis.linear.about else ""
        out.text(f"Of the linear device{about}: {'; '.join(told)}.")
    for one in diagnosis.linear.outside:
        out.text(f"Outside its design: {one}.")
    _effects(out, diagnosis)
    for figure, caption in _found_figures(diagnosis):
        out.figure(figure, caption)
    if diagnosis.next_experiment:
        out.text(f"What to measure next: {diagnosis.next_experiment}.")
    for warning in diagnosis.warnings:
        out.text(f"Warning: {warning}")
    _planned(out, diagnosis)
    if len(diagnosis.steps) > _FEW:
        names = "; ".join(f"step {k}: {_added(s.added)}" for k, s in enumerate(diagnosis.steps) if k)
        out.figure(figures.steps_figure(diagnosis.steps), f"How the error fell. {names}.")
    _errors(out, diagnosis)
    _records(out, diagnosis)
    if diagnosis.unexplained:
        for what, command in diagnosis.onwards:
            out.text(f"{what[0].upper()}{what[1:]}: `{command}`.")
        _forces(out, diagnosis)
    _tried(out, diagnosis)
    _ranking(out, diagnosis)
    _blind(out, diagnosis)
    _parameters(out, diagnosis)
    out.text(f"Fit: {diagnosis.final.status}. Probability of a false alarm that was allowed: {diagnosis.level:g}.")
    return out


def _parameters(out: Page, diagnosis: Diagnosis) -> None:
    held = [replace(p, std=diagnosis.scale * p.std) for p in diagnosis.final.estimates]
    known = [p for p in (*(() if diagnosis.unexplained else diagnosis.modes), *held) if np.isfinite(p.std)]
    out.section("Parameters of the final model")
    if diagnosis.unexplained:
        rows = [[p.name, told_with(p.value, np.nan), p.unit] for p in known]
        out.table(["parameter", "value", "unit"], rows, f"They are told {ONLY_IF}.")
    else:
        rows = [[p.name, beside(p.value, p.std), f"{p.std:.2g}", p.unit] for p in known]
        out.table(["parameter", "value", "± 1 σ", "unit"], rows)
    if loose := [p.name for p in held if not np.isfinite(p.std)]:
        out.text(f"Not held by these records: {listed(loose)}.")


def _effects(out: Page, diagnosis: Diagnosis) -> None:
    if diagnosis.accepted:
        out.table(
            ["effect", "estimate", "95 % interval", "unit", "error before", "error after", "not told apart from"],
            [_effect(a) for a in diagnosis.accepted],
            "Effects of the final model; errors are those of readings that were not fitted, over the noise."
            + (f" Intervals are {diagnosis.scale:.3g} times those of the noise, as the model leaves more."
               if diagnosis.scale > 1.0 and not diagnosis.unexplained else ""),
        )  # fmt: skip
    if diagnosis.unexplained and (diagnosis.accepted or diagnosis.instrument):
        out.text(f"The strengths of effects and terms of the instrument are told {ONLY_IF}.")
    for label, law in diagnosis.laws.items():
        if about := "; ".join(filter(None, (law, diagnosis.consequences.get(label)))):
            out.text(f"{label}: {about}.")
    if whose := whose_forces(diagnosis.final):
        out.text(f"{whose[0].upper()}{whose[1:]}.")
    if len(diagnosis.accepted) > 1:
        weights = (f"{a.label} {as_times(a.chi2)}" for a in diagnosis.accepted)
        out.text(f"χ² that the final model would leave more without each: {'; '.join(weights)}.")


def _planned(out: Page, diagnosis: Diagnosis) -> None:
    if diagnosis.next_experiments:
        out.table(
            ["feasible experiment", "would tell or show", "expected Δχ²"],
            [
                [p.experiment, p.told + p.where, as_times(p.chi2) if p.chi2 >= 0 else "–"]
                for p in diagnosis.next_experiments
            ],
            "Within what was recorded: conditions as they were varied, drives up to twice the largest. Expected Δχ² "
            "between the two once the experiment is added, with everything else refitted to first order.",
        )


def _tried(out: Page, diagnosis: Diagnosis) -> None:
    """An appendix: the effects that come nearest to a law that is not known."""
    if diagnosis.tried:
        out.section("What was tried").table(
            ["effect", "χ²/dof", "error of what was not fitted"],
            [[_added(s.added), f"{s.chi2_per_dof:.4g}", as_times(s.validation_error)] for s in diagnosis.tried],
            "One after the other, and not enough: a strength fitted here is that of a model which is wrong.",
        )


def _effect(a: Accepted) -> list[str]:
    spans = (_interval(e, 1.96 * s) for e, s in zip(a.estimate, a.std, strict=True))
    return [
        a.label,
        ", ".join(told.partition(" ±")[0] for told in a.told(4)),
        "; ".join(spans),
        a.unit,
        as_times(a.error_before),
        as_times(a.error_after),
        ", ".join(a.confused_with) or "–",
    ]


def _interval(middle: float, half: float) -> str:
    if np.isnan(half):
        return "not told"
    return f"{beside(middle - half, half, 4)} to {beside(middle + half, half, 4)}" if np.isfinite(half) else "not held"


def _added(label: str) -> str:
    return label if label.startswith("without") else f"with {label}"


def _errors(out: Page, diagnosis: Diagnosis) -> None:
    out.section("Error of every experiment")
    before = {(e.name, e.role): e for e in diagnosis.base.errors}
    rows = [
        [
            e.name,
            "fitted" if e.role == "fit" else "not fitted",
            e.count,
            as_times(before[e.name, e.role].rms),
            as_times(e.rms),
            f"{np.sqrt(e.gate):.3g}",
            "yes" if e.explained else diagnosis.noise.get(e.name, "no"),
        ]
        for e in diagnosis.final.errors
    ]
    header = ["experiment", "rows", "readings", "base model", "final model", "noise alone below", "explained"]
    out.table(header, rows, "Root mean square of the deviation over the noise; 1 is the noise floor.")
    unit = "" if diagnosis.case.readout.unit == "1" else f" {diagnosis.case.readout.unit}"
    for record in diagnosis.case.records:
        if levels := spoken_levels(record, unit):
            out.text(f"The rows of {record.name} told each channel's own noise: {levels}.")
    comparison = judged(diagnosis.final).without(diagnosis.noise)
    if not comparison.checks:
        return
    out.text(comparison.beside_size or f"{comparison.verdict.rstrip(':.')}.")
    for failure in comparison.failures:
        out.text(failure)


def _records(out: Page, diagnosis: Diagnosis) -> None:
    out.section("Measured and predicted")
    for axis in range(diagnosis.case.channels):
        together = figures.per_drive_figure(diagnosis.final.deviations, axis, diagnosis.case.words.force)
        if together is None:
            continue
        caption = f"All sweeps of {'xy'[axis]} over their drive: points measured, lines the final model."
        out.figure(together, f"{caption} What is linear falls on one curve.")
    pairs = list(zip(diagnosis.base.deviations, diagnosis.final.deviations, strict=True))
    settings = settings_in_words([record for (record, _), _ in pairs], diagnosis.case)
    for ((record, base), (_, final)), taken_at in zip(pairs, settings, strict=True):
        overlay = record.overlay(base, final)
        if any(view.curves for view in overlay.views):
            figure = figures.overlay_figure(record, base, final, overlay.views)
        else:
            figure = figures.residual_figure(base, final, overlay.views)
        about = "; ".join(filter(None, (overlay.caption, taken_at)))
        out.figure(figure, f"{record.name}: {about}." if about else f"{record.name}.")


def _ranking(out: Page, diagnosis: Diagnosis) -> None:
    out.section("Candidates")
    out.table(
        ["candidate beside the base model", "χ² it explains", "share of the misfit", "p-value", "own part"],
        [_candidate(c) for c in diagnosis.first if c.excited][:_BEST],
        "Best first. The p-value takes all candidates into account; the own part is what no free parameter imitates."
        + " Each was followed, refitted, from where the base model is near to all records; the others bring less there."
        * bool(diagnosis.whence),
    )
    left = [c for c in diagnosis.candidates if c.p_value <= diagnosis.level and c.excited][:_BEST]
    if left:
        out.table(
            ["candidate beside the final model", "χ² it explains", "share of the misfit", "p-value", "own part"],
            [_candidate(c) for c in left],
            "Still significant, but not needed or not better than what was taken.",
        )


def _candidate(c: Candidate) -> list[str]:
    p = f"{c.p_value:.2g}" if c.p_value >= 1e-12 else "< 1e-12"
    kept = f"{100 * c.kept_share:.3g} %" if np.isfinite(c.kept_share) else "–"
    return [c.label, as_times(c.score), f"{100 * c.explained_share:.3g} %", p, kept]


def _blind(out: Page, diagnosis: Diagnosis) -> None:
    out.section("What these records can and cannot tell")
    for group in diagnosis.groups:
        out.text(f"Cannot be told apart: {', '.join(group)}.")
    blind = [c.label for c in diagnosis.candidates if not c.excited]
    if blind:
        out.text(f"Cannot be seen at all, because nothing that was varied excites them: {', '.join(blind)}.")
    seen = [[c.label, f"{c.smallest_visible:.2g}", c.unit] for c in diagnosis.candidates if c.excited]
    if seen and diagnosis.unexplained:
        out.text(
            "How strong an effect must be to be found is not told: only a model that explains the records could tell, "
            "and beside what is missing here even a strong effect may stay unseen."
        )
    elif seen:
        out.table(
            ["effect absent from the final model", "smallest visible strength", "unit"],
            sorted(seen),
            "Each would have been found with a probability of 90 % if it were this strong.",
        )


def _forces(out: Page, diagnosis: Diagnosis) -> None:
    """What the base model lacks, as forces: what wrong effects leave of a law is hard to read."""
    out.section("The force that is missing").text(
        "What the base model, fitted to the lowest drive where there are several, would need to move as it was seen to "
        "move: a threshold shows as a kink. A law that fits these points is an effect of "
        "one's own in about ten lines; --effects takes its file."
    )
    drawn = list(_force_figures(diagnosis))
    for figure, caption in drawn:
        out.figure(figure, caption)
    if not drawn:
        out.text("No record shows it as a force above its noise.")


def _found_figures(diagnosis: Diagnosis) -> Iterator[tuple[Figure, str]]:
    """Each accepted law beside what the records show of it."""
    length, force, stiffness, damping = _units(diagnosis.case)
    for accepted, found in found_forces(diagnosis):
        if isinstance(found, LawOverWaveform):
            slow = found.over == "velocity"
            across = f"velocity [{length[1]}/ms]" if slow else f"displacement [{length[1]}]"
            factors = (1e-3 * length[0] if slow else length[0], force[0])
            labels = (across, f"force beyond a straight line [{force[1]}]")
        else:
            unit = {"stiffness": stiffness, "damping": damping}[found.part]
            factors, labels = (length[0], 1.0), (f"amplitude [{length[1]}]", f"{found.part} [{unit}]")
        figure = force_figures.found_figure(found, factors, labels)
        yield figure, f"{accepted.label}, as {found.record} shows it."


def _units(case: Case) -> tuple[tuple[float, str], tuple[float, str], str, str]:
    """In which a picture shows displacement and force, each as factor and unit, stiffness and damping."""
    told = [unit_of_records(case, unit) for unit in ("m", "N", "N/m", "N s/m")]
    length = (1e6, "µm") if told[0] == "m" else (1.0, told[0])
    return length, ((1e9, "nN") if told[1] == "N" else (1.0, told[1])), told[2], told[3]


def _force_figures(diagnosis: Diagnosis) -> Iterator[tuple[Figure, str]]:
    """Each picture of a force that stands out of the noise, and its caption."""
    base, (motion, force, *units) = beside_lowest_drive(diagnosis.base), _units(diagnosis.case)
    for sweep in sweep_forces(base):
        for axis in force_figures.shown_axes(sweep):
            along = "xy"[sweep.axis]
            caption = (
                f"{sweep.record}: force on {'xy'[axis]} as stiffness and damping, F = −k·{along} − d·d{along}/dt, "
                "against the amplitude of the driven axis and the settings; a lighter point is a stronger drive. "
                "Points that the noise makes uncertain are left out."
            )
            yield force_figures.sweep_figure(sweep, axis, motion, *units), caption
    for course in time_forces(base):
        for axis in range(base.model.axes):
            if course.force[:, axis].any():
                figure = force_figures.time_figure(course, axis, motion, force)
                yield figure, f"{course.record}: force on {'xy'[axis]} near the resonances."
    unexplained = {e.name for e in diagnosis.base.errors if not e.explained}
    for left in rate_residuals(diagnosis.base):
        if left.record in unexplained:
            figure = force_figures.residual_rate_figure(left, diagnosis.case.readout.unit)
            yield figure, f"{left.record}: what is left, in phase with displacement and velocity of the driven axis."
