"""Which columns of an instrument's table are taken for the bias voltage, and that those that are not used are named."""

import instrument_files as w
import numpy as np
import pytest

import memsgyro_jax as mg


F, Z = w.FREQUENCY, w.RESPONSE


def wrote(path, header, *columns):
    """A table as text, of columns and numbers that stay as they are."""
    table = np.broadcast_arrays(*columns)
    lines = [",".join(f"{value:.9g}" for value in row) for row in np.transpose(table)]
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


@pytest.mark.parametrize(
    ("header", "unused"),
    [
        ("f [Hz],X [V],Y [V],Pressure [Pa]", "`Pressure [Pa]`"),
        ("f [Hz],X [V],Y [V],phase [deg]", "`phase [deg]`"),
        ("f [Hz],X [V],Y [V],Pressure [Pa],Humidity [percent]", "`Pressure [Pa]`, `Humidity [percent]`"),
        ("f [Hz],X [V],Y [V],Temperature", "`Temperature`"),
        ("f [Hz],X [V],Y [V],bias current [A]", "`bias current [A]`"),
    ],
)
def test_columns_that_are_not_used_are_named(header, unused, tmp_path):
    rows = (F, Z.real, Z.imag, 25.0 + 0.1 * np.arange(F.size), 40.0)[: header.count(",") + 1]
    found = mg.import_case([wrote(tmp_path / "a.csv", header, *rows)], tmp_path / "case")
    assert f"Not used: {unused}." in str(found)
    assert f"# not used: {unused.replace('`', '')}\n" in (tmp_path / "case" / "case.toml").read_text()
    assert found.to_dict()["records"][0]["unused"] == unused.strip("`").split("`, `")


def test_a_further_column_neither_takes_rows_nor_becomes_the_signal(tmp_path):
    """A gap in a column that is not used cost its row; a pressure beside phasors over time became the vibration."""
    gap = np.where(np.arange(F.size) == 7, np.nan, 3.0)
    path = wrote(tmp_path / "a.csv", "f [Hz],X [V],Y [V],Pressure [Pa]", F, Z.real, Z.imag, gap)
    assert mg.import_case([path], tmp_path / "sweep").case.records[0].rows == F.size
    time = np.arange(400) / 1e3
    z = np.exp((-5 + 2j * np.pi * 0.7) * time)
    path = wrote(tmp_path / "b.csv", "t [s],X [V],Y [V],Pressure [Pa]", time, z.real, z.imag, 3.0 + time)
    found = mg.import_case([path], tmp_path / "decay", reference="4 kHz")
    np.testing.assert_allclose(found.case.records[0].signals[:, 0], z, rtol=1e-8)
    assert "Not used: `Pressure [Pa]`." in str(found)


def test_what_a_record_over_time_has_no_use_for_is_named(tmp_path):
    time = np.arange(4000) / 20e3
    values = np.exp(-20.0 * time) * np.cos(2 * np.pi * 3200.0 * time)
    header = "t [s],signal [V],T [degC],Bias [V],Vdc [V],drive [V]"
    found = mg.import_case([wrote(tmp_path / "a.csv", header, time, values, 45.0, 10.0, 10.0, 0.0)], tmp_path / "case")
    assert found.case.records[0].kind == "free_decay"
    assert "Not used: `Vdc [V]`, `drive [V]`." in str(found)
    assert found.case.records[0].temperature[0] == pytest.approx(318.15)
    assert found.case.records[0].bias_voltage[0] == pytest.approx(10.0)
    assert "taken for the bias" not in str(found)


@pytest.mark.parametrize(
    "header", ["Vdc [V]", "V_DC (V)", "VDC [mV]", "DC bias (V)", "bias voltage [V]", "Vb [V]", "V_b (V)", "Udc [V]",
               "DC voltage [V]", "Voltage DC (V)", "Vdc setpoint (V)", "Vdc source [V]", "dc_voltage_V",
               "polarization voltage [V]"],
)  # fmt: skip
def test_a_voltage_named_dc_or_bias_is_the_bias(header, tmp_path):
    factor = 1e-3 if "mV" in header else 1.0
    volts = np.where(np.arange(F.size) < F.size // 2, 10.0, 12.0)
    path = wrote(tmp_path / "a.csv", f"f [Hz],X [V],Y [V],{header}", F, Z.real, Z.imag, volts)
    found = mg.import_case([path], tmp_path / "case", drive=["10 mV"])
    np.testing.assert_allclose(found.case.records[0].bias_voltage, factor * volts, rtol=1e-12)
    assert found.case.environment.bias_voltage == pytest.approx(factor * 10.0)
    assert ("is taken for the bias voltage" in str(found)) == ("bias" not in header.lower())
    assert "Not used" not in str(found)


@pytest.mark.parametrize(
    "header", ["DC [V]", "Signal DC [V]", "ADC 1 [V]", "Vdc [A]", "Vdc [Vrms]", "Vdc [Vpk]", "Vdc", "Idc [mA]",
               "DC offset [V]", "Vdd [V]", "Vbe [V]", "Vb rms [V]", "DC gain [1]", "V_bat [V]", "demod 1 Vdc [V]"],
)  # fmt: skip
def test_what_is_no_bias_is_not_taken_for_one(header, tmp_path):
    path = wrote(tmp_path / "a.csv", f"f [Hz],X [V],Y [V],{header}", F, Z.real, Z.imag, 10.0)
    found = mg.import_case([path], tmp_path / "case", drive=["10 mV"])
    assert found.case.environment.bias_voltage == 0.0
    assert "V_bias" not in (tmp_path / "case" / "a.csv").read_text()
    assert "taken for the bias" not in str(found)


@pytest.mark.parametrize("header", ["Vdrive dc [V]", "drive [V]", "Drive DC level [V]"])
def test_a_drive_stays_the_drive(header, tmp_path):
    path = wrote(tmp_path / "a.csv", f"f [Hz],X [V],Y [V],{header}", F, Z.real, Z.imag, 0.25)
    record = mg.import_case([path], tmp_path / "case").case.records[0]
    np.testing.assert_allclose(record.drive, 0.25)
    assert not np.any(record.bias_voltage)


def test_the_only_waveform_and_two_that_belong_together_are_no_bias(tmp_path):
    time = np.arange(4000) / 20e3
    values = np.exp(-20.0 * time) * np.cos(2 * np.pi * 3200.0 * time)
    found = mg.import_case([wrote(tmp_path / "a.csv", "t [s],Vb [V]", time, values)], tmp_path / "case")
    np.testing.assert_allclose(found.case.records[0].signals[:, 0], values, atol=1e-8)
    with pytest.raises(mg.InputError, match=r"more than one column may be the signal: `Va \[V\]`, `Vb \[V\]`"):
        mg.import_case([wrote(tmp_path / "b.csv", "t [s],Va [V],Vb [V]", time, values, values)], tmp_path / "two")


@pytest.mark.parametrize("row", [7, 38])
def test_a_wrong_row_above_the_resonance_neither_stops_a_sweep_nor_tells_what_is_read(row, tmp_path):
    """One reading of 3.5 times the peak: the phase falls across the resonance all the same."""
    f = np.linspace(990.0, 1010.0, 61)
    z = 1000.0 / (1000.0**2 - f**2 + 1j * f) + 1e-3 * np.random.default_rng(2).normal(size=(61, 2)) @ [1, 1j]
    z[row] = 3.5 * np.abs(z).max() * np.exp(0.3j)
    path = tmp_path / "sweep_50mV.csv"
    rows = (f"{a},{b.real},{b.imag}" for a, b in zip(f, z, strict=True))
    path.write_text("\n".join(["f [Hz],X [V],Y [V]", *rows]) + "\n")
    found = mg.import_case([path], tmp_path / "case")
    assert "the read-out shows displacement: at resonance its phase is about -90°" in str(found)
    assert f"line {row + 2}: channel x lies" in str(mg.assess(found.case))
    path.write_text("\n".join(["f [Hz],Y [V],X [V]", *(f"{a},{b.real},{b.imag}" for a, b in zip(f, z, strict=True))]))
    mapped = "f=f [Hz],x_I=Y [V],x_Q=X [V]"
    assert mg.import_case([path], tmp_path / "swapped", columns=mapped).case.records


@pytest.mark.parametrize("name", ["std [mV]", "Vx_std [mV]"])
def test_the_noise_of_each_row_is_taken(name, tmp_path):
    size = 0.1 + 0.05 * np.arange(F.size) / F.size
    path = wrote(tmp_path / "sweep_10mV.csv", f"f [Hz],X [V],Y [V],{name}", F, Z.real, Z.imag, size)
    found = mg.import_case([path], tmp_path / "case")
    (record,) = found.case.records
    np.testing.assert_allclose(record.noise_of_rows[:, 0], 1e-3 * size, rtol=1e-6)
    assert "is the standard deviation of each row" in str(found)
    assert "Not used" not in str(found)
    effective = mg.import_case([path], tmp_path / "rms", rms=True)
    np.testing.assert_allclose(effective.case.records[0].noise_of_rows[:, 0], 2**0.5 * 1e-3 * size, rtol=1e-6)


@pytest.mark.parametrize("wrong", [0.0, np.nan])
@pytest.mark.parametrize("unit", ["V", "K"])
def test_what_is_no_noise_of_each_row_is_left_out_and_said(wrong, unit, tmp_path):
    size = np.where(np.arange(F.size) == 3, wrong, 1e-4)
    path = wrote(tmp_path / "sweep_10mV.csv", f"f [Hz],X [V],Y [V],std [{unit}]", F, Z.real, Z.imag, size)
    found = mg.import_case([path], tmp_path / "case")
    (record,) = found.case.records
    assert (record.noise_rows, record.rows) == (None, F.size)
    assert "`std` is left out, as it is no positive noise of each row in V" in str(found)


@pytest.mark.parametrize(
    ("first", "map_"),
    [(F, "f=column 1,x_I=column 2,x_Q=column 3"), (np.arange(F.size) / 1e3, "t=column 1,x=column 2"),
     (1.7e9 + np.arange(F.size), "t=column 1,x=column 2")],
)  # fmt: skip
def test_three_columns_without_names_that_rise_like_a_frequency_are_a_sweep(first, map_, tmp_path):
    lines = [f"{f:.12g} {z.real:.9g} {z.imag:.9g}" for f, z in zip(first, Z, strict=True)]
    (tmp_path / "a.dat").write_text("\n".join(lines) + "\n")
    with pytest.raises(mg.InputError) as caught:
        mg.import_case([tmp_path / "a.dat"], tmp_path / "case")
    assert f'--map "{map_}"' in str(caught.value)
    if map_.startswith("f"):
        found = mg.import_case([tmp_path / "a.dat"], tmp_path / "case", columns=map_)
        assert found.case.records[0].kind == "frequency_sweep"


def test_amplitudes_alone_do_not_tell_what_is_read_and_that_is_said(tmp_path):
    found = mg.import_case([wrote(tmp_path / "s_1V.csv", "f [Hz],R [V]", F, np.abs(Z))], tmp_path / "case")
    assert "for displacement where none does; amplitudes without a phase do not tell." in str(found)
    found = mg.import_case([wrote(tmp_path / "s_1V.csv", "f [Hz],R [m/s]", F, np.abs(Z))], tmp_path / "known")
    assert "do not tell" not in str(found)


@pytest.mark.parametrize(
    ("columns", "map_"),
    [
        ((1e6 * F, np.zeros(F.size), np.abs(Z)), "f=column 1,x_amp=column 3"),
        ((1e6 * F, np.abs(Z)), "f=column 1,x_amp=column 2"),
        ((1e6 * F, 20 * np.log10(np.abs(Z)) - 9, np.degrees(np.angle(Z))),
         "f=column 1,x_amp=column 2 [dB],x_phase=column 3 [deg]"),
        ((1e6 * F, np.abs(Z), np.degrees(np.angle(Z))), "f=column 1,x_amp=column 2,x_phase=column 3 [deg]"),
    ],
)  # fmt: skip
def test_a_map_to_copy_fits_what_columns_without_names_hold(columns, map_, tmp_path):
    """An Arduino's frequency, unused zeros and counts; a network analyser's gigahertz, dB and degrees: a frequency was
    a time, nothing an in-phase part, and decibels and degrees one of a phasor each.
    """
    path = wrote(tmp_path / "s_1V.csv", "", *columns)
    path.write_text(path.read_text().lstrip("\n"))
    with pytest.raises(mg.InputError) as caught:
        mg.import_case([path], tmp_path / "case")
    assert f'--map "{map_}"' in str(caught.value)
    found = mg.import_case([path], tmp_path / "case", columns=map_)
    assert found.case.records[0].kind == "frequency_sweep"


def test_a_magnitude_below_zero_is_in_decibels(tmp_path):
    """Those of a network analyser, under `freq, mag, phase`, were refused as amplitudes that are negative."""
    gain, phase = 20 * np.log10(np.abs(Z) / np.abs(Z).max()) - 29.0, np.degrees(np.angle(Z))
    found = mg.import_case([wrote(tmp_path / "a.csv", "freq,mag,phase", F, gain, phase)], tmp_path / "case")
    assert "`mag` is in dB, as it is below zero" in str(found)
    said = mg.import_case([wrote(tmp_path / "b.csv", "freq,mag [dB],phase [deg]", F, gain, phase)], tmp_path / "said")
    np.testing.assert_allclose(found.case.records[0].phasors, said.case.records[0].phasors)


@pytest.mark.parametrize("header", ["f [Hz],X [V],Y [V]", "f [Hz],R [V],theta [rad]"])
def test_a_row_at_no_frequency_is_left_out(header, tmp_path):
    """Every spectrum of modal analysis begins at 0 Hz, and was refused for it."""
    pair = (Z.real, Z.imag) if "X" in header else (np.abs(Z), np.angle(Z))
    columns = [np.concatenate([[0.0], column]) for column in (F, *pair)]
    found = mg.import_case([wrote(tmp_path / "a_1V.csv", header, *columns)], tmp_path / "case")
    assert found.case.records[0].rows == F.size
    assert "the row at 0 Hz, which tells nothing of a resonance, is left out" in str(found)
