"""A command over a folder of cases: each is answered, none stops another, nothing is computed twice."""

import json
import signal
import subprocess
import sys

import pytest

from memsgyro_jax.app.cli import main
from memsgyro_jax.app.commands import cases
from memsgyro_jax.app.commands.cases import cases_in


PROGRAM = """import json, os, pathlib, signal, sys
command, case, *rest = sys.argv[1:]
options = dict(zip(rest[::2], rest[1::2]))
seen = pathlib.Path(__file__).with_name("seen.txt")
seen.open("a").write(pathlib.Path(case).name + "\\n")
text = (pathlib.Path(case) / "case.toml").read_text()
if "killed" in text:
    os.kill(os.getpid(), signal.SIGKILL)
if "broken" in text:
    sys.exit("case.toml: line 1: is broken.")
print("Warning: drift")
if "--json" in options:
    answer = {"diagnose": {"verdict": "found", "sentence": "It is cubic."},
              "compare": {"explained": False, "verdict": "Two of three records fail."}}[command]
    pathlib.Path(options["--json"]).write_text(json.dumps(answer | {"level": options.get("--level")}))
"""


@pytest.fixture
def lot(tmp_path, monkeypatch):
    """Three cases, one of them below another folder, one of which cannot be read."""
    for name, text in (("a", "good"), ("b", "broken"), ("more/c", "good")):
        folder = tmp_path / "lot" / name
        folder.mkdir(parents=True)
        (folder / "case.toml").write_text(text)
    (tmp_path / "program.py").write_text(PROGRAM)
    monkeypatch.setattr(cases, "PROGRAM", (str(tmp_path / "program.py"),))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "lot"


def run(*tokens):
    with pytest.raises(SystemExit) as stop:
        main([str(token) for token in tokens])
    return stop.value.code


def seen(lot):
    return sorted((lot.parent / "seen.txt").read_text().split())


def test_every_case_is_answered_in_one_table(lot, capsys):
    assert run("diagnose", lot, "--jobs", 2, "--level", 0.01, "--json", "table.json") == 1
    printed = capsys.readouterr().out
    assert "[3/3]" in printed
    assert "It is cubic." in printed
    table = json.loads((lot.parent / "table.json").read_text())
    assert table["schema"] == "memsgyro-cases/1"
    found = {entry["case"]: (entry["status"], entry["verdict"]) for entry in table["cases"]}
    assert found == {"a": ("done", "found"), "b": ("failed", "failed"), "more/c": ("done", "found")}
    assert "line 1: is broken" in table["cases"][1]["sentence"]
    out = lot.parent / "diagnose-out"
    assert json.loads((out / "more/c/diagnosis.json").read_text())["level"] == "0.01"
    assert json.loads((out / "cases.json").read_text()) == table
    assert "more/c" in (out / "cases.txt").read_text()


def test_what_is_there_is_not_computed_again(lot, capsys):
    (lot / "b/case.toml").write_text("killed")
    assert run("diagnose", lot, "--out", "found") == 1
    (lot / "b/case.toml").write_text("good")
    assert run("diagnose", lot, "--out", "found") == 0
    assert "2 of 3 cases are there already." in capsys.readouterr().out
    assert seen(lot) == ["a", "b", "b", "c"]
    (lot / "a/further.csv").write_text("1")
    assert run("diagnose", lot, "--out", "found", "--level", 0.05) == 0
    assert seen(lot) == ["a", "a", "b", "b", "c"], "a file of a case that has changed; the level is the usual one"
    answer = lot.parent / "found/a/answer.json"
    answer.write_text(answer.read_text()[:20])  # as a disk that is full may leave it
    assert run("diagnose", lot, "--out", "found", "--level", 0.1) == 0
    assert len(seen(lot)) == 8, "another level is another diagnosis"


@pytest.mark.parametrize(("command", "verdict"), [("check", "1 warnings"), ("compare", "not_explained")])
def test_the_others_take_a_folder_too(command, verdict, lot, capsys):
    assert run(command, lot, "--out", "found") == 1
    table = json.loads((lot.parent / "found/cases.json").read_text())
    assert [entry["verdict"] for entry in table["cases"]] == [verdict, "failed", verdict]
    assert run(command, lot, "--out", lot / "inside") == 1
    assert len(cases_in(lot)) == 3


@pytest.mark.parametrize(
    ("tokens", "says"),
    [
        (("--jobs", 0), "at least 1"),
        (("--jobs", 2, "--dask", "tcp://nowhere:1"), "Dask"),
        (("--report", "page.html"), "--report"),
    ],
)
def test_bad_options_are_a_sentence(tokens, says, lot, capsys):
    assert run("diagnose", lot, *tokens) == 2
    assert says in capsys.readouterr().err
    assert not (lot.parent / "seen.txt").exists()


def test_a_single_case_has_no_use_for_jobs(lot, capsys):
    assert run("check", lot / "a", "--jobs", 2) == 2
    assert "`--jobs` must go with a folder of cases" in capsys.readouterr().err
    (lot.parent / "empty").mkdir()
    assert run("check", lot.parent / "empty") == 2


@pytest.mark.slow
def test_a_killed_run_is_gone_on_with(lot):
    """The first case to be run kills the run itself; the next one goes on."""
    (lot / "b/case.toml").write_text("good")
    program = lot.parent / "program.py"
    text = program.read_text()
    program.write_text(text.replace('if "killed" in text:', 'if seen.read_text().count("\\n") == 2:').replace(
        "os.getpid()", "os.getppid()"))  # fmt: skip
    start = "import sys; from memsgyro_jax.app.commands import cases; from memsgyro_jax.app.cli import main"
    script = f"{start}; cases.PROGRAM = ({str(program)!r},); main(['diagnose', 'lot'])"
    ends = [subprocess.run([sys.executable, "-c", script], cwd=lot.parent, check=False) for _ in range(2)]
    assert [end.returncode for end in ends] == [-signal.SIGKILL, 0]
    assert 3 <= len(seen(lot)) <= 4, "at most the case that was under way is done twice"
    assert len(json.loads((lot.parent / "diagnose-out/cases.json").read_text())["cases"]) == 3


@pytest.mark.slow
def test_the_workers_of_a_dask_scheduler_take_a_case_each(lot):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
    ) as cluster:
        assert run("diagnose", lot, "--dask", cluster.scheduler_address) == 1
    table = json.loads((lot.parent / "diagnose-out/cases.json").read_text())
    assert [entry["status"] for entry in table["cases"]] == ["done", "failed", "done"]
    assert seen(lot) == ["a", "b", "c"]
