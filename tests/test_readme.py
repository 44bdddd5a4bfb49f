"""The README's examples are run as they stand."""

import re
import tomllib
from pathlib import Path

import instrument_files
import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest

import memsgyro_jax as mg
from memsgyro_jax.app import cli
from memsgyro_jax.measurement.column_meaning import parse_map


README = (Path(__file__).resolve().parent.parent / "README.md").read_text()


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


@pytest.mark.parametrize("code", blocks("python"))
def test_python_examples_run(code, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    backend = mpl.get_backend()
    plt.switch_backend("agg")
    try:
        exec(compile(code, "README.md", "exec"), {})
    finally:
        plt.close("all")
        plt.switch_backend(backend)
    assert not list(tmp_path.iterdir()), "the example leaves files behind"
    out = capsys.readouterr().out
    told = next(block for block in blocks("text") if block.startswith("dies "))
    # The example is the default sweep: what the README says it prints is what it prints, but for its speed.
    assert [line for line in out.splitlines() if not line.startswith("speed")] == told.splitlines()


@pytest.mark.parametrize("text", blocks("toml"))
def test_study_examples_can_be_loaded(text, tmp_path):
    (tmp_path / "study.toml").write_text(text)
    study = mg.load_study(tmp_path / "study.toml")
    assert set(tomllib.loads(text)) <= set(type(study.file).model_fields)


def test_command_one_is_one_line():
    first = blocks("sh")[0]
    assert first.count("\n") == 1
    assert first.rstrip().endswith(".venv/bin/memsgyro sweep")


def test_options_named_in_the_readme_exist():
    for command in ("sweep", "simulate", "import"):
        known = {name for argument in cli.app[command].assemble_argument_collection() for name in argument.names}
        named = {
            word
            for line in re.findall(rf"memsgyro {command}[^`\n]*", README)
            for word in re.findall(r"--\w[\w-]*", line)
        }
        assert named <= known, named - known


def test_files_of_an_instrument_become_a_case_as_told(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    command = re.search(r"bin/memsgyro (import .*)", README)[1].split()
    for path in filter(lambda word: word.endswith(".csv"), command):
        instrument_files.labone_sweeps(tmp_path / path, float(re.search(r"\d+", path)[0]) / 10, noise=1e-7)
    with pytest.raises(SystemExit) as ended:
        cli.main(command)
    assert ended.value.code == 0
    out = " ".join(capsys.readouterr().out.split())
    assumed = re.findall(r"^ *Assumed: (.*)$", README, re.MULTILINE)
    assert len(assumed) == 4
    assert all(line.rstrip(".") in out for line in assumed)
    copied = re.search(r'--map "([^"]*)"', README)[1]
    assert [*parse_map(copied)] == ["f", "I", "Q", "drive"]
