"""`memsgyro fit` and `memsgyro compare` as a user runs them, on the demonstration case."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import memsgyro_jax
from memsgyro_jax.app.cli import main
from memsgyro_jax.app.report.fit_text import fit_text, named_effects
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.diagnosis.compare import judged
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.instrument import instrument_terms
from memsgyro_jax.effects import catalogue, every_effect
from memsgyro_jax.measurement.case import load_case


DEMO = Path(memsgyro_jax.__file__).parent / "demo"
OWN = """
from memsgyro_jax.effects import ForceEffect, strength

class Spring(ForceEffect):
    name, unit, law = "my_spring", "N/m**3", "F_x = -s x^3"
    strength: object = strength()
    axis = 0

    def force(self, now):
        return self.along(now, -self.strength * now.displacement[0] ** 3)
"""


def run(*tokens):
    with pytest.raises(SystemExit) as stop:
        main([str(token) for token in tokens])
    return stop.value.code


def test_a_fit_that_has_not_ended_tells_no_uncertainty():
    case = load_case(DEMO)
    before = fit_case(case)
    judge = judged(before)
    assert "±" in fit_text(before, judge)
    stopped = replace(before, optimum=replace(before.optimum, converged=False))
    said = fit_text(before, replace(judge, fit=stopped))
    assert "±" not in said.replace("without ±", "")
    assert "the fit has not ended" in said
    assert "not converged after" in said


def test_without_an_effect_the_base_model_is_fitted(tmp_path, capsys):
    """Also for a study of a device of which nothing is missing; it was refused."""
    model, result = tmp_path / "model.toml", tmp_path / "fit.json"
    assert run("fit", DEMO, "--out", model, "--json", result) == 0
    printed = capsys.readouterr().out
    assert "->" not in printed
    assert "with " not in printed.partition("noise alone below")[0]
    assert "lower undamped frequency" in printed
    assert "kxy/m" in printed
    assert json.loads(result.read_text())["added"] == []
    assert "[[effects]]" not in model.read_text()


def test_a_fitted_model_is_written_and_compared(tmp_path, capsys):
    model, result, report = (tmp_path / name for name in ("model.toml", "fit.json", "compare.json"))
    assert run("fit", DEMO, "--add", "cubic_stiffness", "x", "--out", model, "--json", result) == 0
    printed = capsys.readouterr().out
    assert "cubic_stiffness x" in printed
    assert "explains the records" in printed
    data = json.loads(result.read_text())
    assert data["schema"] == "memsgyro-fit/1"
    assert data["explained"]
    (effect,) = data["effects"]
    assert effect["value"] > 100 * effect["std"]
    before, after = ({(e["name"], e["role"]): e["error"] for e in data[k]["experiments"]} for k in ("before", "after"))
    assert before["ringdown_x", "validation"] > 3
    assert after["ringdown_x", "validation"] < 1.1

    assert run("compare", DEMO, "--model", model, "--json", report, "--exit-code") == 0
    assert "taken as it is" in capsys.readouterr().out
    held = json.loads(report.read_text())
    assert held["explained"]
    assert held["effects"] == ["cubic_stiffness x"]
    for entry in held["experiments"]:
        assert entry["error"] == pytest.approx(after[entry["name"], entry["role"]], rel=1e-9)


@pytest.mark.slow
def test_an_effect_of_ones_own_and_one_that_is_scanned(tmp_path, capsys):
    own, model = tmp_path / "own.py", tmp_path / "model.toml"
    own.write_text(OWN)
    result = tmp_path / "fit.json"
    tokens = ("--add", "my_spring", "damping_step", "--effects", own, "--out", model, "--json", result)
    assert run("fit", DEMO, *tokens) == 0
    assert "damping_step, held: time" in capsys.readouterr().out
    data = json.loads(result.read_text())
    spring, step = data["effects"]
    assert spring["value"] == pytest.approx(1.5e9, rel=0.01)
    assert abs(step["value"]) < 5 * step["std"], "nothing has stepped"
    assert set(data["held"]["damping_step"]) == {"time", "record"}
    assert run("compare", DEMO, "--model", model) == 2
    assert "--effects FILE.py" in capsys.readouterr().err


def test_the_base_model_is_compared(capsys):
    assert run("compare", DEMO, "--exit-code") == 1
    assert "sweep_x fails at drive 150 nN" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("tokens", "message"),
    [
        (("fit", DEMO, "--add", "cubic_stifness"), "did you mean `cubic_stiffness`"),
        (("fit", DEMO, "--add", "cubic_stiffness z"), "is not"),
        (("compare", DEMO, "--model", "nowhere.toml"), "nowhere.toml"),
        (("compare", DEMO, "--effects", "own.py"), "must go with `--model`"),
        (("compare", "nowhere"), "nowhere"),
    ],
)
def test_bad_input_is_one_sentence(tokens, message, tmp_path, capsys):
    target = tmp_path / "out.json"
    assert run(*tokens, "--json", target) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not target.exists()


@pytest.mark.parametrize(
    ("names", "labels"),
    [
        (["cubic_stiffness x"], ["cubic_stiffness x"]),
        (["cubic_stiffness", "y", "readout_delay"], ["cubic_stiffness y", "readout_delay"]),
        (["cubic_stiffness"], ["cubic_stiffness x", "cubic_stiffness y"]),
        (["cubic_stiffness", "cubic_stiffness x"], ["cubic_stiffness x", "cubic_stiffness y"]),
        (
            ["force_misalignment x_to_y", "thermal_drift.damping"],
            ["force_misalignment x_to_y", "thermal_drift damping"],
        ),
    ],
)
def test_names(names, labels):
    assert [e.label for e in named_effects(names, catalogue(2))] == labels
    assert all(not np.any(e.strength) for e in named_effects(names, catalogue(2)))


@pytest.mark.parametrize("by_record", [["reference_phase by record"], ["reference_phase", "by", "record"]])
def test_a_variant_of_several_words(by_record):
    """As an interrupted diagnosis prints it, in quotes or without."""
    terms = instrument_terms(load_case(DEMO))
    known = (*catalogue(2), *terms)
    assert [e.label for e in named_effects([*by_record, "readout_delay"], known)] == [
        "reference_phase by record",
        "readout_delay",
    ]
    assert [e.label for e in named_effects(["reference_phase"], known)] == ["reference_phase"]


def test_what_no_diagnosis_asks_for_is_fitted_where_it_is_named_with_its_variant():
    """`memsgyro effects` lists it, and `fit` denied that it was of the catalogue."""
    known = catalogue(1)
    others = [e for e in every_effect(1) if e.label not in {one.label for one in known}]
    assert [e.label for e in named_effects(["thermal_drift pickoff_gain"], known, others)] == [
        "thermal_drift pickoff_gain"
    ]
    alone = [e.label for e in named_effects(["thermal_drift"], known, others)]
    assert alone == ["thermal_drift stiffness", "thermal_drift damping"]


def test_effects_of_ones_own_that_are_not_named_are_asked_for():
    with pytest.raises(InputError, match="`--add` must name"):
        named_effects([], catalogue(2))


def test_a_variant_without_its_effect_is_no_name():
    with pytest.raises(InputError, match='"x" is not'):
        named_effects(["x"], catalogue(2))
