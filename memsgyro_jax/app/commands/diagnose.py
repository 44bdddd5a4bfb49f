"""`memsgyro diagnose`: read a case, find what is missing from its model, print, write."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from memsgyro_jax.base.errors import InputError

from .cases import cases_in, only_of_folders, over_cases


if TYPE_CHECKING:
    from memsgyro_jax.diagnosis.findings import Stage
    from memsgyro_jax.diagnosis.fit import CaseFit
    from memsgyro_jax.effects import Effect
    from memsgyro_jax.measurement.case import AbstractRecord, Case
    from memsgyro_jax.measurement.model import Model


DEMO = Path("demo")


def diagnose_command(
    case: Path,
    /,
    *,
    model: Path | None = None,
    effects: Path | None = None,
    kinds: Path | None = None,
    drives: int | None = None,
    level: float = 0.05,
    thorough: bool = False,
    out: Path | None = None,
    json: Path | None = None,
    report: Path | None = None,
    jobs: int = 1,
    dask: str | None = None,
) -> None:
    """Which physics is missing from the model of a measurement case, or that none is.

    Prints a verdict, the effects that the model needs with their strengths,
    how far the error falls, also on records that are not fitted,
    and what to measure next where these records cannot tell.
    Of a folder that holds folders of cases it diagnoses each, and tabulates their verdicts.

    Args:
        case: folder with a case.toml and the CSV files that it names, the word demo for the one that comes along, or a
            folder of such folders.
        model: a model file to start from, with the effects it has; without it the base model is fitted.
        effects: a Python file with effects of your own, tried beside the catalogue. It is run: trust it first.
        kinds: a Python file with kinds of measurement of your own. It is run: trust it first.
        drives: how many of the lowest drive levels are looked at, and no record that is driven harder: what is missing
            there is told by itself where another law sets in above it.
        level: probability that an effect is reported where none is missing.
        thorough: go on for as long as it takes, also where nothing has come near what was read.
        out: file for the fitted model, for `memsgyro compare --model`; of many cases the folder, `diagnose-out` without
            this option, for the model, the result and the page of each and for the table. What is there is not done
            again. Of a single case the best model so far is there after each step.
        json: file for the machine-readable result, unfinished after each step, of many cases for their table.
        report: file for a page with the ranking, the curves and the residual.
        jobs: how many of many cases are diagnosed at a time.
        dask: address of a Dask scheduler whose workers diagnose many cases, one a task, and write into the folder.
    """
    if cases_in(case):
        if report is not None:
            raise InputError("Option `--report` must go with a single case; of many each has its page in the folder.")
        options = {"model": model, "effects": effects, "kinds": kinds, "drives": drives, "level": level}
        options |= {"thorough": thorough}
        made = {"--out": "model.toml", "--json": "diagnosis.json", "--report": "report.html"}
        return over_cases("diagnose", case, out, options=options, made=made, jobs=jobs, dask=dask, table=json)
    only_of_folders(jobs=jobs, dask=dask)
    look_for(case, model, effects, kinds)
    from memsgyro_jax.base.files import json_text, write_whole
    from memsgyro_jax.diagnosis.diagnose import diagnose
    from memsgyro_jax.diagnosis.result import DRAW, unfinished
    from memsgyro_jax.effects import load_effects
    from memsgyro_jax.measurement.calibration import units_of_records
    from memsgyro_jax.measurement.drive_levels import lowest_drives
    from memsgyro_jax.measurement.model_file import model_text
    from memsgyro_jax.measurement.user_kinds import load_kinds

    from .options import require_writable
    from .progress import told

    require_writable(out, json, report)
    measured = load_demo_or(case, load_kinds(kinds) if kinds else ())
    measured = measured if drives is None else lowest_drives(measured, drives)
    own = load_effects(effects, measured.channels) if effects else ()
    start = None if model is None else _start(model, measured, own)

    so_far = _SoFar()

    def keep(fit: "CaseFit", stages: "Sequence[Stage]") -> None:
        so_far.best = fit, stages
        if out is not None:
            note = "unfinished: the best model so far\n" + units_of_records(measured)
            write_whole(out, model_text(fit.model, note=note))
        if json is not None:
            write_whole(json, json_text(unfinished(fit, stages)) + "\n")

    more = {"--effects": effects, "--kinds": kinds}
    told_level, told_thorough = None if level == 0.05 else level, "" if thorough else None
    searched = {"--drives": drives, "--level": told_level, "--thorough": told_thorough, "--out": out, "--json": json}
    with so_far.said_at_the_end(case, more, searched), told() as tell:
        tell = so_far.heard(tell)
        found = diagnose(start, measured, effects=own, level=level, thorough=thorough, tell=tell, keep=keep)
    texts: list[tuple[Path, str]] = []
    if out is not None:
        texts.append((out, model_text(found.model, note=units_of_records(measured))))
    if json is not None:
        texts.append((json, json_text(found.to_dict()) + "\n"))
    if report is not None:
        from ..report.diagnosis_page import diagnosis_page

        texts.append((report, diagnosis_page(found).html()))
    for path, text in texts:
        write_whole(path, text)
    print(found)
    if drives is not None and found.accepted and not found.unexplained:
        known = "".join(f' --add "{effect.label}"' for effect in found.accepted)
        print(f"  beside it, the law that is missing at the other drives: {DRAW.format(case)}{known}")
    return None


class _SoFar:
    """What is known while a diagnosis goes on: the best fit with how it came, and the candidates it looks at."""

    def __init__(self) -> None:
        self.best: tuple[CaseFit, Sequence[Stage]] | None = None
        self.candidates: list[str] = []

    def heard(self, tell: Callable[[str], None]) -> Callable[[str], None]:
        """`tell`, of which the candidates are remembered."""
        from memsgyro_jax.diagnosis.search import INSTRUMENT, LOOK

        def listening(text: str) -> None:
            if text.startswith((LOOK, INSTRUMENT)):
                self.candidates = text.removeprefix(LOOK).removeprefix(INSTRUMENT).split(", ")
            tell(text)

        return listening

    @contextmanager
    def said_at_the_end(self, case: Path, more: Mapping[str, Any], searched: Mapping[str, Any]) -> Iterator[None]:
        """Says on standard error what is known, where it stands and how to go on, if the work is told to end or cannot
        go on.

        Args:
            case: that is diagnosed.
            more: options that `fit` takes too.
            searched: those of a diagnosis alone, with the files that are written after each step.
        """
        try:
            yield
        except InputError:
            raise
        except BaseException:
            print("\n".join(self._lines(case, more, searched)), file=sys.stderr, flush=True)
            raise

    def _lines(self, case: Path, more: Mapping[str, Any], searched: Mapping[str, Any]) -> Iterator[str]:
        if self.best is None:
            yield "Ended before the base model was fitted: nothing is known yet."
            return
        fit, stages = self.best
        labels = [effect.label for effect in fit.model.present.effects]
        errors = f"{stages[0].validation_error:.4g} -> {stages[-1].validation_error:.4g} × noise"
        yield f"Unfinished; added so far: {', '.join(labels) or 'nothing'}; validation error {errors}."
        candidates = [label for label in self.candidates if label not in labels]
        if candidates:
            yield f"Candidates in hand: {', '.join(candidates)}."
        if written := [str(searched[option]) for option in ("--out", "--json") if searched[option]]:
            yield f"Written so far: {', '.join(written)}."
        if labels and searched["--out"]:
            begun = {"--model": searched["--out"], **searched, **more}
            yield f"To go on: memsgyro diagnose {_quoted(case)}{_options(begun)}"
        elif wanted := labels or candidates[:1]:
            yield f"To go on: memsgyro fit {_quoted(case)} --add {' '.join(map(_quoted, wanted))}{_options(more)}"


def _options(values: Mapping[str, Any]) -> str:
    """The options that are given, as they are typed."""
    typed = (f" {option} {_quoted(value)}".rstrip() for option, value in values.items() if value is not None)
    return "".join(typed)


def _quoted(word: Any) -> str:
    """A word of a command line, in quotes where a shell would take it for several."""
    return f'"{word}"' if " " in str(word) else str(word)


def look_for(case: Path, *others: Path | None) -> None:
    """Raises the error of a file that is not there, before seconds are spent on what would read it."""
    folder = [] if case == DEMO else [case if case.is_file() else case / "case.toml"]
    for path in (*folder, *filter(None, others)):
        path.stat()


def load_demo_or(case: Path, kinds: "Sequence[type[AbstractRecord]]" = ()) -> "Case":
    """The case in a folder; `demo` where there is no such case is the demonstration that comes with the package."""
    from memsgyro_jax.measurement.case import load_case
    from memsgyro_jax.measurement.case.file import FILE

    if case == DEMO and not (case / FILE).exists():
        with as_file(files("memsgyro_jax") / "demo") as folder:
            return load_case(folder, kinds=kinds)
    return load_case(case, kinds=kinds)


def _start(path: Path, case: "Case", own: "tuple[Effect, ...]") -> "Model":
    from memsgyro_jax.measurement.model_file import read_model

    model = read_model(path, own)
    if model.axes != case.channels:
        raise InputError(
            f"{path}: must have as many axes as the case {case.name} has channels, {case.channels}, "
            f"but has {model.axes}."
        )
    return model
