"""What `memsgyro sweep` does: read the study, sweep, print, write."""

import json
import shutil
from pathlib import Path
from typing import Any

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import write_whole
from memsgyro_jax.montecarlo.sweep import Lot, sweep

from ..study import Study
from .options import chosen_study, require_writable, writing
from .progress import progress


def run(
    study: Path | None,
    rate_record: Path | None,
    out: Path,
    resume: bool,
    overwrite: bool,
    json_file: Path | None,
    **settings: Any,
) -> None:
    """Sweep, print the table, and write `dies.zarr`, `summary.json` and `report.html` into `out`.

    `settings` are entries of the study's section `[sweep]`; None leaves the study's own.
    """
    if resume and overwrite:
        raise InputError("Options `--resume` and `--overwrite` must not be given together; leave one of them out.")
    chosen, notes = chosen_study(study, rate_record, **settings)
    require_writable(out / "summary.json", json_file)
    for note in notes:
        print(note)
    with writing(out, "make room or choose another folder, then go on with `--resume`"):
        lot = _sweep(chosen, out, resume, overwrite)
        _write(lot, chosen, out, json_file)
    print(lot)
    print(f"{out / 'report.html'}, summary.json and dies.zarr hold the details.")


def _sweep(study: Study, out: Path, resume: bool, overwrite: bool) -> Lot:
    store = out / "dies.zarr"
    if overwrite:
        shutil.rmtree(store, ignore_errors=True)
    try:
        with progress("dies", "compiling") as show:
            return sweep(**study.sweep_arguments, out=out, resume=resume, progress=show)
    finally:
        shutil.rmtree(store.with_name(f"{store.name}.part"), ignore_errors=True)


def _write(lot: Lot, study: Study, out: Path, json_file: Path | None) -> None:
    from ..report.sweep_page import sweep_page

    text = json.dumps(lot.summary.as_dict(), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    page = sweep_page(lot, study).html()
    for path in {out / "summary.json", json_file or out / "summary.json"}:
        write_whole(path, text)
    write_whole(out / "report.html", page)
