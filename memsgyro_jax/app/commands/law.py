"""`memsgyro law`: draw the law that no catalogue holds, write it as an effect, add it, say what it helped."""

from pathlib import Path
from typing import Literal

from .diagnose import load_demo_or, look_for
from .flags import Flag, Words


def law_command(
    case: Path,
    /,
    *,
    out: Path | None = None,
    edited: Path | None = None,
    axis: Literal["x", "y"] = "x",
    add: Words = (),
    terms: int = 3,
    spline: Flag = False,
    kinds: Path | None = None,
    model: Path | None = None,
    report: Path | None = None,
) -> None:
    """Draw an unknown law from a measurement case, write it as an effect file, and fit with it.

    Prints frequency and damping against amplitude, the law, and the error of every
    experiment without and with it, also of those that are not fitted.
    Edit the file and fit it again with `memsgyro law CASE --edited FILE`.

    Args:
        case: folder with a case.toml and the CSV files that it names, or the word demo for the one that comes along.
        out: file for the law, a Python file with one effect per term.
        edited: instead of `--out`, such a file, edited, to fit from where the drawing leaves off. It is run.
        axis: that the law is drawn for.
        add: names of effects that are known to be there too, as `memsgyro fit --add` takes them ("thermal_drift
            stiffness", say): they are fitted to the lowest drive, and the law is drawn beside them.
        terms: at most so many terms.
        spline: forces between knots instead of terms with a free exponent and a threshold.
        kinds: a Python file with kinds of measurement of your own. It is run: trust it first.
        model: file for the fitted model, for `memsgyro compare --model`.
        report: file for a page with the backbone, the law and the errors.
    """
    look_for(case, kinds, edited)
    from memsgyro_jax.base.errors import InputError
    from memsgyro_jax.base.files import write_whole
    from memsgyro_jax.diagnosis.backbone import backbone
    from memsgyro_jax.diagnosis.compare import beside_outlying, judged
    from memsgyro_jax.diagnosis.fit import fit_case
    from memsgyro_jax.diagnosis.instrument import every_term
    from memsgyro_jax.diagnosis.law import draw_law
    from memsgyro_jax.diagnosis.law_fit import (
        beside_known,
        fit_law,
        of_the_catalogue,
        with_even_part,
        with_held_terms,
    )
    from memsgyro_jax.diagnosis.leak import leak_past
    from memsgyro_jax.diagnosis.outlying import fit_without
    from memsgyro_jax.effects import catalogue
    from memsgyro_jax.measurement.calibration import units_of_records
    from memsgyro_jax.measurement.drive_levels import clear_drives
    from memsgyro_jax.measurement.model_file import write_model
    from memsgyro_jax.measurement.user_kinds import load_kinds

    from ..report.fit_text import fit_text, named_effects
    from .options import require_writable

    require_writable(out, model, report)
    if (out is None) == (edited is None):
        raise InputError("Either option `--out`, for the law, or `--edited`, a law to fit, must be given.")
    if not 1 <= terms <= 9:
        raise InputError(f"Option `--terms` must be 1 to 9, but is {terms}.")
    measured, number = load_demo_or(case, load_kinds(kinds) if kinds else ()), "xy".index(axis)
    if number >= measured.channels:
        raise InputError(f"Option `--axis` must be x for a device of one axis, but is {axis}.")
    chosen = named_effects(add, (*catalogue(measured.channels), *every_term(measured))) if add else ()
    before = fit_case(measured)
    beside = beside_known(measured, chosen) if chosen or len(clear_drives(measured)) > 1 else before
    if leak := leak_past(beside, number):
        print(
            "The rows show what leaks past the device in proportion to the drive: drawn beside lock_in_feedthrough.\n"
        )
        chosen = (*chosen, *leak)
        beside = beside_known(measured, chosen)
    curve, law = backbone(beside, number), draw_law(beside, number, terms=terms, spline=spline)
    print(curve, end="\n\n", flush=True)
    after, file = before, edited or out
    if file is not None and edited is not None:
        after = fit_law(law, file)
    elif file is not None and law.names:
        after = fit_law(law, law.write(file))
        if (held := with_held_terms(law, after)).terms and held is not law:
            law, after = held, fit_law(held, held.write(file))
        if (whole := with_even_part(law, after)) is not law:
            law, after = whole, fit_law(whole, whole.write(file))
    if edited is None:
        print(law, end="\n\n" if law.names else "\n")
    if after is not before:
        of_all = after
        found = beside_outlying(judged(of_all), lambda rows: fit_without(of_all, rows))
        after = found.fit
        print(fit_text(before, found))
    if after is not before and edited is None:
        more = "".join(f' --add "{effect.label}"' for effect in chosen)
        for name, label in of_the_catalogue(law, after).items():
            print(f'{name} is what the catalogue has as {label}: memsgyro fit {case} --add "{label}"{more}')
        print(f"{file} is the law; edit it, then: memsgyro law {case} --edited {file}{more}")
    if model is not None:
        write_model(after.model, model, note=units_of_records(measured))
    if report is not None:
        from ..report.law_page import law_page

        write_whole(report, law_page(curve, law, before, after).html())
