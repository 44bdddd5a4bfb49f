"""The README's examples are run as they stand."""

import re
import tomllib
from pathlib import Path

import instrument_files
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.app import cli
from memsgyro_jax.measurement.column_map import parse_map


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


CASE = next(text for text in blocks("toml") if "memsgyro-case/1" in text)


def test_the_smallest_case_can_be_loaded(tmp_path):
    header = re.search(r"begins\s`(t \[s\].*)`", README)[1]
    f, w0, rng = np.linspace(1000.0, 1020.0, 81), 2 * np.pi * 1009.0, np.random.default_rng(0)
    w = 2 * np.pi * f
    v = 1j * w / (w0**2 - w**2 + 1j * w * w0 / 200.0) + 1e-6 * rng.standard_normal((2, 81)).T @ [1, 1j]
    rows = np.column_stack([2.0 * np.arange(81), np.full(81, 1e-6), f, v.real, v.imag])
    np.savetxt(tmp_path / "sweep.csv", rows, delimiter=",", header=header, comments="")
    (tmp_path / "case.toml").write_text(CASE)
    case = mg.load_case(tmp_path)
    assert case.readout.order == 1
    assert case.design["quality_factor"].value == pytest.approx(200.0, rel=0.02)


@pytest.mark.parametrize("text", [text for text in blocks("toml") if text != CASE])
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
        assert named <= known | {"--help"}, named - known


def test_files_of_an_instrument_become_a_case_as_told(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    command = re.search(r"bin/memsgyro (import .*)", README)[1].split()
    for path in filter(lambda word: word.endswith(".csv"), command):
        instrument_files.labone_sweeps(tmp_path / path, float(re.search(r"\d+", path)[0]) / 10, noise=1e-7)
    with pytest.raises(SystemExit) as ended:
        cli.main(command)
    assert ended.value.code == 0
    out = " ".join(capsys.readouterr().out.split())
    assumed = re.findall(r"^ *(Assumed of .*)$", README, re.MULTILINE)
    assert len(assumed) == 4
    assert all(line.rstrip(".") in out for line in assumed)
    copied = re.search(r'--map "([^"]*)"', README)[1]
    assert [*parse_map(copied)] == ["f", "I", "Q", "drive_x"]
