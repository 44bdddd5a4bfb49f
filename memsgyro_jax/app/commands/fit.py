"""`memsgyro fit`: fit the base model, add the effects that are named, refit, say what it helped, write."""

from pathlib import Path

from .diagnose import load_demo_or, look_for
from .flags import Words


def fit_command(
    case: Path,
    /,
    *,
    add: Words = (),
    effects: Path | None = None,
    kinds: Path | None = None,
    out: Path | None = None,
    json: Path | None = None,
) -> None:
    """Fit the base model, or one with named effects, to a measurement case.

    Prints the error of every experiment before and after, also of those that are not fitted.
    A few rows that stand alone, without which the model explains the case,
    are named and left out.

    Args:
        case: folder with a case.toml and the CSV files that it names, or the word demo for the one that comes along.
        add: names of effects, each with its variant ("cubic_stiffness x") or alone for all its variants, and of what
            the instrument does: reference_phase, lock_in_feedthrough, lock_in_background, gain_drift and others.
            Without it the base model alone is fitted.
        effects: a Python file with effects of your own, at the strengths to start from. It is run: trust it first.
        kinds: a Python file with kinds of measurement of your own. It is run: trust it first.
        out: file for the fitted model, for `memsgyro compare --model` and for the device of a study.
        json: file for the machine-readable result.
    """
    look_for(case, effects, kinds)
    from memsgyro_jax.base.files import write_json
    from memsgyro_jax.base.text import listed
    from memsgyro_jax.diagnosis.compare import beside_outlying, judged
    from memsgyro_jax.diagnosis.fit import fit_case
    from memsgyro_jax.diagnosis.instrument import every_term
    from memsgyro_jax.diagnosis.outlying import fit_without
    from memsgyro_jax.effects import catalogue, every_effect, load_effects
    from memsgyro_jax.measurement.calibration import units_of_records
    from memsgyro_jax.measurement.model_file import write_model
    from memsgyro_jax.measurement.user_kinds import load_kinds

    from ..report.fit_text import fit_entries, fit_text, named_effects, placed_by_scan
    from .options import require_writable
    from .progress import told

    require_writable(out, json)
    measured = load_demo_or(case, load_kinds(kinds) if kinds else ())
    own = load_effects(effects, measured.channels, as_written=True) if effects else ()
    known = (*catalogue(measured.channels), *own, *every_term(measured))
    others = [e for e in every_effect(measured.channels) if e.label not in {one.label for one in known}]
    chosen = named_effects(add, known, others) if add or own else ()
    with told() as tell:
        tell("fit the base model")
        before = fit_case(measured)
        after = before
        if chosen:
            tell(f"base model: χ²/dof {before.chi2_per_dof:.4g}; fit it with {listed([e.label for e in chosen])}")
            after = fit_case(measured, [placed_by_scan(effect, before) for effect in chosen])
        found = beside_outlying(judged(after), lambda rows: fit_without(after, rows))
    print(fit_text(before, found))
    if out is not None:
        write_model(found.model, out, note=units_of_records(measured))
        ended = "the fitted device" if found.fit.optimum.converged else "the device where the fit stopped, not its best"
        print(f"{out} is {ended}, for `compare --model` and for the section [device] of a study")
    if json is not None:
        write_json(json, fit_entries(before, found))
