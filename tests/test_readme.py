"""The README's examples are run as they stand."""

import re
import tomllib
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest

import memsgyro_jax as mg
from memsgyro_jax.app import cli


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
    for command in ("sweep", "simulate"):
        known = {name for argument in cli.app[command].assemble_argument_collection() for name in argument.names}
        named = {
            word
            for line in re.findall(rf"memsgyro {command}[^`\n]*", README)
            for word in re.findall(r"--\w[\w-]*", line)
        }
        assert named <= known, named - known
