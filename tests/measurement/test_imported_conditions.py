"""What is made of the temperatures and bias voltages at which files were recorded, given, in columns or in names."""

import instrument_files as w
import numpy as np
import pytest

import memsgyro_jax as mg


def sweep(path, beside="", value=0.0):
    """A sweep, with a column of one number beside it where `beside` is its header."""
    more, number = (f",{beside}", f",{value}") if beside else ("", "")
    lines = [f"{f},{z.real},{z.imag}{number}" for f, z in zip(w.FREQUENCY, w.RESPONSE, strict=True)]
    path.write_text("\n".join([f"f [Hz],X [V],Y [V]{more}", *lines]) + "\n")
    return path


def decay(path):
    """A waveform that dies out."""
    time = np.arange(4000) / 20e3
    values = np.exp(-20.0 * time) * np.cos(2 * np.pi * 3200.0 * time)
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
