"""`memsgyro rate-test` as a user runs it."""

import json

import numpy as np
import pytest

from memsgyro_jax.app.cli import main


@pytest.fixture
def log(tmp_path):
    rate = np.tile(np.concatenate([np.linspace(-200, 200, 9), np.linspace(200, -200, 9)]), 2)
    volts = 0.01 * rate + 2.5 + 1e-5 * np.random.default_rng(0).standard_normal(len(rate))
    path = tmp_path / "table.csv"
    lines = [f"{a:g},{b:.7f}" for a, b in zip(rate, volts, strict=True)]
    path.write_text("\n".join(["table rate [deg/s],output [V]", *lines]) + "\n")
    return path


def run(*tokens):
    with pytest.raises(SystemExit) as stop:
        main([str(token) for token in tokens])
    return stop.value.code


def test_it_prints_writes_and_draws(log, tmp_path, capsys):
    code = run("rate-test", log, "--full-scale", 250, "--json", tmp_path / "a.json", "--plot", tmp_path / "a.png")
    assert code == 0
    printed = capsys.readouterr().out
    assert "scale factor" in printed
    assert "36 plateaus at 9 rates" in printed
    entries = json.loads((tmp_path / "a.json").read_text())
    assert entries["schema"] == "memsgyro-scale-factor-test/1"
    assert entries["full_scale_dps"] == pytest.approx(250.0)
    assert entries["figures"]["scale_factor"]["value"] == pytest.approx(0.01, rel=1e-5)
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_bad_input_is_one_sentence(log, tmp_path, capsys):
    assert run("rate-test", tmp_path / "none.csv") == 2
    assert run("rate-test", log, "--output-column", "outptu") == 2
    assert run("rate-test", log, "--plot", tmp_path / "a.docx") == 2
    assert run("rate-test", log, "--json", log / "a.json") == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 4
    assert "did you mean `output`" in error
    assert ".svg" in error
