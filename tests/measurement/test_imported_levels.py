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


LEVELS = np.repeat([10.0, 20.0, 20.0], w.FREQUENCY.size)


def three_sweeps(path, header, levels=LEVELS, place="{f},{level},{x},{y}"):
    """Two drives, the larger one twice, with noise."""
    rng, lines = np.random.default_rng(1), [header]
    for k, level in enumerate(levels):
        f, z = w.FREQUENCY[k % w.FREQUENCY.size], w.RESPONSE[k % w.FREQUENCY.size] * LEVELS[k]
        x, y = np.array([z.real, z.imag]) + 1e-4 * np.abs(w.RESPONSE).max() * rng.normal(size=2)
        lines.append(place.format(f=f"{f:.9g}", level=f"{level:.9g}", x=f"{x:.9g}", y=f"{y:.9g}"))
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize(
    ("name", "unit", "factor"),
    [("F [uN]", "N", 1e-6), ("F [nN]", "N", 1e-9), ("F (N)", "N", 1.0), ("Vac (mV)", "V", 1e-3), ("V_ac [V]", "V", 1.0),
     ("VAC [mV]", "V", 1e-3), ("AC voltage [mV]", "V", 1e-3), ("Vexc [mV]", "V", 1e-3), ("V_exc [mV]", "V", 1e-3),
     ("Vdrive [mV]", "V", 1e-3), ("Vdrv [mV]", "V", 1e-3), ("excitation [V]", "V", 1.0), ("Vin [mV]", "V", 1e-3),
     ("Iac [mA]", "A", 1e-3), ("I_ac [mA]", "A", 1e-3), ("amplitude (mV)", "V", 1e-3),
     ("Vac [mVrms]", "V", 2**0.5 * 1e-3)],
)  # fmt: skip
def test_a_level_that_a_column_says_is_the_drive(name, unit, factor, tmp_path):
    path = three_sweeps(tmp_path / "a.csv", f"f (Hz),{name},X [V],Y [V]")
    found = mg.import_case([path], tmp_path / "case")
    np.testing.assert_allclose(found.case.records[0].drive, factor * LEVELS, rtol=1e-9)
    assert "Not used" not in str(found)
    assert "WARNING" not in str(found)
    assert (tmp_path / "case" / "a.csv").read_text().count(f"F_x [{name.split()[-1][1:-1].removesuffix('rms')}]") == 1


@pytest.mark.parametrize("header", ["F,{},X [V],Y [V]", "F [Hz],{},X [V],Y [V]", "f,{},X [V],Y [V]"])
def test_f_alone_or_in_hertz_is_the_frequency(header, tmp_path):
    path = three_sweeps(tmp_path / "a.csv", header.format("F_x [V]"))
    (record,) = mg.import_case([path], tmp_path / "case").case.records
    np.testing.assert_allclose(record.frequency[: w.FREQUENCY.size] / (2 * np.pi), w.FREQUENCY, rtol=1e-8)
    np.testing.assert_allclose(record.drive, LEVELS)


@pytest.mark.parametrize("name", ["Vac [V]", "amplitude [V]", "V_ac (mV)"])
def test_an_alternating_voltage_that_is_read_is_no_drive(name, tmp_path):
    lines = [f"f [Hz],{name}", *(f"{f:.9g},{abs(z):.9g}" for f, z in zip(w.FREQUENCY, w.RESPONSE, strict=True))]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    (record,) = mg.import_case([tmp_path / "a.csv"], tmp_path / "case", drive=["1 V"]).case.records
    np.testing.assert_allclose(record.drive, 1.0)
    assert record.phasors.real.max() > 0.0


@pytest.mark.parametrize(
    ("header", "word"),
    [("f [Hz],Ch 7 [mV],X [V],Y [V]", "Ch 7 [mV]"), ("f [Hz],k,X [V],Y [V]", "k [V]"),
     ("f [Hz],power [W],X [V],Y [V]", "")],
)  # fmt: skip
def test_a_column_that_is_very_probably_the_drive_is_named(header, word, tmp_path):
    """Of sweeps that read twice as much, twice as much stood in a column, and both were taken for 1 V."""
    path = three_sweeps(tmp_path / "a.csv", header)
    found = mg.import_case([path], tmp_path / "case")
    assert ("very probably the drive" in found.warning) == bool(word), found.warning
    if word:
        assert f'--map "f=f [Hz],x_I=X [V],x_Q=Y [V],F_x={word}"' in found.warning or f"F_x={word}" in found.warning
        again = mg.import_case([path], tmp_path / "again", columns=f"f=f [Hz],x_I=X [V],x_Q=Y [V],F_x={word}")
        assert len(np.unique(again.case.records[0].setting)) == 2


def test_a_level_that_stands_in_each_of_several_files_is_named(tmp_path):
    n = w.FREQUENCY.size
    paths = [tmp_path / "one.csv", tmp_path / "two.csv"]
    whole = three_sweeps(tmp_path / "a.txt", "f [Hz],Ch 7 [mV],X [V],Y [V]").read_text().splitlines()
    for k, path in enumerate(paths):
        path.write_text("\n".join([whole[0], *whole[1 + k * n : 1 + (k + 1) * n]]) + "\n")
    warning = mg.import_case(paths, tmp_path / "case").warning
    assert "very probably the drive" in warning
    assert "F_x=Ch 7 [mV]" in warning


@pytest.mark.parametrize("levels", [np.repeat([10.0, 20.0, 30.0], w.FREQUENCY.size), np.full(LEVELS.size, 7.0)])
def test_a_column_that_does_not_go_with_the_readings_is_only_not_used(levels, tmp_path):
    path = three_sweeps(tmp_path / "a.csv", "f [Hz],Ch 7 [mV],X [V],Y [V]", levels)
    found = mg.import_case([path], tmp_path / "case")
    assert "very probably the drive" not in found.warning
    assert "Not used: `Ch 7 [mV]`" in str(found)
