"""Two channels of a lock-in, read while one electrode was driven, become a case of two axes."""

import re
import shlex

import numpy as np
import pytest
from two_channel_files import FREQUENCY, STIFFNESS, demodulator, moved, wrote

import memsgyro_jax as mg
from memsgyro_jax.app import cli
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.measurement.formats import SourceColumn
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.two_channels import axis_in_name, two_channels


@pytest.fixture
def files(tmp_path):
    """As the maker of a bench names them."""
    names = ("drive_x_10mV", "drive_x_30mV", "drive_y_10mV")
    return [wrote(tmp_path / f"{name}.txt", name[6], float(name[8:10])) for name in names]


@pytest.mark.parametrize(
    ("header", "parts"),
    [
        ("Frequency (Hz)\tDemod 1 X (V)\tDemod 1 Y (V)\tDemod 2 X (V)\tDemod 2 Y (V)", "xy"),
        ("Frequency\tDemod1 X (V)\tDemod1 Y (V)\tDemod2 X (V)\tDemod2 Y (V)", "xy"),
        ("f [Hz];Vx_I [V];Vx_Q [V];Vy_I [V];Vy_Q [V]", "xy"),
        ("f [Hz];x_I [V];x_Q [V];y_I [V];y_Q [V]", "xy"),
        ("f [Hz];x in-phase [V];x quadrature [V];y in-phase [V];y quadrature [V]", "xy"),
        ("freq;X1;Y1;X2;Y2", "xy"),
        ("f [Hz];I_x [V];Q_x [V];I_y [V];Q_y [V]", "xy"),
        ("f [Hz];R1 [V];Theta1 [deg];R2 [V];Theta2 [deg]", "rtheta"),
        ("f [Hz];CH1 amplitude (V);CH1 phase (deg);CH2 amplitude (V);CH2 phase (deg)", "rtheta"),
        ("f [Hz];Vx_amp [V];Vx_phase [deg];Vy_amp [V];Vy_phase [deg]", "rtheta"),
        ("f [Hz];X1 [V];Y1 [V];R1 [V];X2 [V];Y2 [V];R2 [V]", "xyr"),
    ],
)
def test_headers_of_two_channels_are_understood(header, parts, tmp_path):
    path = wrote(tmp_path / "drive_y_10mV.txt", "y", header=header, parts=parts)
    found = mg.import_case([path], tmp_path / "case")
    (record,) = found.case.records
    assert (found.case.device, record.axis) == ("single_mass", 1)
    np.testing.assert_allclose(record.phasors, moved("y"), rtol=1e-6)
    np.testing.assert_allclose(record.drive, 10e-3)
    assert "Assumed of the readings: the readings of two channels make it a device of two axes" in str(found)


def test_files_named_by_axis_and_level_become_a_case(files, tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(["import", *map(str, files), "--out", str(tmp_path / "bench")])
    assert ended.value.code == 0
    out = capsys.readouterr().out
    assert "Assumed of the drive: x is driven, as the file's name says (drive_x_10mV, drive_x_30mV)." in out
    assert "Assumed of the drive: y is driven, as the file's name says (drive_y_10mV)." in out
    case = mg.load_case(tmp_path / "bench")
    assert [record.axis for record in case.records] == [0, 0, 1]
    assert case.words.force == "V"
    hertz = np.sqrt(np.linalg.eigvalsh(starting_device(case).stiffness_matrix)) / (2 * np.pi)
    np.testing.assert_allclose(hertz, np.sqrt(np.linalg.eigvalsh(STIFFNESS)), rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "axis"),
    [
        ("drive_x_20mV_up", "x"), ("drivey", "y"), ("driveY-10mV", "y"), ("Drive-X", "x"), ("y_driven_30mV", "y"),
        ("xdrive", "x"), ("sweep_x", "x"), ("y60", "y"), ("drive_x_read_y", "x"), ("gyro_xy", ""), ("run2x", ""),
        ("max_drive", ""), ("x_to_y", ""), ("level_10mV", ""), ("drive_on_y", "y"), ("extra_drive", ""),
    ],
)  # fmt: skip
def test_the_axis_that_a_name_tells(name, axis):
    assert axis_in_name(name) == axis


def test_a_column_of_the_drive_or_an_option_says_which_axis(tmp_path):
    head = "f [Hz];Vx_I [V];Vx_Q [V];Vy_I [V];Vy_Q [V]"
    both = wrote(tmp_path / "a.csv", "y", header=f"{head};F_x [mV];F_y [mV]", further=(0.0, 5.0))
    found = mg.import_case([both], tmp_path / "column")
    assert found.case.records[0].axis == 1
    np.testing.assert_allclose(found.case.records[0].drive, 5e-3)
    assert "y is driven, as `F_y` says" in str(found)
    said = "f=f,x_I=Vx_I,x_Q=Vx_Q,y_I=Vy_I,y_Q=Vy_Q,F_y=level [mV]"
    mapped = wrote(tmp_path / "b.csv", "y", header=f"{head};level", further=(7.0,))
    (record,) = mg.import_case([mapped], tmp_path / "map", columns=said).case.records
    assert record.axis == 1
    np.testing.assert_allclose(record.drive, 7e-3)
    plain = [wrote(tmp_path / f"{axis}_named_wrongly.csv", "yx"["xy".index(axis)]) for axis in "xy"]
    given = mg.import_case(plain, tmp_path / "given", axis=["y", "x"], drive=["1 mV"])
    assert [record.axis for record in given.case.records] == [1, 0]
    assert "is driven, as" not in str(given)


def test_an_axis_that_nothing_tells_is_asked_for_in_words_to_copy(tmp_path):
    paths = [wrote(tmp_path / f"run{k}.csv", axis) for k, axis in enumerate("xy")]
    with pytest.raises(mg.InputError, match=r"run0\.csv.*run1\.csv.*driven axis must be known.*--axis x y ") as told:
        mg.import_case(paths, tmp_path / "case")
    assert not (tmp_path / "case").exists()
    axes = re.search(r"--axis ((?:[xy] )+)", str(told.value))[1].split()
    found = mg.import_case(paths, tmp_path / "case", axis=axes)
    assert [record.axis for record in found.case.records] == [0, 1]
    assert found.warning.endswith('--overwrite --axis x y --drive "..." "..."')


def test_columns_that_may_be_more_than_two_channels_are_named_with_a_map_to_copy(tmp_path):
    head = "f [Hz];Demod 1 X [V];Demod 1 Y [V];Demod 2 X [V];Demod 2 Y [V];Demod 3 X [V];Demod 3 Y [V]"
    path = wrote(tmp_path / "drive_x.csv", "x", header=head, further=(1.0, 2.0))
    with pytest.raises(mg.InputError, match="more than one column may be the in-phase part") as told:
        mg.import_case([path], tmp_path / "case")
    copied = shlex.split(str(told.value).split("--map ")[1])[0].rstrip(".")
    assert copied == "f=f [Hz],x_I=Demod 1 X [V],x_Q=Demod 1 Y [V],y_I=Demod 2 X [V],y_Q=Demod 2 Y [V]"
    (record,) = mg.import_case([path], tmp_path / "case", columns=copied).case.records
    np.testing.assert_allclose(record.phasors, moved("x"), rtol=1e-6)


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"axis": ["z"]}, "`--axis` must be x or y .*, but is `z`"),
        ({"axis": ["x", "y"]}, "`--axis` must be given once or for each of 3 files .*, but has 2"),
        ({"columns": "f=Frequency,x_I=X1,x_Q=Y1", "axis": ["x"]}, "`--axis` must be left out"),
        ({"columns": "f=Frequency,x_I=X1,x_Q=Y1,y_I=X2"}, "the two channels do not have the same parts.*y_Q=Y2"),
        ({"columns": "f=Frequency,x_I=X1,x_Q=Y1,F_x=X2,F_y=Y2"}, "must name one drive, as a sweep drives one axis"),
        ({"columns": "f=Frequency,x_I=X1,x_Q=Y1,F_x=X2,drive=Y2"}, "must name each role once"),
    ],
)
def test_what_does_not_fit_two_channels_is_one_sentence(options, what, files, tmp_path):
    with pytest.raises(mg.InputError, match=what) as told:
        mg.import_case(files, tmp_path / "case", **options)
    assert "\n" not in str(told.value)


def test_files_of_one_channel_and_of_two_are_no_case(files, tmp_path):
    single = tmp_path / "drive_x_50mV.csv"
    rows = np.column_stack([FREQUENCY, moved("x")[:, 0].real, moved("x")[:, 0].imag])
    np.savetxt(single, rows, delimiter=",", header="f,X,Y", comments="")
    with pytest.raises(mg.InputError, match=r"drive_x_50mV\.csv: must have two channels, as drive_x_10mV\.txt has"):
        mg.import_case([*files, single], tmp_path / "case")
    case = mg.import_case([single], tmp_path / "case").case
    assert (case.device, case.channels) == ("resonator", 1)
    decay, time = tmp_path / "decay.csv", np.arange(400) * 1e-3
    z = np.exp((-6.0 + 2j * np.pi * 3.0) * time)
    np.savetxt(decay, np.column_stack([time, z.real, z.imag]), delimiter=",", header="t [s],X [V],Y [V]", comments="")
    with pytest.raises(mg.InputError, match=r"decay\.csv: must .* unknown motion of both axes.* device of one axis"):
        mg.import_case([*files, decay], tmp_path / "both", reference="8 kHz")
    said = ["f=Frequency,x_I=X1,x_Q=Y1"] * 2 + ["-"]
    one = mg.import_case([*files[:2], decay], tmp_path / "both", reference="8 kHz", columns=said).case
    assert [record.kind for record in one.records] == ["frequency_sweep"] * 2 + ["free_decay"]
    header = "Frequency\tx_I [V]\tx_Q [V]\tS21 a [V]\tS21 b [V]"
    assert mg.import_case([wrote(tmp_path / "a_1V.txt", "x", header=header)], tmp_path / "one").case.channels == 1


def test_both_channels_are_turned_and_both_are_effective_values(tmp_path):
    header = "f [Hz];R1 [V];Theta1 [deg];R2 [V];Theta2 [deg]"
    path = wrote(tmp_path / "drive_y_1V.csv", "y", header=header, parts="rtheta")
    lines = [line.split(";") for line in path.read_text().splitlines()]
    turned = [[f, a, str(-float(p)), b, str(-float(q))] for f, a, p, b, q in lines[1:]]
    path.write_text("\n".join(map(";".join, [lines[0], *turned])))
    found = mg.import_case([path], tmp_path / "case", rms=True)
    np.testing.assert_allclose(found.case.records[0].phasors, 2**0.5 * moved("y"), rtol=1e-6)
    assert "e^{-iωt}" in str(found)


def test_scattering_of_two_ports_is_not_taken_for_two_channels():
    names = ("S11 REAL", "S11 IMAG", "S21 REAL", "S21 IMAG")
    assert two_channels(SourceColumn(name, "", np.zeros(3)) for name in names) == {}


def test_two_demodulators_of_one_sweep_are_two_channels(tmp_path):
    z = moved("x") / np.sqrt(2)
    files = [demodulator(tmp_path, number, z[:, k]) for k, number in enumerate((3, 10))]
    found = mg.import_case(files[::-1], tmp_path / "case", axis=["x"], drive=["20 mV"])
    (record,) = found.case.records
    assert found.case.device == "single_mass"
    np.testing.assert_allclose(record.phasors, moved("x"), rtol=1e-9)
    assert "the readings of demodulators 3 and 10, saved apart, are x and y of one record" in str(found)
    assert all(file.name in (tmp_path / "case" / "case.toml").read_text() for file in files)


@pytest.mark.parametrize(("count", "step"), [(3, 0.0), (2, 1.0)])
def test_tables_that_are_no_pair_stay_apart(count, step, tmp_path):
    """Three of one name, or two of other frequencies, are records of one axis each."""
    z = moved("x")[:, 0]
    files = [demodulator(tmp_path, k, (1 + k) * z, FREQUENCY + k * step) for k in range(count)]
    found = mg.import_case(files, tmp_path / "case", drive=["20 mV"])
    assert found.case.device == "resonator"
    assert len(found.case.records) == len(files)


def test_two_demodulators_in_one_file_are_two_channels(tmp_path):
    import h5py

    z = moved("y") / np.sqrt(2)
    with h5py.File(tmp_path / "drive_y.h5", "w") as file:
        for k in (0, 1):
            group = file.create_group(f"000/dev1234/demods/{k}/sample")
            for name, values in (("frequency", FREQUENCY), ("x", z[:, k].real), ("y", z[:, k].imag)):
                group[name] = values
    (record,) = mg.import_case([tmp_path / "drive_y.h5"], tmp_path / "case", drive=["20 mV"]).case.records
    np.testing.assert_allclose(record.phasors, moved("y"), rtol=1e-9)
    assert record.axis == 1


@pytest.mark.parametrize(("word", "level"), [("20 mV", 0.02), ("loud", 1.0)])
def test_the_level_of_the_drive_may_be_an_attribute(word, level, tmp_path):
    import h5py

    z = moved("x")[:, 0]
    with h5py.File(tmp_path / "one.h5", "w") as file:
        file.attrs["drive"] = word
        for name, values in (("frequency [Hz]", FREQUENCY), ("X [V]", z.real), ("Y [V]", z.imag)):
            file[name] = values
    found = mg.import_case([tmp_path / "one.h5"], tmp_path / "case")
    np.testing.assert_allclose(found.case.records[0].drive, level)
    said = "the drive is 20 mV, as the file's attribute `drive` says"
    assert (said in (tmp_path / "case" / "case.toml").read_text()) == (level < 1)


def test_demodulators_of_one_signal_or_of_waveforms_stay_apart(tmp_path):
    """Two filters behind one input are no two axes, and what is no phasor is lost in no pair."""
    z = moved("x")[:, 0]
    files = [demodulator(tmp_path, k, gain * z) for k, gain in enumerate((1.0, 0.97))]
    assert len(mg.import_case(files, tmp_path / "case", drive=["20 mV"]).case.records) == 2
    time = np.arange(400) * 2e-5
    for k in (0, 1):
        wave = np.exp(-100.0 * time) * np.cos(2 * np.pi * 8e3 * time + k)
        lines = [f"{t:.9g},{v:.9g}" for t, v in zip(time, wave, strict=True)]
        (tmp_path / f"run_demod{k}.csv").write_text("\n".join(["Time (s),Voltage (V)", *lines]) + "\n")
    found = mg.import_case([tmp_path / "run_demod0.csv", tmp_path / "run_demod1.csv"], tmp_path / "decays")
    assert [record.name for record in found.case.records] == ["run_demod0", "run_demod1"]


def test_options_for_each_file_hold_for_the_pair(tmp_path):
    z = moved("x") / np.sqrt(2)
    files = [demodulator(tmp_path, k, z[:, k]) for k in (0, 1)]
    found = mg.import_case(files, tmp_path / "case", axis=["x", "x"], drive=["20 mV", "20 mV"])
    assert len(found.case.records) == 1
    with pytest.raises(InputError, match="`--axis` must say the same of two files"):
        mg.import_case(files, tmp_path / "other", axis=["x", "y"], drive=["20 mV"])


def test_two_driven_axes_of_which_one_was_read_are_led_to_a_case(tmp_path):
    """What `import` makes of them, the words of its hint, and what `[design]` must then give."""
    paths = []
    for axis in "xy":
        z, path = moved(axis), tmp_path / f"drive_{axis}_10mV.csv"
        rows = (f"{f:.9g},{a.real:.9g},{a.imag:.9g}" for f, a in zip(FREQUENCY, z[:, 0], strict=True))
        path.write_text("\n".join(["f [Hz],Vx_I [V],Vx_Q [V]", *rows]) + "\n")
        paths.append(path)
    with pytest.raises(mg.InputError, match=r"must be left out.*set `device = .single_mass.`, `drive_axis`"):
        mg.import_case(paths, tmp_path / "case", axis=["x", "y"])
    found = mg.import_case(paths, tmp_path / "case")
    assert "Hint: the files' names say that x and y were driven, but each has one channel" in str(found)
    file = tmp_path / "case" / "case.toml"
    text = file.read_text().replace('device = "resonator"', 'device = "single_mass"')
    first, second = text.split("# from drive_y")
    text = first + "# from drive_y" + second.replace('drive_axis = "x"', 'drive_axis = "y"')
    file.write_text(text)
    with pytest.raises(mg.InputError) as told:
        mg.load_case(tmp_path / "case")
    missing = "must give kyy, kxy, dyy, dxy (kyy and dyy also as frequency_y and quality_factor_y), as no sweep that"
    assert f"{missing} may be fitted reads channel y; the records tell mass, kxx, dxx." in str(told.value)
    given = """[design]
frequency_y = { value = 8200, unit = "Hz", tolerance = 0.001 }
quality_factor_y = { value = 330, unit = "1", tolerance = 0.3 }
kxy = { low = -1e-6, high = 1e-6, unit = "N/m" }
dxy = { low = -1e-6, high = 1e-6, unit = "N*s/m" }
"""
    file.write_text(text.replace("[design]\n", given))
    design = mg.load_case(tmp_path / "case").design
    hertz = np.sqrt(design["kxx"].value / design["mass"].value) / (2 * np.pi)
    assert hertz == pytest.approx(8000.0, rel=1e-3)
    assert design["mass"].value == pytest.approx(1e-2 / (4 * np.pi**2 * 1e6), rel=0.05)  # of 10 mV


def test_a_file_that_says_its_axis_needs_no_option(tmp_path):
    paths = [wrote(tmp_path / "drive_x_10mV.csv", "x"), wrote(tmp_path / "run2_10mV.csv", "y")]
    found = mg.import_case(paths, tmp_path / "case", axis=["-", "y"])
    assert [record.axis for record in found.case.records] == [0, 1]
    assert "x is driven, as the file's name says" in str(found)
