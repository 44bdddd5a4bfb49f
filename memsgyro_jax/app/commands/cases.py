"""A command over a folder of cases: a process for each, what is done is kept, and one table of all of them."""

import hashlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import write_json, write_whole
from memsgyro_jax.base.text import aligned, printable

from .processes import Running, pool_of_processes, run_logged


FILE, FAILED = "case.toml", 1
PROGRAM = ("-m", "memsgyro_jax.app.cli")
SCHEMA = "memsgyro-cases/1"


@dataclass(frozen=True)
class CaseAnswer:
    """What a command says of a case: `done` with its verdict, or `failed` with the reason as the sentence; `key` tells
    what it was computed from.
    """

    case: str
    status: str
    verdict: str
    sentence: str
    seconds: float
    key: str


def cases_in(folder: Path) -> list[Path]:
    """The folders of cases below one that is no case itself; none where it is one."""
    if not folder.is_dir() or (folder / FILE).exists():
        return []
    return sorted(path.parent for path in folder.rglob(FILE))


def only_of_folders(**options: object) -> None:
    """Raises `InputError` for options that a single case has no use for."""
    for name, value in options.items():
        if value not in (None, 1):
            raise InputError(f"Option `--{name}` must go with a folder of cases, but this is a single one.")


def over_cases(
    command: str, folder: Path, out: Path | None, *, options: Mapping[str, object], made: Mapping[str, str], jobs: int,
    dask: str | None, table: Path | None,
) -> None:  # fmt: skip
    """Runs `memsgyro` `command` on every case below `folder`, `jobs` at a time or on the workers of a Dask scheduler,
    and prints what is found of each, then the table; exits with 1 where a case failed.

    What a case gives stands in a folder of its own name in `out`, with the files that the options `made` write, and is
    not computed again as long as the case, the `options` and the package are the same; a failed case is tried again.
    Raises `InputError` for fewer than one job, or jobs beside Dask.
    """
    if jobs < 1 or (dask and jobs > 1):
        found = f"is {jobs}" if jobs < 1 else "Dask was named, which shares the work itself"
        raise InputError(f"Option `--jobs` must be at least 1, and 1 with `--dask`, but {found}.")
    out = out or Path(f"{command}-out")
    given = [part for name, value in options.items() for part in _as_typed(name, value)]
    names = {str(case.relative_to(folder)): case for case in cases_in(folder)}
    keys = {name: _key(case, command, given) for name, case in names.items()}
    kept = {name: answer for name in names if (answer := _kept(out / name, keys[name]))}
    tasks = [(name, str(case.resolve()), keys[name]) for name, case in names.items() if name not in kept]
    run = partial(_answered, command=command, out=str(out.resolve()), options=given, made=dict(made))
    if kept:
        print(f"{len(kept)} of {len(names)} cases are there already.", flush=True)
    for count, answer in enumerate(_answers(run, tasks, jobs, dask), len(kept) + 1):
        kept[answer.case] = answer
        print(f"[{count}/{len(names)}] {answer.case}: {answer.verdict} ({answer.seconds:.0f} s)", flush=True)
    answers = [kept[name] for name in names]
    entries = {"schema": SCHEMA, "command": command, "folder": str(folder), "cases": [asdict(a) for a in answers]}
    text = aligned([("case", "status", "verdict", "in words"), *map(_row, answers)])
    write_whole(out / "cases.txt", text + "\n")
    for path in {out / "cases.json", table or out / "cases.json"}:
        write_json(path, entries)
    print(text)
    print(f"{out / 'cases.json'} and the folders beside it hold the details.")
    if any(answer.status == "failed" for answer in answers):
        raise SystemExit(FAILED)


def _row(answer: CaseAnswer) -> tuple[str, ...]:
    return printable(answer.case), answer.status, answer.verdict, printable(answer.sentence, 200)


def _as_typed(name: str, value: object) -> tuple[str, ...]:
    """An option with its value, for a process that starts elsewhere; nothing where it was not given."""
    if value is None or isinstance(value, bool):
        return (f"--{name}",) if value else ()
    return f"--{name}", str(value.resolve()) if isinstance(value, Path) else str(value)


def _answers(run: Any, tasks: Sequence[tuple[str, str, str]], jobs: int, dask: str | None) -> Iterator[CaseAnswer]:
    """What is said of the tasks, as they end."""
    if dask:
        from memsgyro_jax.base.farm import farmed

        for _, answer in farmed(run, tasks, dask):
            yield answer
        return
    with pool_of_processes(jobs) as (pool, running):
        for future in as_completed([pool.submit(run, task, running=running) for task in tasks]):
            yield future.result()


def _answered(
    task: tuple[str, str, str], command: str, out: str, options: Sequence[str], made: Mapping[str, str],
    running: Running | None = None,
) -> CaseAnswer:  # fmt: skip
    """Of one case, whatever it does; kept in its folder."""
    (name, case, key), begun = task, time.monotonic()
    place = Path(out) / name
    try:
        place.mkdir(parents=True, exist_ok=True)
        text, writes = (
            place / "text.txt",
            [part for option, file in made.items() for part in (option, str(place / file))],
        )
        arguments = [*PROGRAM, command, case, *options, *writes]
        reason = run_logged(arguments, [] if running is None else running, place / "log.txt", text)
        verdict, sentence = ("failed", reason) if reason else _verdict(place, made)
    except (OSError, ValueError, KeyError) as error:
        verdict, reason = "failed", repr(error)
        sentence = reason
    status = "failed" if reason else "done"
    answer = CaseAnswer(name, status, verdict, sentence, round(time.monotonic() - begun, 1), key)
    if place.is_dir():
        write_json(place / "answer.json", asdict(answer))
    return answer


def _verdict(place: Path, made: Mapping[str, str]) -> tuple[str, str]:
    """That of the result, in a word and a sentence; of a command that writes none the number of its warnings."""
    if "--json" in made:
        entries = json.loads((place / made["--json"]).read_text(encoding="utf-8"))
        if "sentence" in entries:
            return entries["verdict"], entries["sentence"]
        return "explained" if entries["explained"] else "not_explained", entries["verdict"]
    lines = (place / "text.txt").read_text(encoding="utf-8").split("\n")
    warnings = [line.strip() for line in lines if line.strip().startswith("Warning")]
    return f"{len(warnings) or 'no'} warnings", (warnings or [""])[0]


def _kept(place: Path, key: str) -> CaseAnswer | None:
    """What was found before from the same, unless it failed."""
    try:
        answer = CaseAnswer(**json.loads((place / "answer.json").read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None
    return answer if answer.key == key and answer.status == "done" else None


def _key(case: Path, command: str, options: Sequence[str]) -> str:
    """What the answer depends on: the files of the case and of the options, and the versions of what computes it."""
    from memsgyro_jax.base.provenance import versions

    digest = hashlib.sha256(repr((command, options, versions())).encode())
    files = [Path(option) for option in options if Path(option).is_file()]
    for path in sorted([*files, *(path for path in case.rglob("*") if path.is_file())]):
        digest.update(f"{path.name} {path.stat().st_size} ".encode() + path.read_bytes())
    return digest.hexdigest()[:16]
