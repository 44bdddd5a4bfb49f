"""The level at which a network analyser took a ratio, and levels that no file takes."""

import instrument_files as w
import numpy as np
import pytest

import memsgyro_jax as mg


@pytest.fixture
def ratio(tmp_path):
    """A touchstone file whose name has a voltage that is its bias."""
    path = tmp_path / "vna_8V.s2p"
    w.touchstone(path)
    return path


def test_a_ratio_is_turned_to_readings_by_the_level_that_is_given(ratio, tmp_path):
    plain = mg.import_case([ratio], tmp_path / "plain")
    found = mg.import_case([ratio], tmp_path / "case", drive=["10 mV"])
    (one,), (record,) = plain.case.records, found.case.records
    np.testing.assert_allclose(one.drive, 1.0)
    np.testing.assert_allclose(record.drive, 0.01)
    np.testing.assert_allclose(record.phasors, 0.01 * one.phasors, rtol=1e-12)
    assert "Assumed of the drive: it was taken at 10 mV, as was given, with which the ratio is multiplied." in str(
        found
    )
    assert "Assumed of the drive: it was taken at 1 V, as the file does not say (`--drive`)." in str(plain)
    gains = [case.design["static_gain"].value for case in (plain.case, found.case)]
    assert gains[1] == pytest.approx(gains[0], rel=1e-9), "a linear device is the same at every level"


def test_levels_of_analysers_stand_beside_those_of_others(ratio, tmp_path):
    sweep = tmp_path / "sweep.csv"
    lines = [f"{f},{z.real},{z.imag}" for f, z in zip(w.FREQUENCY, w.RESPONSE, strict=True)]
    sweep.write_text("\n".join(["f [Hz],X [V],Y [V]", *lines]) + "\n")
    for name, drive, levels in (
        ("each", ["10 mV", "20 mV"], (0.01, 0.02)),
        ("dashed", ["-", "20 mV"], (1.0, 0.02)),
        ("all", ["30 mV"], (0.03, 0.03)),
    ):
        found = mg.import_case([ratio, sweep], tmp_path / name, drive=drive)
        np.testing.assert_allclose([record.drive[0] for record in found.case.records], levels)
        assert "Not used" not in str(found)


def test_a_level_of_an_analyser_stands_in_the_command_that_asks_for_others(ratio, tmp_path):
    sweeps = []
    for gain in (1.0, 2.0):
        sweeps.append(tmp_path / f"sweep_{gain:.0f}.csv")
        lines = [f"{f},{gain * z.real},{gain * z.imag}" for f, z in zip(w.FREQUENCY, w.RESPONSE, strict=True)]
        sweeps[-1].write_text("\n".join(["f [Hz],X [V],Y [V]", *lines]) + "\n")
    found = mg.import_case([ratio, *sweeps], tmp_path / "case", drive=["10 mV", "-", "-"])
    assert found.warning.endswith('--drive "10 mV" "..." "..."')


def test_a_ratio_of_voltages_was_taken_at_a_voltage(ratio, tmp_path):
    with pytest.raises(
        mg.InputError, match=r"vna_8V\.s2p: the level `--drive` of a ratio of voltages must be a voltage"
    ):
        mg.import_case([ratio], tmp_path / "case", drive=["10 nN"])


def test_a_level_that_a_column_says_is_told_to_be_unused(tmp_path):
    path = tmp_path / "a.csv"
    lines = [f"{f},0.25,{z.real},{z.imag}" for f, z in zip(w.FREQUENCY, w.RESPONSE, strict=True)]
    path.write_text("\n".join(["f [Hz],drive [V],X [V],Y [V]", *lines]) + "\n")
    found = mg.import_case([path], tmp_path / "case", drive=["10 mV"])
    np.testing.assert_allclose(found.case.records[0].drive, 0.25)
    assert "Not used: the drive of 10 mV, as a.csv does not need it." in str(found)


def test_a_bias_and_a_drive_in_a_name_are_told_apart(tmp_path):
    """Of `s_10V_16mV` the drive was taken for 10 V, and that it may be the bias was not said."""
    files = [tmp_path / f"s_{bias}V_16mV.csv" for bias in (10, 15)]
    for times, file in enumerate(files, 1):
        lines = [f"{f},{z.real},{z.imag}" for f, z in zip(w.FREQUENCY, times * w.RESPONSE, strict=True)]
        file.write_text("\n".join(["f [Hz],X [V],Y [V]", *lines]) + "\n")
    found = mg.import_case(files, tmp_path / "case")
    assert [float(record.drive[0]) for record in found.case.records] == [0.016, 0.016]
    assert '--bias "10 V" "15 V"' in str(found)
