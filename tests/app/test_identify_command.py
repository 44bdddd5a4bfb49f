"""`memsgyro identify` as a user runs it."""

import json

import browser
import numpy as np
import pytest
from lab import two_modes as lab

from memsgyro_jax.app.cli import main


@pytest.fixture
def sweep(tmp_path):
    path = tmp_path / "sweep.csv"
    phasors = lab.record(lab.Gyro(), lab.Instrument(ratio=1.3), lab.WIDE)
    lab.write_polar(path, lab.WIDE, lab.noisy(phasors, *lab.RAW, np.random.default_rng(0)))
    return path


def run(*tokens):
    with pytest.raises(SystemExit) as stop:
        main([str(token) for token in tokens])
    return stop.value.code


def test_it_prints_and_writes_what_was_asked_for(sweep, tmp_path, capsys):
    options = ("--mass", "3e-7", "--amplitude-noise", "1e-3", "--phase-noise", "3")
    target, report = tmp_path / "out.json", tmp_path / "report.html"
    assert run("identify", sweep, *options, "--json", target, "--report", report) == 0
    printed = capsys.readouterr().out
    assert "c_xy" in printed
    assert "identified" in printed
    data = json.loads(target.read_text())
    found = data["coefficients"]["c_xy"]
    assert abs(found["value"] - lab.Gyro().cxy) < 4 * found["std"]
    page = report.read_text()
    assert page.count("<svg") == 3
    assert len(page) < 1_000_000
    browser.check(tmp_path, {"looked_at": page})


def test_the_ratio_method_runs(sweep, capsys):
    assert run("identify", sweep, "--method", "ratio") == 0
    assert "R_NL" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--amplitude-noise", "1e-3"), "must be given together"),
        (("--amplitude-noise", "-1", "--phase-noise", "3"), "must be a positive number"),
        (("--effects", "duffing"), "electrical_feedthrough"),
        (("--mass", "-1"), "positive number of kilograms"),
        (("--conjugated",), "falls"),
    ],
)
def test_bad_options_are_one_sentence(sweep, tmp_path, capsys, options, message):
    target = tmp_path / "out.json"
    assert run("identify", sweep, *options, "--json", target) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not target.exists()


def test_a_malformed_file_is_one_sentence(sweep, capsys):
    sweep.write_text(sweep.read_text().replace(",", ";"))
    assert run("identify", sweep) == 2
    assert "separated by commas" in capsys.readouterr().err


def test_no_file_is_one_sentence(capsys):
    assert run("identify") == 2
    assert capsys.readouterr().err.count("\n") == 1
