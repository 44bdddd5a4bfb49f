"""What effects added to a fit have helped, for people and for machines."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import finite
from memsgyro_jax.base.provenance import versions
from memsgyro_jax.base.text import aligned
from memsgyro_jax.diagnosis.compare import Comparison, as_times
from memsgyro_jax.diagnosis.drives import FAR
from memsgyro_jax.diagnosis.estimates import told_of
from memsgyro_jax.diagnosis.fit import CaseFit
from memsgyro_jax.diagnosis.result import DRAW
from memsgyro_jax.diagnosis.scans import coverage, scan
from memsgyro_jax.effects import Effect, Scanned, by_name
from memsgyro_jax.effects.section import settings_of


SCHEMA = "memsgyro-fit/1"
WORSE = 1.01  # times the χ² without what was added: more than another resolution of the same model makes


def named_effects(names: Sequence[str], known: Sequence[Effect], whole: Sequence[Effect] = ()) -> tuple[Effect, ...]:
    """The effects of names as a user writes them: "cubic_stiffness x" and "cubic_stiffness" "x" are one variant, as are
    "reference_phase by record" and its words; "cubic_stiffness" alone is all of them. Those that are in `whole` and not
    in `known` have to be named with their variant.

    **Raises:** `InputError` where nothing is named, or what is named is not known.
    """
    if not names:
        raise InputError("Option `--add` must name at least one effect, but names none; `memsgyro effects` lists them.")
    words = [word for name in names for word in name.replace(".", " ").split()]
    places = {e.where for e in (*known, *whole) if e.where}
    found: list[Effect] = []
    while words:
        word = words.pop(0)
        following = next((w for n in (2, 1) if (w := " ".join(words[:n])) in places), "")
        words = words[len(following.split()) :]
        same = [effect for effect in known if effect.name == word]
        same = [effect for effect in same if not effect.where] or same  # a term for all records, not one for each
        if following or not same:
            same = [by_name(word, following, among=(*known, *whole))]
        found += [effect for effect in same if effect.label not in {f.label for f in found}]
    return tuple(found)


def placed_by_scan(effect: Effect, base: CaseFit) -> Effect:
    """An effect with a frequency, moment or limit to be tried first starts at the best point of its grid."""
    if not isinstance(effect, Scanned):
        return effect
    readings = base.joint.fitted
    best = scan(base.model, base.optimum, readings, effect.grid(coverage(base.case)))
    if best is None:
        raise InputError(
            f"Effect `{effect.label}` must be visible in the records to be fitted, but no record shows it."
        )
    return best.effect


def fit_text(before: CaseFit, found: Comparison) -> str:
    """A fit without effects and one with them, as it was judged, side by side; the one where nothing was added."""
    after = found.fit
    names = _added(before, after)
    fits = {"base": before if names else after} | ({f"with {', '.join(names)}": after} if names else {})
    head = ("experiment", "role", *fits, "noise alone below")
    rows = [
        (a.name, a.role, *(as_times(fit.errors[k].rms) for fit in fits.values()), f"{np.sqrt(a.gate):.3g}")
        for k, a in enumerate(after.errors)
    ]
    chi2 = f"χ²/dof of the fitted readings {' -> '.join(as_times(fit.chi2_per_dof) for fit in fits.values())}"
    lines = [f"{after.case.name}: {after.status}; {chi2}", "rms of deviation over noise:", aligned([head, *rows])]
    lines += [found.verdict, *(f"  {failure}" for failure in found.failures)]
    lines += [f"  {line}" for line in (found.alone, short_of_its_valley(before, after)) if line] + ["Fitted:"]
    lines += told_of(after)
    lines += [f"  {label}, held: {_listed(held)}" for label, held in _held(after).items()]
    return "\n".join(lines)


def _added(before: CaseFit, after: CaseFit) -> list[str]:
    """Labels of the effects that a fit has beside those of one without them, as of what its case declares unsure."""
    held = {effect.label for effect in before.model.effects}
    return [effect.label for effect in after.model.effects if effect.label not in held]


def short_of_its_valley(before: CaseFit, after: CaseFit) -> str:
    """A sentence where a fit with effects has surely, or may have, stopped short of where it fits best; else empty.

    A law with a corner or an exponent has a narrow valley, beside which no strength is right.
    """
    joint = after.joint
    shaped = [p.name for i, p in enumerate(joint.parameters) if i in joint.numbers and i in after.optimum.free]
    nearer = f"start {', '.join(shaped)} nearer"
    if not any(name.startswith("drawn_") for name in shaped):
        nearer += f"; `{DRAW.format(after.case.folder)}` draws thresholds and exponents to start from"
    remedy = nearer if shaped else "start its strength from another value"
    if after.optimum.chi2 > WORSE * before.optimum.chi2 and joint.model.effects:
        return f"It fits worse than without what was added, as no larger model does at its best: {remedy}."
    if shaped and after.chi2_per_dof > FAR:
        return f"It may have stopped beside the valley of {', '.join(shaped)}, which is narrow: {remedy}."
    return ""


def fit_entries(before: CaseFit, found: Comparison) -> dict[str, Any]:
    """The machine-readable result, schema `memsgyro-fit/1`; numbers that are not finite become null."""
    after = found.fit
    estimates = {p.name: p for p in after.estimates}
    of_effects = [p.name for p in after.joint.parameters if p.effect is not None and p.name in estimates]
    entries = {
        "schema": SCHEMA,
        "case": after.case.name,
        "status": after.status,
        "added": _added(before, after),
        "before": _fit(before),
        "after": _fit(after),
        "explained": found.explained,
        "short_of_its_valley": short_of_its_valley(before, after),
        "outlying": {after.case.records[number].name: list(rows) for number, rows in found.left_out.items()},
        "effects": [estimates[name].to_dict() for name in of_effects],
        "held": _held(after),
        "std_scale": after.scale,
        "parameters": [p.to_dict() for p in after.estimates if p.name not in of_effects],
        "versions": dict(versions()),
    }
    return finite(entries)


def _held(fit: CaseFit) -> dict[str, dict[str, float]]:
    """Numbers of each effect that are not fitted, in SI: a frequency that was scanned, the moment of a step."""
    free = {(fit.joint.model.effects[p.effect].label, p.field) for p in fit.joint.parameters if p.effect is not None}
    held = {
        e.label: {
            name: float(getattr(e, name))
            for name in settings_of(e)
            if (e.label, name) not in free and np.ndim(getattr(e, name)) == 0
        }
        for e in fit.model.effects
    }
    return {label: values for label, values in held.items() if values}


def _listed(values: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.6g}" for name, value in values.items())


def _fit(fit: CaseFit) -> dict[str, Any]:
    return {"chi2_per_dof": fit.chi2_per_dof, "experiments": [e.to_dict() for e in fit.errors]}
