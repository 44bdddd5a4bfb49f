"""What the names of folders tell where files are all called the same, and maps for some files among demodulators."""

import instrument_files as w
import numpy as np
import pytest
from two_channel_files import FREQUENCY, demodulator, moved, wrote

import memsgyro_jax as mg


def saved(tmp_path, folder, axis, level=1.0):
    """A sweep as LabOne saves it: two demodulators, in a folder that tells what was driven."""
    place = tmp_path / folder
    place.mkdir(parents=True)
    z = level * moved(axis) / np.sqrt(2)
    return [demodulator(place, k, z[:, k]) for k in (0, 1)]


@pytest.fixture
def sessions(tmp_path):
    folders = {"drive_x_100mV": "x", "drive_x_300mV": "x", "drive_y_1V": "y"}
    return [file for folder, axis in folders.items() for file in saved(tmp_path, folder, axis)]


def test_folders_tell_the_axes_and_levels_of_files_of_one_name(sessions, tmp_path):
    found = mg.import_case(sessions, tmp_path / "case")
    names = ["drive_x_100mV", "drive_x_300mV", "drive_y_1V"]
    assert [record.name for record in found.case.records] == names
    assert [record.axis for record in found.case.records] == [0, 0, 1]
    np.testing.assert_allclose([record.drive[0] for record in found.case.records], [0.1, 0.3, 1.0])
    told = str(found)
    assert not found.warning
    assert "x is driven, as the folder's name says (drive_x_100mV, drive_x_300mV)." in told
    assert "the drive is 300 mV, as the folder's name says (drive_x_300mV)." in told
    assert "# from drive_x_300mV/dev1234_demods_0_sample_00000.csv" in (tmp_path / "case" / "case.toml").read_text()


def test_files_of_one_name_are_named_with_their_folders(tmp_path):
    files = [
        file for folder, level in (("first", 1.0), ("second", 2.0)) for file in saved(tmp_path, folder, "x", level)
    ]
    with pytest.raises(mg.InputError, match=r"first/dev1234\S*, second/dev1234\S*: with two channels"):
        mg.import_case(files, tmp_path / "case")
    found = mg.import_case(files, tmp_path / "case", axis=["x"])
    assert "(first/dev1234_demods_0_sample_00000.csv, second/dev1234_demods_0_sample_00000.csv)" in found.warning


def test_what_a_file_says_of_itself_counts_more_than_its_folder(tmp_path):
    files = []
    for level, run in enumerate(("drive_x_1V/a", "drive_x_1V/b"), 1):
        (tmp_path / run).mkdir(parents=True)
        files.append(wrote(tmp_path / run / "drive_y.txt", "y", level))
    found = mg.import_case(files, tmp_path / "case")
    assert [record.name for record in found.case.records] == ["a_drive_y", "b_drive_y"]
    assert [record.axis for record in found.case.records] == [1, 1]
    assert "(a/drive_y.txt, b/drive_y.txt)" in found.warning


def test_every_file_of_such_a_folder_is_told_by_it(tmp_path):
    files = []
    for level, run in enumerate(("drive_x_10mV/up", "drive_x_20mV/up", "drive_x_20mV/down_again"), 1):
        (tmp_path / run).parent.mkdir(exist_ok=True)
        files.append(wrote(tmp_path / f"{run}.txt", "x", level))
    found = mg.import_case(files, tmp_path / "case")
    assert [record.name for record in found.case.records] == ["drive_x_10mV_up", "drive_x_20mV_up", "down_again"]
    np.testing.assert_allclose([record.drive[0] for record in found.case.records], [0.01, 0.02, 0.02])


def test_a_folder_of_one_record_tells_where_it_names_a_drive(tmp_path):
    (record,) = mg.import_case(saved(tmp_path, "drive_y_20mV", "y"), tmp_path / "case").case.records
    assert (record.axis, record.drive[0]) == (1, 0.02)
    plain = saved(tmp_path, "y_5V_supply", "y")
    with pytest.raises(mg.InputError, match="the driven axis must be known"):
        mg.import_case(plain, tmp_path / "other")


def test_folders_are_hinted_at_where_they_tell_a_temperature(tmp_path):
    paths = []
    for folder in ("m40C", "85C"):
        (tmp_path / folder).mkdir()
        paths.append(tmp_path / folder / "sweep.s2p")
        w.touchstone(paths[-1])
    found = mg.import_case(paths, tmp_path / "case", drive=["10 mV", "20 mV"])
    assert '--temperature "-40 degC" "85 degC"' in str(found)


MAP = "f=f,x_I=a,x_Q=b,y_I=c,y_Q=d"


def mapped(path, axis="y"):
    """A sweep whose names tell nothing."""
    z = moved(axis)
    rows = np.column_stack([FREQUENCY, z[:, 0].real, z[:, 0].imag, z[:, 1].real, z[:, 1].imag])
    np.savetxt(path, rows, delimiter=",", header="f,a,b,c,d", comments="")
    return path


@pytest.mark.parametrize(
    ("maps", "axis", "drive"),
    [
        (["-"] * 6 + [MAP], ["x", "x", "y", "y"], ["1 mV", "2 mV", "3 mV", "4 mV"]),
        (["-"] * 6 + [MAP], ["x"] * 4 + ["y"] * 3, ["1 mV"] * 2 + ["2 mV"] * 2 + ["3 mV"] * 2 + ["4 mV"]),
        (["-"] * 3 + [MAP], ["-", "-", "-", "y"], ["1 mV", "2 mV", "3 mV", "4 mV"]),
    ],
)
def test_demodulators_without_a_map_are_joined_beside_a_file_with_one(maps, axis, drive, sessions, tmp_path):
    files = [*sessions, mapped(tmp_path / "last.csv")]
    found = mg.import_case(files, tmp_path / "case", columns=maps, axis=axis, drive=drive)
    assert [record.axis for record in found.case.records] == [0, 0, 1, 1]
    np.testing.assert_allclose([record.drive[0] for record in found.case.records], [1e-3, 2e-3, 3e-3, 4e-3])


def test_a_map_of_its_own_keeps_a_demodulator_alone(tmp_path):
    files = saved(tmp_path, "run", "x")
    said = "f=frequency,x_I=x,x_Q=y"
    for maps in ([said], [said, said], [said, "-"]):
        case = mg.import_case(files, tmp_path / "case", columns=maps, drive=["1 mV"], overwrite=True).case
        assert (case.device, len(case.records)) == ("resonator", 2)
    with pytest.raises(mg.InputError, match="`--map` must be given once or for each of 2 files"):
        mg.import_case(files, tmp_path / "other", columns=["-", "-", said])
    joined = mg.import_case(files, tmp_path / "joined", columns=["-", "-"], drive=["1 mV"], axis=["x"]).case
    assert (joined.device, len(joined.records)) == ("single_mass", 1)


@pytest.mark.parametrize(("words", "volts"), [("-10dBm", 0.1), ("-26dBV", 2**0.5 * 10**-1.3), ("20mV", 0.02)])
def test_a_level_in_the_name_of_a_touchstone_file_is_its_level(words, volts, tmp_path):
    path = tmp_path / f"fork_{words}.s2p"
    w.touchstone(path)
    found = mg.import_case([path], tmp_path / "case")
    (record,) = found.case.records
    np.testing.assert_allclose(record.drive, volts, rtol=1e-6)
    plain = tmp_path / "fork.s2p"
    w.touchstone(plain)
    (one,) = mg.import_case([plain], tmp_path / "plain").case.records
    np.testing.assert_allclose(record.phasors, volts * one.phasors, rtol=1e-6)
    assert "as the file's name says, with which the ratio is multiplied" in str(found)
    (given,) = mg.import_case([path], tmp_path / "given", drive=["2 V"]).case.records
    np.testing.assert_allclose(given.drive, 2.0)
