"""`memsgyro studies`: what it lists, that a failing study is survived and said, and a table without a blank."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from memsgyro_jax import InputError
from memsgyro_jax.app import claims
from memsgyro_jax.app.commands.studies import studies_command


GOOD = '''"""Is it so? More words.

Further text.
"""
PLACE = "thesis 2.1"
ANSWERS = ("T1", "T2")
FIGURES = {"2.1": "drawn"}

import json, pathlib, sys

out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
answer = dict(row="T1", claimed="1", obtained="2 | 3", reading="none", verdict="does not hold", why="Because.")
(out / "answers.json").write_text(
    json.dumps({"quick": "--quick" in sys.argv, "date": "2026-01-02", "answers": [answer]}))
from PIL import Image

import numpy as np

picture = np.random.default_rng(0).integers(0, 256, (30, 1500, 1)).repeat(3, axis=2)  # greys, and few pixels of blue
picture[:, 600:630] = 31, 119, 180
Image.fromarray(picture.astype(np.uint8)).save(out / "drawn.png")
'''
BAD = 'PLACE = "thesis 10.1"\nANSWERS = ("T3",)\nFIGURES = {"2.2": "never"}\nraise ValueError("no such thing")\n'


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Two studies, one of which fails, beside the true rows."""
    place = tmp_path / "studies"
    place.mkdir()
    (place / "rows.toml").write_bytes((claims.studies_folder() / "rows.toml").read_bytes())
    (place / "good.py").write_text(GOOD)
    (place / "bad.py").write_text(BAD)
    (place / "_shared.py").write_text("raise SystemExit(9)")
    monkeypatch.setattr(claims, "studies_folder", lambda: place)
    return place


def test_studies_are_listed_by_section_without_running(folder, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "150")
    studies_command()
    text = capsys.readouterr().out
    assert text.index("good") < text.index("bad"), "section 2.1 is before 10.1"
    assert "T1, T2" in text
    assert "Is it so?" in text
    assert "Further" not in text


def test_a_failing_study_is_said_and_survived(folder, tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        studies_command("all", quick=True, out=tmp_path / "out", jobs=2)
    assert end.value.code == 1
    text = capsys.readouterr().out
    assert "good: done" in text
    assert "bad: failed with status 1: ValueError: no such thing" in text
    found = json.loads((tmp_path / "out" / "claims.json").read_text())
    rows = {row["row"]: row for row in found["rows"]}
    assert [*rows] == [*tomllib.loads((folder / "rows.toml").read_text())["rows"]]
    assert rows["T1"]["verdict"] == "does not hold"
    assert rows["T1"]["run"] == "quick, 2026-01-02"
    assert rows["T2"]["why"] == "its last run did not answer it"
    assert "no such thing" in rows["T3"]["why"]
    assert rows["T4"]["why"] == "no study answers this row yet"
    assert all(str(cell).strip() for row in found["rows"] + found["figures"] for cell in row.values())
    figures = {figure["figure"]: figure for figure in found["figures"]}
    assert figures["2.1"]["picture"] == "good/drawn.png"
    assert "failed" in figures["2.2"]["why"]
    page = (tmp_path / "out" / "claims.md").read_text()
    assert "2 \\| 3" in page
    assert all(f"\n| {row} | " in page for row in rows)

    (tmp_path / "docs").mkdir()
    studies_command(out=tmp_path / "out", page=tmp_path / "docs")
    with Image.open(tmp_path / "docs" / "claims" / "good" / "drawn.png") as picture:
        assert np.allclose(picture.convert("RGB").getpixel((410, 10)), (31, 119, 180), atol=10)
    assert "[drawn](claims/good/drawn.png)" in (tmp_path / "docs" / "claims.md").read_text()

    # On a page stays what has not been run since, and a full run where the new one is quick.
    page = tmp_path / "docs" / "claims.json"
    rows_of = lambda: {row["row"]: row["run"] for row in json.loads(page.read_text())["rows"]}  # noqa: E731
    page.write_text(page.read_text().replace("quick, 2026-01-02", "full, 2026-01-01"))
    for out in ("out", "empty"):
        studies_command(out=tmp_path / out, page=tmp_path / "docs")
        assert rows_of()["T1"] == "full, 2026-01-01"
        assert "(claims/good/drawn.png)" in (tmp_path / "docs" / "claims.md").read_text()

    # A run of one study leaves the others' results in the table.
    studies_command("good", out=tmp_path / "out")
    rows = {row["row"]: row for row in json.loads((tmp_path / "out" / "claims.json").read_text())["rows"]}
    assert rows["T1"]["run"] == "full, 2026-01-02"
    studies_command(out=tmp_path / "out", page=tmp_path / "docs")
    assert rows_of()["T1"] == "full, 2026-01-02"
    assert "no such thing" in rows["T3"]["why"]


@pytest.mark.parametrize(
    ("names", "options", "match"),
    [(("none",), {}, "`names` must hold studies or `all`"), (("all",), {"jobs": 0}, "`jobs` must be at least 1")],
)
def test_what_cannot_be_run_is_one_sentence(folder, names, options, match):
    with pytest.raises(InputError, match=match):
        studies_command(*names, **options)


def test_what_the_studies_promise_exists():
    told = tomllib.loads((claims.studies_folder() / "rows.toml").read_text(encoding="utf-8"))
    studies = claims.all_studies()
    assert len(studies) > 20
    assert {row for study in studies for row in study.answers} <= told["rows"].keys()
    drawn = [figure for study in studies for figure in study.figures]
    assert {*drawn} <= told["figures"].keys()
    assert len(drawn) == len({*drawn}), "one picture per figure"
    assert all(study.question.endswith((".", "?", "`")) for study in studies)


def test_the_page_of_all_rows_is_made_from_what_was_kept():
    """`docs/claims.md` is that of `docs/claims.json`, holds every row and figure, and its pictures are there."""
    docs = Path(__file__).resolve().parents[2] / "docs"
    found = json.loads((docs / "claims.json").read_text(encoding="utf-8"))
    assert (docs / "claims.md").read_text(encoding="utf-8") == claims.markdown(found, "claims/")
    told = tomllib.loads((claims.studies_folder() / "rows.toml").read_text(encoding="utf-8"))
    assert [*dict.fromkeys(row["row"] for row in found["rows"])] == [*told["rows"]]
    assert [figure["figure"] for figure in found["figures"]] == [*told["figures"]]
    assert all(str(cell).strip() for row in found["rows"] + found["figures"] for cell in row.values())
    drawn = [figure["picture"] for figure in found["figures"] if figure["picture"] != "-"]
    assert all((docs / "claims" / picture).is_file() for picture in drawn)
