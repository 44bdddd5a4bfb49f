"""`memsgyro diagnose` as a user runs it."""

import json
import re
import shlex
from pathlib import Path
from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax
from memsgyro_jax.app.cli import main
from memsgyro_jax.app.commands.diagnose import load_demo_or
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.diagnosis.diagnose import _keep_better
from memsgyro_jax.diagnosis.findings import Stage
from memsgyro_jax.effects import by_name, catalogue
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.readings import model_of


DEMO = Path(memsgyro_jax.__file__).parent / "demo"
ONE_AXIS = """\
schema = "memsgyro-model/1"
[device]
stiffness = { xx = 3.6e8, unit = "rad^2/s^2" }
damping = { xx = 20.0, unit = "1/s" }
mobility = { value = 5.5e6, unit = "1/kg" }
[readout]
scale = [5e5]
offset = [0.0]
[reference]
temperature = { value = 298.15, unit = "K" }
bias_voltage = { value = 10.0, unit = "V" }
"""


def run(*tokens):
    with pytest.raises(SystemExit) as stop:
        main([str(token) for token in tokens])
    return stop.value.code


def test_the_word_demo_is_the_case_that_comes_along(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert load_demo_or(Path("demo")).name == "demo"
    mine = tmp_path / "demo"
    mine.mkdir()
    assert load_demo_or(Path("demo")).folder == DEMO
    for path in DEMO.iterdir():
        (mine / path.name).write_text(path.read_text().replace('name = "demo"', 'name = "mine"'))
    assert load_demo_or(Path("demo")).name == "mine", "a user's own folder comes first"


@pytest.mark.parametrize(
    ("tokens", "message"),
    [
        (("nowhere",), "nowhere"),
        (("demo", "--level", "0"), "`level` must lie between 0 and 1"),
        (("demo", "--effects", "nowhere.py"), "nowhere.py"),
        (("demo", "--model", "nowhere.toml"), "nowhere.toml"),
        (("demo", "--report", "."), "must be a file, but is a folder"),
        (("demo", "--json", "file/result.json"), "is no folder"),
    ],
)
def test_bad_input_is_one_sentence(tokens, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    assert run("diagnose", *tokens) == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert error.count("\n") == 1
    assert message in error


def test_a_model_of_another_device_is_refused(tmp_path, capsys):
    (tmp_path / "model.toml").write_text(ONE_AXIS)
    assert run("diagnose", DEMO, "--model", tmp_path / "model.toml") == 2
    assert "model.toml: must have as many axes as the case demo has channels, 2, but has 1" in capsys.readouterr().err


STEPS = ("", 90.0), ("drive_level", 0.9), ("without drive_level", 0.91)
ERRORS = (SimpleNamespace(role="fit", chi2=1.0, count=1),)


def test_what_is_known_is_said_where_it_is_told_to_end(monkeypatch, tmp_path, capsys):
    cubic = eqx.tree_at(lambda e: e.strength, by_name("cubic_stiffness", "x", among=catalogue(2)), jnp.asarray(1e9))

    def ended(start, case, *, tell, keep, **_):
        model = model_of(case, starting_device(case)).with_effect(cubic)
        tell("look closer at cross_stiffness, quadratic_damping x")
        keep(SimpleNamespace(model=model, case=case), (Stage("", 90.0, 8.0), Stage("cubic_stiffness x", 1.0, 1.1)))
        raise KeyboardInterrupt

    monkeypatch.setattr("memsgyro_jax.diagnosis.diagnose.diagnose", ended)
    assert run("diagnose", DEMO, "--out", tmp_path / "model.toml") == 130
    said = capsys.readouterr().err
    assert "added so far: cubic_stiffness x; validation error 8 -> 1.1 × noise." in said
    assert "Candidates in hand: cross_stiffness, quadratic_damping x." in said
    assert f"Written so far: {tmp_path / 'model.toml'}." in said
    assert said.endswith(
        f"To go on: memsgyro diagnose {DEMO} --model {tmp_path / 'model.toml'} --out {tmp_path / 'model.toml'}\n"
        "Interrupted.\n"
    )
    assert run("diagnose", DEMO) == 130
    said = capsys.readouterr().err
    assert said.endswith(f'To go on: memsgyro fit {DEMO} --add "cubic_stiffness x"\nInterrupted.\n')
    tried = []

    def fitted(case, effects=()):
        tried.append([effect.label for effect in effects])
        if effects:
            raise InputError("The effects are known.")
        return SimpleNamespace(chi2_per_dof=1.0)

    monkeypatch.setattr("memsgyro_jax.diagnosis.fit.fit_case", fitted)
    (command,) = re.findall("To go on: memsgyro (.*)", said)
    assert run(*shlex.split(command)) == 2
    assert tried == [[], ["cubic_stiffness x"]]


def test_an_effect_that_was_dropped_is_no_longer_kept():
    """Though χ² per degree of freedom is a little larger without it; a rival search must be better."""
    kept = []
    steps = [SimpleNamespace(added=a, fit=SimpleNamespace(chi2_per_dof=c, errors=ERRORS)) for a, c in STEPS]
    better = _keep_better(
        SimpleNamespace(base=steps[0].fit, steps=steps[:1]), lambda fit, stages: kept.append(stages[-1].added)
    )
    for number in (2, 3):
        better(SimpleNamespace(steps=steps[:number]))
    better(SimpleNamespace(steps=[steps[0], SimpleNamespace(added="rival", fit=steps[0].fit)]))
    assert kept == ["", "drive_level", "without drive_level"]


def test_help_names_every_option(capsys):
    assert run("diagnose", "--help") == 0
    printed = capsys.readouterr().out
    for option in ("--model", "--effects", "--level", "--out", "--json", "--report"):
        assert option in printed


@pytest.mark.slow
def test_the_demonstration_is_found_and_written(tmp_path, capsys):
    names = {option: tmp_path / f"{option}.txt" for option in ("json", "report", "out")}
    assert run("diagnose", "demo", *(word for o, path in names.items() for word in (f"--{o}", path))) == 0
    out, said = capsys.readouterr()
    assert out.startswith("demo: found\nMissing was cubic_stiffness x")
    assert "added cubic_stiffness x" in said
    result = json.loads(names["json"].read_text())
    assert result["schema"] == "memsgyro-diagnosis/1"
    assert result["verdict"] == "found"
    (effect,) = result["effects"]
    assert (effect["name"], effect["axis"]) == ("cubic_stiffness", "x")
    assert abs(effect["estimate"] - 1.5e9) < 3 * effect["std"], "the laboratory hid 1.5e9 N/m³"
    assert effect["validation_error_after"] < 1.05 < effect["validation_error_before"]
    assert "cubic_stiffness x" in names["report"].read_text()
    assert run("compare", DEMO, "--model", names["out"]) == 0
    assert "explains the records" in capsys.readouterr().out


def test_what_is_known_is_said_where_it_cannot_go_on(monkeypatch, capsys):
    """A library's error after six minutes left nothing but its traceback; bad input has its own sentence alone."""
    raised = [np.linalg.LinAlgError("no"), InputError("The level is none.")]

    def ended(start, case, *, tell, keep, **_):
        model = model_of(case, starting_device(case))
        keep(SimpleNamespace(model=model, case=case), (Stage("", 90.0, 8.0), Stage("readout_delay", 1.0, 1.1)))
        raise raised.pop(0)

    monkeypatch.setattr("memsgyro_jax.diagnosis.diagnose.diagnose", ended)
    with pytest.raises(np.linalg.LinAlgError):
        main(["diagnose", str(DEMO)])
    assert "validation error 8 -> 1.1 × noise" in capsys.readouterr().err
    assert run("diagnose", DEMO) == 2
    assert "added so far" not in capsys.readouterr().err
