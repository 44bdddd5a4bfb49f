"""`memsgyro identify` as a user runs it."""

import json

import browser
import numpy as np
import pytest
from lab import two_modes as lab

from memsgyro_jax.app.cli import main
from memsgyro_jax.app.commands.identify import _records


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


@pytest.fixture
def files(tmp_path):
    """Sweeps with x and with y driven, as an instrument writes them: separated by semicolons, without a drive."""
    for axis in (0, 1):
        phasors = lab.record(lab.Gyro(), lab.Instrument(), lab.WIDE, axis)
        values = np.column_stack([lab.WIDE, *(part for z in phasors.T for part in (z.real, z.imag))])
        head = "Frequency (Hz);Demod 1 X (V);Demod 1 Y (V);Demod 2 X (V);Demod 2 Y (V)"
        np.savetxt(tmp_path / f"li_{'xy'[axis]}.csv", values, delimiter=";", header=head, comments="")
    return tmp_path / "li_x.csv", tmp_path / "li_y.csv"


def test_the_case_that_an_import_writes_is_read_with_its_drive_axes(files, tmp_path, capsys):
    case = tmp_path / "case"
    assert run("import", *files, "--axis", "x", "y", "--drive", "50 mV", "--out", case) == 0
    records = _records((case,), (), False)
    assert [record.name for record in records] == ["li_x", "li_y"]
    assert [record.axis for record in records] == [0, 1]
    for record in records:
        np.testing.assert_allclose(record.phasors, lab.record(lab.Gyro(), lab.Instrument(), lab.WIDE, record.axis))
        np.testing.assert_allclose(record.frequency, 2 * np.pi * lab.WIDE)
        assert set(record.start) == {record.frequency[0]}
        assert not record.notes
    assert run("identify", case, "--drive-axis", "x") == 2
    assert "is a case, which says so itself; leave it out" in capsys.readouterr().err
    single = [_records((case / f"li_{axis}.csv",), (axis,), False)[0] for axis in "xy"]
    both = _records((case / "li_x.csv", case / "li_y.csv"), ("x", "y"), False)
    assert [record.axis for record in single] == [record.axis for record in both] == [0, 1]
    assert [record.axis for record in _records((case / "li_x.csv", case / "li_y.csv"), ("y",), False)] == [1, 1]


def test_a_case_without_a_sweep_and_too_few_axes_are_one_sentence(sweep, tmp_path, capsys):
    case = tmp_path / "case"
    case.mkdir()
    (case / "case.toml").write_text('schema = "memsgyro-case/1"\nname = "none"\ndevice = "single_mass"\n')
    assert run("identify", case) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert run("identify", sweep, sweep, sweep, "--drive-axis", "x", "y") == 2
    assert "once for all files or once for each of the 3, but is given 2 times" in capsys.readouterr().err


def test_a_malformed_file_is_one_sentence(sweep, capsys):
    sweep.write_text(sweep.read_text().replace(",", ";"))
    assert run("identify", sweep) == 2
    assert "separated by commas" in capsys.readouterr().err


def test_no_file_is_one_sentence(capsys):
    assert run("identify") == 2
    assert capsys.readouterr().err.count("\n") == 1
