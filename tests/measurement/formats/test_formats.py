"""The same sweep through every format gives the same readings."""

import importlib
import sys

import instrument_files as w
import numpy as np
import pytest
import pyuff
import skrf
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.units import parse_header, to_si
from memsgyro_jax.measurement.column_map import parse_map
from memsgyro_jax.measurement.column_meaning import meaning_of
from memsgyro_jax.measurement.declared import angular
from memsgyro_jax.measurement.formats import read_instrument_file
from memsgyro_jax.measurement.formats.header import split_header
from memsgyro_jax.measurement.import_case import import_case
from memsgyro_jax.measurement.imported_record import Given, records_of


WRITERS = {
    "semicolons.csv": w.semicolons, "labone_rows.csv": w.labone_rows, "labone_columns.csv": w.labone_columns,
    "labone.h5": w.labone_hdf5, "labone.mat": w.labone_mat, "plain.mat": w.plain_mat, "plain.h5": w.plain_hdf5,
    "classic.nc": w.netcdf, "labview.tdms": w.tdms, "modal.uff": w.universal, "labview.lvm": w.labview_text,
    "analyser.s2p": w.touchstone,
}  # fmt: skip
BINARY = [name for name in WRITERS if not name.endswith((".csv", ".lvm", ".uff", ".s2p"))]


def imported(path, said="", drive=None, reference=None):
    _, tables = read_instrument_file(path)
    (table,) = tables
    meaning = meaning_of(table, parse_map(said) if said else {})
    return records_of("record", table, meaning, Given(drive, reference))


def column(record, name, unit):
    for header, values in record.columns.items():
        found = parse_header(header)
        if found.name == name:
            return to_si(values, found.unit, unit, name)
    raise AssertionError(f"no {name} among {list(record.columns)}")


def assert_is_the_sweep(record, unit="V", close=2e-8):
    assert record.kind == "frequency_sweep"
    header = next(header for header in record.columns if header.startswith("f "))
    frequency = angular(record.columns[header], parse_header(header).unit, "f")
    np.testing.assert_allclose(frequency, 2 * np.pi * w.FREQUENCY, rtol=1e-9)
    readings = column(record, "Vx_I", unit) + 1j * column(record, "Vx_Q", unit)
    np.testing.assert_allclose(readings, w.RESPONSE, atol=close * np.abs(w.RESPONSE).max())


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("velocity_re_mm_s", ("velocity_re", "mm/s")),
        ("acc_m_s2", ("acc", "m/s^2")),
        ("t_s", ("t", "s")),
        ("m_s", ("m", "s")),
        ("rate_dps", ("rate", "dps")),
        ("gyro [mdps]", ("gyro", "mdps")),
        ("Winkel_Grad", ("Winkel", "Grad")),
        ("T_C", ("T", "degC")),
        ("oven_C", ("oven", "degC")),
        ("V_C", ("V_C", "")),  # over a capacitor
    ],
)
def test_a_header_without_a_slash_may_name_its_unit(text, found):
    assert split_header(text) == found


def test_waveforms_below_a_row_of_their_steps_begin_behind_their_names(tmp_path):
    """As LabVIEW writes waveforms as text, with a date of the day for each row: the row of steps was taken for the
    first of the table, and the names below it for words where numbers should be.
    """
    days = [f"5/7/2021  09:59:46.{round(828120 + 3.3 * k):06d}" for k in range(200)]
    rows = [f"{day},{np.cos(0.3 * k):.6E},{np.sin(0.3 * k):.6E}" for k, day in enumerate(days)]
    head = ["waveform,V_S,V_C", f"t0,{days[0]},{days[0]}", "delta t,3.300000E-6,3.300000E-6", "", "time,V_S,V_C"]
    (tmp_path / "pulse.csv").write_text("\n".join([*head, *rows]) + "\n")
    _, (table,) = read_instrument_file(tmp_path / "pulse.csv")
    assert [(c.name, c.unit) for c in table.columns] == [("time", "s"), ("V_S", ""), ("V_C", "")]
    np.testing.assert_allclose(table.columns[0].values, 3.3e-6 * np.arange(200), atol=1.1e-6)
    np.testing.assert_allclose(table.columns[2].values, np.sin(0.3 * np.arange(200)), atol=1e-6)


def complaint(path):
    """What is said of a file, or nothing of one that can still be read; any other error ends the test."""
    try:
        _, tables = read_instrument_file(path)
        for table in tables:
            records_of("record", table, meaning_of(table, {}), Given())
    except InputError as error:
        return str(error)
    return None


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_same_readings(name, tmp_path):
    WRITERS[name](tmp_path / name)
    (record,) = imported(tmp_path / name)
    assert_is_the_sweep(record, close=1e-6 if name.endswith("uff") else 2e-8)  # digits of the format
    assert record.quantity == ("velocity" if name.endswith("s2p") else "displacement")


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    mark=st.sampled_from(".,"),
    delimiter=st.sampled_from(";\t|"),
    end=st.sampled_from(["\n", "\r\n"]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "latin-1", "utf-16", "utf-16-le"]),
    top=st.sampled_from(
        [(), ("% µ-gyro; run 3",), ("Instrument: lock-in", "Date,2024-05-06", "", "gain=10"), ("#", "# x=1")]
    ),
)
def test_dialects_of_text_parse_the_same(tmp_path, mark, delimiter, end, encoding, top):
    w.semicolons(tmp_path / "a.csv", mark, delimiter, end, encoding, top)
    assert_is_the_sweep(imported(tmp_path / "a.csv")[0])


@pytest.mark.parametrize("delimiter", [",", "   ", ", "])
def test_commas_and_blanks_with_a_decimal_point(delimiter, tmp_path):
    w.semicolons(tmp_path / "a.txt", ".", delimiter)
    assert_is_the_sweep(imported(tmp_path / "a.txt")[0])


@pytest.mark.parametrize(
    ("header", "units"),
    [
        ("f [kHz];X [mV];Y [mV]", (1e-3, 1e3)),
        ("Frequency/kHz;Re/mV;Im/mV", (1e-3, 1e3)),
        ("freq_kHz;in-phase (mV);quadrature (mV)", (1e-3, 1e3)),
        ("Freq, kHz;Real, mV;Imag, mV", (1e-3, 1e3)),
        ("Frequency;X;Y\nkHz;mV;mV", (1e-3, 1e3)),
        ("Frequency [Hz];demod0 X (Vrms);demod0 Y (Vrms)", (1.0, 1 / w.PEAK)),
        ("Frequency [Hz];X [V pp];Y [V pp]", (1.0, 2.0)),
        ("Frequency (rad/s);Re (V);Im (V)", (2 * np.pi, 1.0)),
    ],
)
def test_units_behind_the_name_in_every_way(header, units, tmp_path):
    rows = [
        f"{f * units[0]!r};{z.real * units[1]!r};{z.imag * units[1]!r}"
        for f, z in zip(w.FREQUENCY.tolist(), w.RESPONSE.tolist(), strict=True)
    ]
    (tmp_path / "a.csv").write_text("\n".join([header, *rows]))
    assert_is_the_sweep(imported(tmp_path / "a.csv")[0])


@pytest.mark.parametrize(
    ("header", "turn"), [("R [dBV],Theta [deg]", 180 / np.pi), ("Magnitude [dB],Phase [rad]", 1.0)]
)
def test_amplitude_in_decibels_and_phase(header, turn, tmp_path):
    level = 20 * np.log10(np.abs(w.RESPONSE) / (w.PEAK if "dBV" in header else 1.0))
    rows = [
        f"{f},{a!r},{p * turn!r}"
        for f, a, p in zip(w.FREQUENCY.tolist(), level.tolist(), np.angle(w.RESPONSE).tolist(), strict=True)
    ]
    (tmp_path / "a.csv").write_text("\n".join([f"f [Hz],{header}", *rows]))
    (record,) = imported(tmp_path / "a.csv")
    np.testing.assert_allclose(column(record, "Vx_amp", "V"), np.abs(w.RESPONSE), rtol=1e-9)
    np.testing.assert_allclose(column(record, "Vx_phase", "rad"), np.angle(w.RESPONSE), atol=1e-12)
    assert any("peak amplitude" in sentence for sentence in record.assumed)


def test_readings_that_the_user_says_are_effective_values(tmp_path):
    """Many lock-ins save rms without saying so; a unit that says how it is meant is not turned twice."""
    for unit, factor in (("mm/s", 1.0), ("Vrms", 1.0 / w.PEAK)):
        (tmp_path / "a.csv").write_text(
            "\n".join([f"f [Hz],R [{unit}],Theta [deg]"] + [
                f"{f},{abs(z) * factor!r},{np.degrees(np.angle(z))!r}"
                for f, z in zip(w.FREQUENCY.tolist(), w.RESPONSE.tolist(), strict=True)
            ])
        )  # fmt: skip
        case = import_case([tmp_path / "a.csv"], tmp_path / unit.replace("/", "-"), drive=["1 V"], rms=True)
        plain = import_case([tmp_path / "a.csv"], tmp_path / f"plain {unit.replace('/', '-')}", drive=["1 V"])
        ratio = np.abs(case.case.records[0].phasors / plain.case.records[0].phasors)
        np.testing.assert_allclose(ratio, w.PEAK if unit == "mm/s" else 1.0, rtol=1e-9)
        assert "is turned to a peak amplitude" in str(case)
        assert "not rms" not in str(case)


def test_the_other_sign_of_the_phase_is_turned_and_told(tmp_path, monkeypatch):
    monkeypatch.setattr(w, "RESPONSE", w.RESPONSE.conj())
    w.semicolons(tmp_path / "a.csv")
    monkeypatch.undo()
    (record,) = imported(tmp_path / "a.csv")
    assert_is_the_sweep(record)
    assert any("negated" in sentence for sentence in record.assumed)


def test_velocity_is_seen_by_its_phase(tmp_path, monkeypatch):
    monkeypatch.setattr(w, "RESPONSE", w.RESPONSE * 1j * w.FREQUENCY / 4000)
    w.semicolons(tmp_path / "a.csv")
    assert imported(tmp_path / "a.csv")[0].quantity == "velocity"


@pytest.mark.parametrize("name", WRITERS)
def test_damaged_files_are_one_sentence(name, tmp_path):
    path = tmp_path / name
    WRITERS[name](path)
    whole = path.read_bytes()
    for part in (
        whole[: len(whole) // 2],
        whole[: len(whole) - 7],
        whole[:100],
        whole[:3],
        b"",
        b"\x00" * 500,
        whole[:60] + bytes(range(256)),
    ):
        path.write_bytes(part)
        sentence = complaint(path)
        assert sentence is None or (str(path) in sentence and "\n" not in sentence)


def test_a_missing_library_is_one_sentence_with_its_extra(tmp_path, monkeypatch):
    w.tdms(tmp_path / "a.tdms")
    monkeypatch.setitem(sys.modules, "nptdms", None)
    importlib.invalidate_caches()
    with pytest.raises(InputError, match=r"npTDMS.*pip install -e '.\[import\]'"):
        imported(tmp_path / "a.tdms")


def test_columns_that_could_be_either_are_named_with_a_map_to_copy(tmp_path):
    path = tmp_path / "a.csv"
    rows = [f"{n / 1000},{np.cos(n) * 0.99**n:.9g},{np.sin(n) * 0.99**n:.9g}" for n in range(200)]
    path.write_text("\n".join(["time [s],strain0 [1],strain1 [1]", *rows]))
    with pytest.raises(
        InputError, match=r"`strain0 \[1\]`, `strain1 \[1\]`.*--map \"t=time \[s\],x=strain0 \[1\]\""
    ) as told:
        imported(path)
    copied = str(told.value).split('--map "')[1].split('"')[0]
    (record,) = imported(path, copied)
    assert record.kind == "free_decay"
    assert set(record.unused) == {"strain1 [1]"}


def test_a_map_names_columns_without_a_header(tmp_path):
    rows = [
        f"{f / 1e3!r} {z.real!r} {z.imag!r}" for f, z in zip(w.FREQUENCY.tolist(), w.RESPONSE.tolist(), strict=True)
    ]
    (tmp_path / "a.dat").write_text("\n".join(rows))
    with pytest.raises(InputError, match="--map"):
        imported(tmp_path / "a.dat")
    assert_is_the_sweep(imported(tmp_path / "a.dat", "f=column 1 [kHz],x_I=column 2 [V],x_Q=1*column 3 [V]")[0])


@pytest.mark.parametrize("text", ["f", "f=", "frequency=a", "f=a,f=b", "f=no such column,x_I=X,x_Q=Y"])
def test_a_wrong_map_is_one_sentence(text, tmp_path):
    w.semicolons(tmp_path / "a.csv")
    with pytest.raises(InputError, match="--map"):
        imported(tmp_path / "a.csv", text)


@pytest.mark.parametrize(
    ("stem", "level"),
    [
        ("sweep_20mV_up", (20.0, "mV")),
        ("s 0.5 nN", (0.5, "nN")),
        ("run12", (1.0, "V")),
        ("run_-20dBV_up", (np.sqrt(0.02), "V")),
        ("run_m10dBm", (0.1, "V")),
        ("run-10dBm", (1.0, "V")),
        ("x7_20mVpp", (10.0, "mV")),
    ],
)
def test_the_drive_level_from_the_name_of_the_file(stem, level, tmp_path):
    w.semicolons(tmp_path / f"{stem}.csv")
    (record,) = imported(tmp_path / f"{stem}.csv")
    assert record.keys["drive_force"] == {"value": pytest.approx(level[0]), "unit": level[1]}


@pytest.mark.parametrize("names", [("I_re", "I_im"), ("Re(I)", "Im(I)"), ("I real", "I imag")])
def test_the_letter_of_a_current_is_no_part_of_it(names, tmp_path):
    real, imaginary = names
    rows = [f"{f},0.1,{1e9 * z.real},{1e9 * z.imag}" for f, z in zip(w.FREQUENCY, w.RESPONSE, strict=True)]
    header = f"Frequency [Hz],V_exc [Vrms],{real} [nA],{imaginary} [nA]"
    (tmp_path / "a.csv").write_text("\n".join([header, *rows]))
    (record,) = imported(tmp_path / "a.csv")
    assert_is_the_sweep(record, "A")
    np.testing.assert_allclose(column(record, "F_x", "V"), 0.1 * np.sqrt(2.0))


def over_time(rows=60, step=1e-3, mark="."):
    """Rows of an excitation and what answers to it, as text, with nothing in the column of times."""
    for n in range(rows):
        yield f"\t{np.cos(0.7 * n):.6f}\t{np.sin(0.7 * n) * n / rows:.6f}".replace(".", mark)


LVM = """LabVIEW Measurement|Writer_Version~2|Separator~Tab|Decimal_Separator~{mark}|Multi_Headings~Yes|X_Columns~{x}
***End_of_Header***~|~|{segment}|***End_of_Header***~~~|{names}"""


def labview(mark, x, segment, names, rows):
    head = LVM.format(mark=mark, x=x, segment=segment, names=names).replace("|", "\n").replace("~", "\t")
    return "\n".join([head, *rows]) + "\n"


def test_labview_without_a_column_of_times(tmp_path):
    segment = "Channels~2~~|Y_Unit_Label~Newtons~m/s^2~|X_Dimension~Time~Time~|X0~0,0~0,0~|Delta_X~1,0E-3~1,0E-3~"
    names = "X_Value~Excitation (Trigger)~Response (Trigger)~Comment"
    (tmp_path / "a.lvm").write_text(labview(",", "No", segment, names, over_time(mark=",")))
    (record,) = imported(tmp_path / "a.lvm")
    assert record.kind == "time_record"
    assert {*record.columns} == {"t [s]", "u_x [N]", "Vx [m/s^2]"}
    np.testing.assert_allclose(record.columns["t [s]"], np.arange(60) * 1e-3)


def test_labview_with_a_column_of_times_for_each_channel_and_channels_without_samples(tmp_path):
    segment = "Channels~3~~~~|Y_Unit_Label~Volts~~g~~|X_Dimension~Time~~Time~|X0~0.0~~0.0~|Delta_X~1E-3~~1E-3~"
    names = "X_Value~Drive voltage~X_Value~Acceleration~X_Value~Untitled~Comment"
    rows = (f"{n / 1e3}\t{np.cos(n):.6f}\t{n / 1e3}\t{np.sin(n):.6f}\t\t" for n in range(60))
    (tmp_path / "a.lvm").write_text(labview(".", "Multi", segment, names, rows))
    (record,) = imported(tmp_path / "a.lvm")
    assert {*record.columns} == {"t [s]", "u_x [V]", "Vx [g_0]"}


@pytest.mark.parametrize(
    "head",
    [
        "x-axis,1\nsecond,Volt",  # Keysight
        "Model,MSO58\nFirmware Version,1.2\n\nWaveform Type,ANALOG\nHorizontal Units,s\n,,\nTIME,CH1",  # Tektronix
        '"Time [s]","Out [V]"',
        "LECROY9354,935412345\nSegments,1,SegmentSize,502\n#1,21 Mar 1990 9:37:08,0.0\nTime,Ampl",
        "in s,C1 in V",  # Rohde & Schwarz
        "t (s), signal (V)",
    ],
)
def test_oscilloscopes(head, tmp_path):
    rows = [f"{n * 1e-4:.4e},{np.exp(-n / 100) * np.cos(0.5 * n):.6e}" for n in range(400)]
    (tmp_path / "a.csv").write_text("\n".join([head, *rows]) + "\n")
    (record,) = imported(tmp_path / "a.csv")
    assert record.kind == "free_decay"
    np.testing.assert_allclose(record.columns["t [s]"], np.arange(400) * 1e-4)
    assert record.design["resonance"][0] == pytest.approx(0.5e4 / (2 * np.pi), rel=1e-3)
    assert record.design["quality_factor"][0] == pytest.approx(25.0, rel=0.05)


@pytest.mark.parametrize("end", ["", ",,"])
def test_an_oscilloscope_that_numbers_its_samples(end, tmp_path):
    rows = [f"{n},{np.exp(-n / 100) * np.cos(0.5 * n):.6e}{end}" for n in range(400)]
    head = ["X,CH1,Start,Increment,", "Sequence,Volt,-2.000000e-03,1.000000e-04"]
    (tmp_path / "a.csv").write_text("\n".join([*head, *rows]) + "\n")
    (record,) = imported(tmp_path / "a.csv")
    assert record.kind == "free_decay"
    np.testing.assert_allclose(column(record, "t", "s"), -2e-3 + 1e-4 * np.arange(400), atol=1e-12)
    assert "Vx [V]" in record.columns


def test_power_spectra_are_no_responses(tmp_path, monkeypatch):
    written = pyuff.UFF.write_sets
    monkeypatch.setattr(pyuff.UFF, "write_sets", lambda self, one, mode: written(self, one | {"func_type": 9}, mode))
    w.universal(tmp_path / "a.uff")
    with pytest.raises(InputError, match="holds none"):
        imported(tmp_path / "a.uff")


def test_a_reflection_is_read_as_what_goes_in(tmp_path):
    scattering = (1 - w.RESPONSE)[:, None, None]
    skrf.Network(f=w.FREQUENCY, f_unit="hz", s=scattering, z0=50.0).write_touchstone("a", str(tmp_path), form="db")
    assert_is_the_sweep(imported(tmp_path / "a.s1p")[0])


@pytest.mark.parametrize("kind", ["Y", "Z"])
def test_immittances_of_a_touchstone_file_are_normalised_to_its_ports(kind, tmp_path):
    through_ports = 2 / w.RESPONSE - 1  # 1 - S11 = 2 y / (1 + y), with y in units of the ports'
    value = 1 / through_ports if kind == "Y" else through_ports
    rows = [f"{f:.6f} {v.real:.12e} {v.imag:.12e}" for f, v in zip(w.FREQUENCY, value, strict=True)]
    (tmp_path / "a.s1p").write_text("\n".join([f"# Hz {kind} RI R 50", *rows]) + "\n")
    assert_is_the_sweep(imported(tmp_path / "a.s1p")[0])


def test_a_recording_that_broke_off_is_read_as_far_as_it_goes_and_told(tmp_path, capfd):
    w.tdms(tmp_path / "a.tdms")
    whole = (tmp_path / "a.tdms").read_bytes()
    (tmp_path / "a.tdms").write_bytes(whole[:-100])
    _, tables = read_instrument_file(tmp_path / "a.tdms")
    assert any("broke off" in sentence for table in tables for sentence in table.assumed)
    assert capfd.readouterr().err == ""


def test_what_several_instruments_write_above_beside_and_below_their_rows(tmp_path):
    rows = [f"{f:.3f}\t{z.real:.9e}\t{z.imag:.9e}" for f, z in zip(w.FREQUENCY, w.RESPONSE, strict=True)]
    (tmp_path / "vibrometer.txt").write_text(
        "Signal:\tFFT - Vib Velocity\n\nFrequency\tVelocity\tVelocity\n[ Hz ]\t[ m/s ] Real\t[ m/s ] Imag\n"
        + "\n".join(rows)
    )
    (record,) = imported(tmp_path / "vibrometer.txt")
    assert_is_the_sweep(record, "m/s")
    assert record.quantity == "velocity"
    body = "\n".join(rows).replace("\t", ",")
    (tmp_path / "analyser.csv").write_text(
        f"!CSV A.01.01\n\nBEGIN CH1_DATA\nFreq(Hz),S21(REAL),S21(IMAG)\n{body}\nEND\n"
    )
    assert_is_the_sweep(imported(tmp_path / "analyser.csv")[0])
    time = np.arange(400) / 50e3
    told = ["Record Length,400", "Sample Interval,2e-05", "Source,CH1", "Vertical Units,mV"] + [","] * 396
    wave = np.exp(-300 * time) * np.cos(2 * np.pi * 4000 * time)
    scope = [f"{a},,{t:.8f},{v:.6f}," for a, t, v in zip(told, time, wave, strict=True)]
    (tmp_path / "scope.csv").write_text("\n".join(scope))
    (record,) = imported(tmp_path / "scope.csv")
    assert record.kind == "free_decay"
    np.testing.assert_allclose(column(record, "Vx", "V"), 1e-3 * wave, atol=1e-9)
    rows = [f"{t:.6f}\t{u:.3f}\t{v:.6f}" for t, u, v in zip(time, np.cos(2 * np.pi * 3900 * time), wave, strict=True)]
    (tmp_path / "karte.txt").write_text("Zeit [s]\tAnregung [V]\tWeg [µm]\n" + "\n".join(rows).replace(".", ","))
    assert imported(tmp_path / "karte.txt")[0].kind == "time_record"


@pytest.mark.parametrize("day", ["2024-03-01 ", "2024-03-01T", ""])
def test_moments_of_a_clock_are_times(day, tmp_path):
    time = np.round(np.arange(400) / 2000, 6)
    wave = np.exp(-20 * time) * np.cos(2 * np.pi * 300 * time)
    rows = [f"{day}23:59:59.{int(1e6 * t + 5e5):06d},{v:.6f}" for t, v in zip(time, wave, strict=True)]
    (tmp_path / "logger.csv").write_text("\n".join(["Timestamp,displacement [um]", *rows]))
    (record,) = imported(tmp_path / "logger.csv")
    assert record.kind == "free_decay"
    np.testing.assert_allclose(column(record, "t", "s"), time, atol=1e-9)
