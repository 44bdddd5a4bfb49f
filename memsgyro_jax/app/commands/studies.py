"""`memsgyro studies`: lists the studies, runs them, and writes the table of all rows."""

import json
import sys
import time
from collections.abc import Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import TYPE_CHECKING

from .processes import Running, pool_of_processes, run_logged


if TYPE_CHECKING:
    from memsgyro_jax.app.claims import StudyScript

FAILED = 1


def studies_command(
    *names: str, quick: bool = False, out: Path = Path("studies/out"), jobs: int | None = None, page: Path | None = None
) -> None:
    """Lists the studies by section and figure of the thesis and the paper, or runs them and tabulates every row.

    Without a name nothing runs. A study that fails is said and does not stop the others; the exit status is then 1.

    Args:
        names: the studies to run, or `all`.
        quick: fewer seeds and shorter runs.
        out: folder for one folder per study, `claims.md` and `claims.json`; the table keeps what earlier runs
            left there.
        jobs: how many studies run at a time. Without it one, of quick runs one per core up to four: they compile
            more than they compute, which takes one core.
        page: folder of a documentation, `docs` of a clone: the table with small copies of the pictures goes there, from
            the runs in `out` where no name is given. It keeps what it tells of studies that `out` has no run of, and
            of a full run where the new one is quick.
    """
    from memsgyro_jax.app.claims import all_studies, claims, markdown, write_page
    from memsgyro_jax.base.errors import InputError
    from memsgyro_jax.base.runtime import usable_cores

    studies = all_studies()
    if not names:
        if page is None:
            _list(studies)
        else:
            write_page(claims(out, studies), out, page)
        return
    known = {study.name for study in studies}
    for name in set(names) - known - {"all"}:
        raise InputError(f"Argument `names` must hold studies or `all`, but `{name}` is none: see `memsgyro studies`.")
    jobs = (min(usable_cores(), 4) if quick else 1) if jobs is None else jobs
    if jobs < 1:
        raise InputError(f"Argument `jobs` must be at least 1, but is {jobs}.")
    failed = _run([s for s in studies if "all" in names or s.name in names], quick=quick, out=out, jobs=jobs)
    found = claims(out, studies)
    (out / "claims.json").write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    if page is not None:
        write_page(found, out, page)
    (out / "claims.md").write_text(markdown(found), encoding="utf-8")
    print(f"All rows: {out / 'claims.md'}")
    if failed:
        print(f"Failed: {', '.join(sorted(failed))}. See log.txt in the study's folder.")
        sys.exit(FAILED)


def _list(studies: Sequence["StudyScript"]) -> None:
    from rich import print as show
    from rich.markup import escape
    from rich.table import Table

    table = Table("section", "study", "rows", "figures", "question", title="studies")
    for study in studies:
        told = study.place, study.name, ", ".join(study.answers), ", ".join(study.figures), study.question
        table.add_row(*map(escape, told))
    show(table)
    print("Run one with `memsgyro studies NAME`, all with `memsgyro studies all`; `--quick` takes minutes.")


def _run(studies: Sequence["StudyScript"], *, quick: bool, out: Path, jobs: int) -> list[str]:
    """Runs each in a process of its own, a line of progress for each; the names of those that failed."""
    failed, spent, begun = [], 0.0, time.monotonic()
    with pool_of_processes(jobs) as (pool, running):
        # From the end: studies that are in no document take longest, and a long one begun last would run alone.
        waiting = {pool.submit(_run_one, each, quick, out / each.name, running): each for each in reversed(studies)}
        for count, future in enumerate(as_completed(waiting), 1):
            study, (seconds, reason) = waiting[future], future.result()
            print(f"[{count}/{len(studies)}] {study.name}: {reason or 'done'} ({seconds:.0f} s)", flush=True)
            spent += seconds
            if reason:
                failed.append(study.name)
    print(f"{len(studies)} studies in {time.monotonic() - begun:.0f} s; one after the other {spent:.0f} s", flush=True)
    return failed


def _run_one(study: "StudyScript", quick: bool, folder: Path, running: Running) -> tuple[float, str]:
    """Seconds, and why it failed, if it did."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("answers.json", "failed.json"):
        (folder / name).unlink(missing_ok=True)
    begun = time.monotonic()
    command = [str(study.path), "--out", str(folder), *(["--quick"] if quick else [])]
    reason = run_logged(command, running, folder / "log.txt")
    if not reason:
        return time.monotonic() - begun, ""
    told = json.dumps({"failed": f"its study {reason}"}, ensure_ascii=False)
    (folder / "failed.json").write_text(told, encoding="utf-8")
    return time.monotonic() - begun, reason
