"""What `memsgyro diagnose` does: read a case, find what is missing from its model, print, write."""

from importlib.resources import as_file, files
from pathlib import Path

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import write_whole
from memsgyro_jax.diagnosis.diagnose import diagnose
from memsgyro_jax.effects import Effect, load_effects
from memsgyro_jax.measurement.case import Case, load_case
from memsgyro_jax.measurement.case.file import FILE
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.model_file import model_text, read_model

from .options import require_writable
from .progress import told


DEMO = Path("demo")


def run(
    case: Path,
    model: Path | None = None,
    effects: Path | None = None,
    out: Path | None = None,
    json: Path | None = None,
    report: Path | None = None,
    level: float = 0.05,
) -> None:
    """Diagnose, print, and write what was asked for, once all of it is computed."""
    require_writable(out, json, report)
    measured = load(case)
    own = load_effects(effects, measured.channels) if effects else ()
    start = None if model is None else _start(model, measured, own)
    with told() as tell:
        found = diagnose(start, measured, effects=own, level=level, tell=tell)
    texts: list[tuple[Path, str]] = []
    if out is not None:
        texts.append((out, model_text(found.model)))
    if json is not None:
        texts.append((json, found.to_json() + "\n"))
    if report is not None:
        from ..report.diagnosis_page import page

        texts.append((report, page(found).html()))
    for path, text in texts:
        write_whole(path, text)
    print(found)


def load(case: Path) -> Case:
    """The case in a folder; `demo` where there is no such case is the demonstration that comes with the package."""
    if case == DEMO and not (case / FILE).exists():
        with as_file(files("memsgyro_jax") / "demo") as folder:
            return load_case(folder)
    return load_case(case)


def _start(path: Path, case: Case, own: tuple[Effect, ...]) -> Model:
    model = read_model(path, own)
    if model.axes != case.channels:
        raise InputError(
            f"{path}: must have as many axes as the case {case.name} has channels, {case.channels}, "
            f"but has {model.axes}."
        )
    return model
