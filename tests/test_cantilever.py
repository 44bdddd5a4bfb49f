"""The measured cantilever: what its decay holds, and its page of the documentation as it stands."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from memsgyro_jax.app.cli import main
from memsgyro_jax.diagnosis.backbone import backbone
from memsgyro_jax.diagnosis.diagnose import diagnose
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.effects import by_name, catalogue
from memsgyro_jax.measurement.case import load_case


ROOT = Path(__file__).resolve().parent.parent
CASE = ROOT / "tests/data/cantilever"
BENCH = (ROOT / "docs/cantilever.md").read_text()
PAGE = (ROOT / "docs/free_decay.md").read_text()
LAW = ("cubic_stiffness", "quadratic_stiffness", "quadratic_damping")


@pytest.fixture(scope="module")
def fit():
    return fit_case(load_case(CASE), [by_name(name, among=catalogue(1)) for name in LAW])


def test_the_decay_tells_frequency_spring_and_damping(fit):
    hertz = float(np.sqrt(fit.model.device.stiffness[0])) / (2 * np.pi)
    assert hertz == pytest.approx(36.86, abs=0.02)
    ratio = {
        e.name: float(e.strength * fit.model.device.mobility / fit.model.device.stiffness[0]) for e in fit.model.effects
    }
    # Over amplitude a quadratic spring softens by 10/9 of its square: Nayfeh and Mook, "Nonlinear Oscillations" (1979).
    amount = ratio["cubic_stiffness"] - 10 / 9 * ratio["quadratic_stiffness"] ** 2
    assert 1e-12 * amount == pytest.approx(9.5e-6, rel=0.05)
    assert ratio["quadratic_damping"] > 0


def test_the_later_half_is_predicted_to_its_noise(fit):
    (later,) = [e for e in fit.errors if e.role == "validation"]
    assert later.rms < 1.1
    assert later.explained


def test_the_backbone_needs_no_law(fit):
    curve = backbone(fit_case(fit.case))
    slope, std = curve.hardening
    assert 1e-12 * slope == pytest.approx(9.5e-6, rel=0.05)
    assert std < 0.1 * slope
    small = curve.amplitude < 1.5e-5
    away = (curve.omega[small] / (2 * np.pi) - 36.86) / (curve.omega_std[small] / (2 * np.pi) + 0.01)
    assert np.all(np.abs(away) < 4)
    assert curve.damping[-1] > 2 * np.median(curve.damping[small]) - 4 * curve.damping_std[-1]


def test_the_page_says_what_the_case_says():
    written = tomllib.loads((CASE / "case.toml").read_text())
    (told,) = [tomllib.loads(block) for block in re.findall(r"```toml.*?\n(.*?)```", PAGE, re.DOTALL)]
    assert told["design"] == written["design"]
    (experiment,) = told["experiment"]
    assert experiment.items() <= written["experiment"][0].items()
    commands = dict.fromkeys(re.findall(r"^memsgyro (\S+)", PAGE, re.MULTILINE))
    assert [*commands] == ["import", "check", "compare", "diagnose", "law", "fit"]  # the site's build runs them


def test_the_calibration_on_the_page_is_that_of_its_records():
    """By hand: the gain 1/400 V/V of the script is scale · scale / (m·ω²), and 0.015·q² of the spring is ¾·k3·x²."""
    (told,) = [tomllib.loads(block) for block in re.findall(r"```text\n(.*?)```", BENCH, re.DOTALL)]
    assert (told["readout"]["scale"]["unit"], told["drive"]["scale"]["unit"]) == ("V/um", "uN/V")
    pick_off, electrode = 1e6 * told["readout"]["scale"]["value"], 1e-6 * told["drive"]["scale"]["value"]
    spring = told["design"]["mass"]["value"] * (2 * np.pi * 41.3e3) ** 2
    assert pick_off * electrode / spring == pytest.approx(1 / 400, rel=0.01)
    (said,) = re.findall(r"`(\S+) ± \S+ N/m³", BENCH)
    assert float(said) == pytest.approx(4 / 3 * 0.015 * spring * pick_off**2, rel=0.01)


def test_the_check_finds_nothing_wrong(monkeypatch, capsys):
    monkeypatch.chdir(CASE.parent)
    with pytest.raises(SystemExit) as ended:
        main(["check", CASE.name])
    assert ended.value.code == 0
    assert "Warning" not in capsys.readouterr().out


@pytest.mark.slow
def test_the_diagnosis_names_spring_and_damping():
    found = diagnose(None, load_case(CASE))
    assert found.verdict == "found"
    assert {a.name for a in found.accepted} >= set(LAW)
    # The loudest rows ask for a little more of the damping, which the sentence calls far weaker.
    assert len(found.accepted) <= len(LAW) + 1
    assert "far weaker" in found.sentence or len(found.accepted) == len(LAW)
