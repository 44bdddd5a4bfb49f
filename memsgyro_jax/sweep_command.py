"""What `memsgyro sweep` does: read the study, sweep, print, write."""

import json
import shutil
from pathlib import Path
from typing import Any

from .files import write_whole
from .progress import progress
from .study_options import chosen_study, require_writable, writing
from .sweep import Lot, sweep


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
    chosen, notes = chosen_study(study, rate_record, **settings)
    require_writable(out / "summary.json", json_file)
    for note in notes:
        print(note)
    store = out / "dies.zarr"
    if overwrite and not resume:
        shutil.rmtree(store, ignore_errors=True)
    with writing(store, "make room or choose another folder, then go on with `--resume`"):
        try:
            with progress("dies", "compiling") as show:
                lot = sweep(**chosen.sweep_arguments, out=out, resume=resume, progress=show)
        finally:
            shutil.rmtree(store.with_name(f"{store.name}.part"), ignore_errors=True)
        print(_table(lot))
        _write(lot, chosen, out, json_file)
    print(f"{out / 'report.html'}, summary.json and dies.zarr hold the details.")


def _table(lot: Lot) -> str:
    return repr(lot)


def _write(lot: Lot, study: Any, out: Path, json_file: Path | None) -> None:
    from .report.sweep_page import sweep_page

    text = json.dumps(lot.summary.as_dict(), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    page = sweep_page(lot, study).html()
    for path in {out / "summary.json", json_file or out / "summary.json"}:
        write_whole(path, text)
    write_whole(out / "report.html", page)
