"""`memsgyro allan` as a user runs it."""

import json

import numpy as np
import pytest

from memsgyro_jax.app.cli import main


@pytest.fixture
def log(tmp_path):
    rate = 2.0 + 0.1 * np.random.default_rng(0).standard_normal(600)
    lines = [f"{0.01 * k:.2f},{value:.6f}" for k, value in enumerate(rate)]
    path = tmp_path / "still.csv"
    path.write_text("\n".join(["t [s],rate [deg/s]", *lines]) + "\n")
    return path


def run(*tokens):
    with pytest.raises(SystemExit) as stop:
        main([str(token) for token in tokens])
    return stop.value.code


def test_it_prints_writes_and_draws(log, tmp_path, capsys):
    assert run("allan", log, "--json", tmp_path / "a.json", "--plot", tmp_path / "a.svg") == 0
    printed = capsys.readouterr().out
    assert "angle random walk at 1 s" in printed
    assert "cannot tell" in printed
    entries = json.loads((tmp_path / "a.json").read_text())
    assert entries["schema"] == "memsgyro-allan/1"
    # 0.1 deg/s of white noise at 100 Hz are 0.01 deg/√s, 0.6 deg/√h.
    angle_walk = entries["series"][0]["terms"]["N"]
    assert angle_walk["low"] < 0.6 < angle_walk["high"]
    assert (tmp_path / "a.svg").read_text().startswith("<?xml")


def test_bad_input_is_one_sentence(log, tmp_path, capsys):
    assert run("allan", log, "--column", "gyro") == 2
    assert run("allan", log, "--plot", tmp_path / "a.docx") == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 2
    assert "`rate [deg/s]`" in error
    assert ".svg" in error
