"""The studies, and what they say of every row and figure of the two documents behind this package.

A study is a script of the folder `studies`, beside the package in a clone and inside it where it was installed. What it
answers stands in literals at its top, which are read without running it; what it found in the `answers.json` of its
last run.
"""

import ast
import json
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import memsgyro_jax
from memsgyro_jax.base.errors import InputError


NOT_RUN = "its study has not been run"
COLUMNS = ("claimed", "obtained", "reading", "verdict", "why")
MISSING = "not obtained"
_WIDTH, _COLOURS = 1000, 128  # of a picture on the page: pixels, and enough for lines


@dataclass(frozen=True)
class StudyScript:
    """A script with its question, where it belongs, rows that it answers, and printed figure to picture."""

    path: Path
    question: str
    place: str
    answers: tuple[str, ...]
    figures: dict[str, str]

    @property
    def name(self) -> str:
        return self.path.stem


def studies_folder() -> Path:
    """Where the studies are: inside the installed package, or beside it in a clone."""
    package = Path(memsgyro_jax.__file__).parent
    for folder in (package / "studies", package.parent / "studies"):
        if (folder / "rows.toml").is_file():
            return folder
    raise InputError("The studies are not installed: install the package from its wheel, or work in a clone.")


def all_studies(folder: Path | None = None) -> list[StudyScript]:
    """In the order of thesis, paper, and what is in neither."""
    paths = sorted((folder or studies_folder()).glob("[!_]*.py"))
    return sorted(map(_read, paths), key=lambda study: (_sections(study.place), study.name))


def _read(path: Path) -> StudyScript:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found: dict[str, Any] = {"PLACE": "of its own", "ANSWERS": (), "FIGURES": {}}
    for node in tree.body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id in found:
            found[node.targets[0].id] = ast.literal_eval(node.value)
    question = " ".join((ast.get_docstring(tree) or "").split("\n\n")[0].split())
    return StudyScript(path, question, found["PLACE"], tuple(found["ANSWERS"]), dict(found["FIGURES"]))


def _sections(place: str) -> tuple:
    order = [name for name in ("thesis", "paper") if place.lower().startswith(name)]
    return (("thesis", "paper").index(order[0]) if order else 2, [int(n) for n in re.findall(r"\d+", place)], place)


def claims(out: Path, studies: Sequence[StudyScript] | None = None) -> dict[str, Any]:
    """Every row and figure with what the studies' last runs under `out` found, or why there is nothing.

    Args:
        out: the folder with one folder per study, as `memsgyro studies --out` writes it.
        studies: `None` takes all.
    """
    studies = all_studies() if studies is None else studies
    told = tomllib.loads((studies_folder() / "rows.toml").read_text(encoding="utf-8"))
    runs = {study.name: _last_run(out / study.name) for study in studies}
    rows = [
        {"row": row, "where": where, "what": what, **found}
        for row, (where, what) in told["rows"].items()
        for found in _answers(row, studies, runs)
    ]
    figures = [
        {"figure": figure, "what": what, **_picture(figure, studies, out)} for figure, what in told["figures"].items()
    ]
    dates = sorted({run["date"] for run in runs.values() if "date" in run})
    return {"date": " to ".join(dict.fromkeys(dates[:1] + dates[-1:])), "rows": rows, "figures": figures}


def _last_run(folder: Path) -> dict[str, Any]:
    for name in ("failed.json", "answers.json"):
        if (folder / name).is_file():
            return json.loads((folder / name).read_text(encoding="utf-8"))
    return {"failed": NOT_RUN}


def _answers(row: str, studies: Sequence[StudyScript], runs: dict[str, dict[str, Any]]) -> list[dict[str, str]]:
    """What each study says of this row; one line that says why where none does."""
    mine = [study for study in studies if row in study.answers]
    if not mine:
        return [_nothing("-", "no study answers this row yet")]
    found = []
    for study in mine:
        run = runs[study.name]
        given = [answer for answer in run.get("answers", ()) if answer["row"] == row]
        size = "quick" if run.get("quick") else "full"
        found += [{**answer, "study": study.name, "run": f"{size}, {run['date']}"} for answer in given]
        if not given:
            found.append(_nothing(study.name, run.get("failed", "its last run did not answer it")))
    return found


def _nothing(study: str, reason: str) -> dict[str, str]:
    return {**dict.fromkeys(COLUMNS, MISSING), "why": reason, "study": study, "run": "-"}


def _picture(figure: str, studies: Sequence[StudyScript], out: Path) -> dict[str, str]:
    for study in studies:
        if figure in study.figures:
            path = Path(study.name) / f"{study.figures[figure]}.png"
            if (out / path).is_file():
                return {"study": study.name, "picture": path.as_posix(), "why": "drawn"}
            return {"study": study.name, "picture": "-", "why": "its study has not been run, or failed"}
    return {"study": "-", "picture": "-", "why": "no study draws it yet"}


def markdown(found: dict[str, Any], pictures: str | None = "") -> str:
    """The page of all rows and figures of `claims`.

    Args:
        found: what `claims` gave.
        pictures: what stands before a picture's path in a link; `None` names the picture and links nothing.
    """
    rows = [
        (row["row"], f"{row['what']} ({row['where']})", *(row[name] for name in COLUMNS), _source(row))
        for row in found["rows"]
    ]
    names = ("row", "system", "claimed", "obtained on the correct plant", "under the reading that explains the claim",
             "verdict", "why", "study")  # fmt: skip
    drawn = [
        (figure["figure"], figure["what"], figure["study"], _link(figure, pictures)) for figure in found["figures"]
    ]
    return "\n".join([
        "# Every claim, beside what was obtained",
        "",
        "Rows T are of the thesis, rows P of the paper on coupling errors. `memsgyro studies all` makes this page.",
        f"These are the runs of {found['date'] or 'no date'}, each full or quick as said.",
        "",
        *_table(names, rows),
        "",
        "## Figures",
        "",
        *_table(("figure", "shows", "study", "picture"), drawn),
        "",
    ])  # fmt: skip


def write_page(found: dict[str, Any], out: Path, docs: Path) -> None:
    """`claims.md`, `claims.json` and small pictures in `claims/`, under `docs`; `found` and `out` as of `claims`.

    What is there of a study that has not been run since stays, and of a full run where the new one is quick.
    """
    from PIL import Image

    page = docs / "claims.json"
    found, kept = _beside(found, json.loads(page.read_text(encoding="utf-8")) if page.is_file() else None)
    for path in sorted({figure["picture"] for figure in found["figures"] if figure["study"] not in kept} - {"-"}):
        (docs / "claims" / path).parent.mkdir(parents=True, exist_ok=True)
        with Image.open(out / path) as picture:
            picture.thumbnail((_WIDTH, _WIDTH))
            picture.convert("RGB").quantize(_COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(
                docs / "claims" / path, optimize=True
            )
    (docs / "claims.json").write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    (docs / "claims.md").write_text(markdown(found, "claims/"), encoding="utf-8")


def _beside(found: dict[str, Any], page: dict[str, Any] | None) -> tuple[dict[str, Any], set[str]]:
    """`found` with what stays of a `page`, and the studies whose results stay."""
    if page is None:
        return found, set()
    old = {(row["row"], row["study"]): row for row in page["rows"]}
    before = {figure["figure"]: figure for figure in page["figures"]}
    told = {row["study"]: row["run"] for row in page["rows"] if row["run"] != "-"}
    told |= {f["study"]: "full" for f in page["figures"] if f["picture"] != "-" and f["study"] not in told}
    again = {row["study"]: "failed" for row in found["rows"] if row["why"] != NOT_RUN}
    again |= {row["study"]: row["run"] for row in found["rows"] if row["run"] != "-"}
    again |= {f["study"]: "full" for f in found["figures"] if f["picture"] != "-" and f["study"] not in again}
    kept = {study for study, run in told.items()
            if study not in again or (again[study].startswith("quick") and run.startswith("full"))}  # fmt: skip
    rows = [old.get((row["row"], row["study"]), row) if row["study"] in kept else row for row in found["rows"]]
    figures = [before.get(f["figure"], f) if f["study"] in kept else f for f in found["figures"]]
    dates = sorted(row["run"].split(", ")[-1] for row in rows if row["run"] != "-")
    return {"date": " to ".join(dict.fromkeys(dates[:1] + dates[-1:])), "rows": rows, "figures": figures}, kept


def _source(row: dict[str, str]) -> str:
    return row["why"] if row["study"] == "-" else f"`{row['study']}` ({row['run']})"


def _link(figure: dict[str, str], pictures: str | None) -> str:
    if figure["picture"] == "-":
        return f"not drawn: {figure['why']}"
    name = Path(figure["picture"]).stem
    return f"`{name}`" if pictures is None else f"[{name}]({pictures}{figure['picture']})"


def _table(names: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    cell = lambda text: " ".join(str(text).split()).replace("|", "\\|")  # noqa: E731
    return [f"| {' | '.join(map(cell, row))} |" for row in (names, ["---"] * len(names), *rows)]
