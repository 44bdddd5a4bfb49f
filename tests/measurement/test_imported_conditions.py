"""What is made of the temperatures and bias voltages at which files were recorded, given, in columns or in names."""

import instrument_files as w
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.measurement.file_names import bias_in_name, temperature_in_name


def sweep(path, beside="", value=0.0, gain=1.0):
    """A sweep, with a column of one number beside it where `beside` is its header."""
    more, number = (f",{beside}", f",{value}") if beside else ("", "")
    lines = [f"{f},{gain * z.real},{gain * z.imag}{number}" for f, z in zip(w.FREQUENCY, w.RESPONSE, strict=True)]
    path.write_text("\n".join([f"f [Hz],X [V],Y [V]{more}", *lines]) + "\n")
    return path


def decay(path, hertz=3200.0):
    """A waveform that dies out."""
    time = np.arange(4000) / 20e3
    values = np.exp(-20.0 * time) * np.cos(2 * np.pi * hertz * time)
    path.write_text("t [s],y [V]\n" + "\n".join(f"{t:.6f},{v:.6f}" for t, v in zip(time, values, strict=True)))
    return path


@pytest.mark.parametrize(
    ("recorded", "held"),
    [
        (["45 degC"], 45.0), (["65 degC", "45 degC"], 45.0), (["-40 degC", "60 degC"], 60.0),
        (["80 K", "300 K"], 26.85),
        (["45 degC", "25 degC"], 25.0), (["45 degC", "24.2 degC"], 25.0), (["45 degC", "-"], 25.0),
    ],
)  # fmt: skip
def test_numbers_hold_at_a_temperature_that_was_recorded(recorded, held, tmp_path):
    files = [sweep(tmp_path / f"s{k}.csv") for k in range(len(recorded))]
    case = mg.import_case(files, tmp_path / "case", drive=["10 mV"], temperature=recorded).case
    assert case.environment.temperature == pytest.approx(273.15 + held)
    text = (tmp_path / "case" / "case.toml").read_text()
    assert ("# the temperature at which the numbers of the device hold" in text) == (held != 25.0)


def test_bias_and_temperature_stand_in_one_section(tmp_path):
    found = mg.import_case([sweep(tmp_path / "s.csv", "T [degC]", 70.0)], tmp_path / "case", bias=["12 V"])
    assert found.case.environment.temperature == pytest.approx(343.15)
    assert found.case.environment.bias_voltage == pytest.approx(12.0)


@pytest.mark.parametrize(
    ("stem", "told"),
    [
        ("oven_+45C", "45 degC"), ("oven_+0C", "0 degC"), ("oven_-20C", "-20 degC"), ("g_45C", "45 degC"),
        ("m40C", "-40 degC"), ("set_m5p5C_2", "-5.5 degC"), ("sweep-25C", "25 degC"), ("T85degC", "85 degC"),
        ("temp_60_degC", "60 degC"), ("cryo_80K", "80 K"), ("85°C run", "85 degC"), ("minus40C", "-40 degC"),
        ("25C_to_45C", ""), ("ofen_10", ""), ("C4", ""), ("rev4C1", ""), ("10CH", ""), ("a12C", ""),
        ("sweep_10mV", ""), ("2kHz", ""),
    ],
)  # fmt: skip
def test_a_temperature_in_a_name(stem, told):
    assert temperature_in_name(stem) == told


@pytest.mark.parametrize(
    ("stem", "told"),
    [
        ("bias_10V", "10 V"), ("bias10V_100mV", "10 V"), ("Vdc12p5V", "12.5 V"), ("Bias_-5V", "-5 V"),
        ("10Vdc", "10 V"), ("10p5V_dc", "10.5 V"),
        ("s_15V_bias", "15 V"), ("DC_20V", "20 V"), ("bias-10V", "10 V"), ("vb_8V", "8 V"), ("bias_1kV", "1 kV"),
        ("drive_10V", ""), ("10V", ""), ("adc_5V", ""), ("abias", ""), ("bias", ""),
        ("bias_10Vpp", ""), ("bias_5V_bias_6V", ""),
    ],
)  # fmt: skip
def test_a_bias_in_a_name(stem, told):
    assert bias_in_name(stem) == told


def hints_of(tmp_path, *names, **options):
    """What is hinted at of sweeps with such names."""
    files = [sweep(tmp_path / f"{name}.csv", gain=1.0 + 0.01 * k) for k, name in enumerate(names)]
    found = mg.import_case(files, tmp_path / "case", overwrite=True, **{"drive": ["10 mV"], **options})
    assert found.to_dict()["hints"] == [*found.hints]
    for hint in found.hints:
        assert f"Hint: {hint}" in str(found)
    return [hint.partition("give it: ")[2] for hint in found.hints], found.case


def test_conditions_that_only_names_tell_are_hinted_at(tmp_path):
    told, case = hints_of(tmp_path, "oven_+45C", "oven_-5C", "other")
    assert told == ['--temperature "45 degC" "-5 degC" -']
    assert case.environment.temperature == pytest.approx(298.15), "nothing is guessed"
    given = {"temperature": ["45 degC", "-5 degC", "-"]}
    assert hints_of(tmp_path, "oven_+45C", "oven_-5C", "other", **given)[0] == []
    assert hints_of(tmp_path, "a_25C", "b_25C")[0] == []
    assert hints_of(tmp_path, "s_25C_10V", "s_45C_15V")[0] == [
        '--temperature "25 degC" "45 degC"',
        '--bias "10 V" "15 V"',
    ]
    assert hints_of(tmp_path, "s_10V", "t_10V")[0] == []
    assert hints_of(tmp_path, "s_10V", "s_15V", drive=[])[0] == [], "they are levels of the drive"


def test_what_a_column_tells_is_not_hinted_at(tmp_path):
    files = [sweep(tmp_path / "s_45C.csv", "T [degC]", 45.0), decay(tmp_path / "r.csv")]
    assert mg.import_case(files, tmp_path / "case", drive=["10 mV", "-"]).hints == ()


def test_the_temperature_of_a_decay_is_hinted_at_and_taken(tmp_path):
    """It was said that no record over time has one: ring-downs in an oven lost theirs."""
    files = [decay(tmp_path / f"r_{degrees}C.csv", 3200.0 - 0.1 * degrees) for degrees in (25, 60)]
    (told,) = mg.import_case(files, tmp_path / "case").hints
    assert told.endswith('--temperature "25 degC" "60 degC"')
    found = mg.import_case(files, tmp_path / "told", temperature=["25 degC", "60 degC"], bias=["10 V", "-"])
    assert not found.hints
    for record, degrees, volts in zip(mg.load_case(tmp_path / "told").records, (25.0, 60.0), (10.0, 0.0), strict=True):
        np.testing.assert_allclose(record.temperature, 273.15 + degrees)
        np.testing.assert_allclose(record.bias_voltage, volts)


def test_a_bias_in_a_name_is_no_drive(tmp_path):
    """It was taken for the level: 10 V in place of some millivolts."""
    told, case = hints_of(tmp_path, "bias_10V", "bias_20V", drive=[])
    assert told == ['--bias "10 V" "20 V"']
    np.testing.assert_allclose([record.drive[0] for record in case.records], 1.0)
    both = hints_of(tmp_path, "bias_10V_100mV", "bias_20V_50mV", drive=[])[1]
    np.testing.assert_allclose([record.drive[0] for record in both.records], [0.1, 0.05])


@pytest.mark.parametrize("text", ["-300 degC", "-273.16 degC", "0 K", "-1 K", "-460 degF"])
def test_no_file_was_recorded_at_or_below_absolute_zero(text, tmp_path):
    with pytest.raises(mg.InputError, match="`--temperature` must be above absolute zero") as told:
        mg.import_case([sweep(tmp_path / "a.csv")], tmp_path / "case", temperature=[text])
    assert str(told.value).endswith(f'but is "{text}".')
    assert not (tmp_path / "case").exists()


@pytest.mark.parametrize("broken", [slice(None), slice(7, 8)])
def test_a_column_at_or_below_absolute_zero_is_refused(broken, tmp_path):
    """What a broken sensor writes."""
    table = np.stack([w.FREQUENCY, w.RESPONSE.real, w.RESPONSE.imag, np.full(w.FREQUENCY.size, 45.0)], axis=1)
    table[broken, 3] = -300.0
    path = tmp_path / "a.csv"
    np.savetxt(path, table, delimiter=",", header="f [Hz],X [V],Y [V],T [degC]", comments="")
    with pytest.raises(mg.InputError, match="column `T`: the value must be above absolute zero") as told:
        mg.import_case([path], tmp_path / "case")
    assert "a.csv (as a record)" in str(told.value)


def test_a_sign_in_the_name_of_a_file_stays(tmp_path):
    names = ["oven_+5C", "oven_-5C", "oven_+0C", "oven +5C", "5 µV & more"]
    files = [sweep(tmp_path / f"{name}.csv", gain=1.0 + 0.01 * k) for k, name in enumerate(names)]
    case = mg.import_case(files, tmp_path / "case", drive=["10 mV"]).case
    assert [record.name for record in case.records] == ["oven_+5C", "oven_-5C", "oven_+0C", "oven_+5C_2", "5_µV_more"]
    assert [record.file for record in mg.load_case(tmp_path / "case").records] == [
        f"{r.name}.csv" for r in case.records
    ]


def test_names_that_are_alike_stay_apart(tmp_path):
    """The third had the name that the second was given, and the case was refused."""
    files = [sweep(tmp_path / f"{name}.csv", gain=k + 1.0) for k, name in enumerate(["a b", "a_b", "a_b_2"])]
    case = mg.import_case(files, tmp_path / "case", drive=["10 mV"]).case
    assert len({record.name for record in case.records}) == 3
    heights = [np.abs(record.phasors).max() / np.abs(w.RESPONSE).max() for record in case.records]
    np.testing.assert_allclose(heights, [1.0, 2.0, 3.0], rtol=1e-6)
