"""`memsgyro check` as a user runs it."""

import pytest
from measurement.case.bench import write_bench

from memsgyro_jax.app.cli import main


@pytest.fixture
def bench(tmp_path):
    return write_bench(tmp_path / "bench")


def run(*tokens):
    with pytest.raises(SystemExit) as stop:
        main([str(token) for token in tokens])
    return stop.value.code


def test_it_prints_the_records_and_their_quality(bench, capsys):
    assert run("check", bench) == 0
    printed = capsys.readouterr().out
    for word in ("sweep_x", "validation", "2 sweeps of x", "peak/noise", "held out: "):
        assert word in printed
    assert "Warning" not in printed


@pytest.mark.slow
def test_it_warns_of_a_wrong_digit(bench, capsys):
    path = bench / "ringdown.csv"
    lines = path.read_text().splitlines()
    t, x, y = lines[120].split(",")
    lines[120] = f"{t},{float(x) + 1e-3:.9g},{y}"
    path.write_text("\n".join(lines) + "\n")
    assert run("check", bench) == 0
    assert "Warning: ringdown.csv, line 121: channel x" in capsys.readouterr().out


def test_a_broken_case_is_one_sentence(bench, capsys):
    (bench / "raw.csv").unlink()
    assert run("check", bench) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "raw.csv" in error


@pytest.mark.slow
def test_the_demonstration_has_no_warning(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run("check", "demo") == 0
    printed = capsys.readouterr().out
    assert "sweep_x" in printed
    assert "Warning" not in printed
