"""`memsgyro datasheet` as a user runs it: a split-mode gyro whose sense axis is rebalanced by force."""

import json

import browser
import pytest

from memsgyro_jax.app import cli
from memsgyro_jax.measurement import datasheet as sheets


STUDY = """
schema = "memsgyro-study/1"
[device]
kind = "single_mass"
mass = "1e-8 kg"
kxx = "9.8696044 N/m"
kyy = "11.0894875 N/m"
kxy = "1e-4 N/m"
dxx = "7.8e-7 N*s/m"
dyy = "1.6e-6 N*s/m"
dxy = "1e-9 N*s/m"
rotating_frame = true
[readout]
kind = "displacement"
scale = "0.1 V/um"
noise_density = "0.1 uV/sqrt(Hz)"
[[effects]]
name = "thermal_drift"
variant = "stiffness"
strength = "-6e-5 1/K"
[controller]
kind = "classic"
sense = "rebalanced"
amplitude = "1 um"
[spread]
relative = 0.002
[sweep]
sample_rate = "50 kHz"
duration = "0.2 s"
"""


def run(*arguments):
    with pytest.raises(SystemExit) as end:
        cli.main([*map(str, arguments)])
    return end.value.code


def interrupted(*given):
    raise KeyboardInterrupt


@pytest.mark.slow
def test_a_page_and_its_figures(tmp_path, capsys, monkeypatch):
    """There before the noise too, so that Ctrl-C leaves it."""
    (tmp_path / "study.toml").write_text(STUDY)
    page, told = tmp_path / "made" / "datasheet.html", tmp_path / "sheet.json"
    given = ("--dies", 3, "--trim", "--full-scale", 500, "--noise-duration", 0.2, "--out", page.parent, "--json", told)
    given = (*given, "--temperatures", -20, 30, 80)
    with monkeypatch.context() as patch:
        patch.setattr(sheets, "noises", interrupted)
        assert run("datasheet", tmp_path / "study.toml", *given) == 130
    assert page.read_text().count("stopped before the record of 0.2 s with noise was there") == 3
    said = capsys.readouterr().err
    assert "0 s  3 dies at 9 constant rates, 0.2 s each" in said.splitlines()[0]
    assert "about" in said
    assert run("datasheet", tmp_path / "study.toml", *given) == 0
    assert "stopped before" not in page.read_text()
    rows = {row["name"]: row for row in json.loads(told.read_text())["rows"]}
    # Unequal cross damping and a rate are one force: (dxy/m)/2 is the zero-rate output, kxy/(2 m ω) the quadrature.
    assert rows["zero-rate output"]["before_trim"]["typical"] == pytest.approx(2.865, rel=0.05)
    assert abs(rows["zero-rate output"]["after_trim"]["typical"]) < 1e-3
    assert rows["scale factor"]["before_trim"]["typical"] == pytest.approx(1.0, abs=0.02)
    assert rows["quadrature"]["before_trim"]["dies"] == 3
    assert any("3 dies are few for a spread" in note for note in json.loads(told.read_text())["notes"])
    assert abs(rows["sensitivity to acceleration, x"]["before_trim"]["typical"]) < 1.0
    assert rows["full scale"]["before_trim"]["typical"] == pytest.approx(500.0)
    drift, over = rows["scale factor over temperature"], json.loads(told.read_text())["over_temperature"]
    assert drift["condition"].startswith("constant at -20, 30, 80 °C")
    # A rebalanced scale factor is 2 m ω A: ω falls by half of 6e-5 a kelvin, and with it the force for a rate.
    assert drift["before_trim"]["typical"] == pytest.approx(100.0 * 3e-5 * 50.0, rel=0.1)
    assert [len(die) for die in (over["temperatures_c"], *over["zero_rate_dps"])] == [3] * 4
    said = capsys.readouterr().out
    assert "zero-rate output" in said
    assert "Without a figure" in said
    text = page.read_text()
    assert text.count("<h2") >= 4
    assert text.count("<table") >= 3
    browser.check(tmp_path, {"looked_at": text})
    assert text.count("<svg") == 3
    assert 'colspan="4"' in text
    assert run("datasheet", "--full-scale", 0) == 2
    assert run("datasheet", "--temperatures", 25) == 2
