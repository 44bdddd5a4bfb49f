"""What impedance analysers save is the current at the drive, whichever of its four forms they save."""

import numpy as np
import pytest

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.units import parse_header, to_si
from memsgyro_jax.measurement.column_meaning import meaning_of
from memsgyro_jax.measurement.formats import read_instrument_file
from memsgyro_jax.measurement.imported_record import Given, records_of


F = np.linspace(32970.0, 33030.0, 61)
TURN = 1j * 2.0 * np.pi * F
MOTIONAL = 1.0 / (268e3 + TURN * 11.63e3 + 1.0 / (TURN * 2e-15))  # a tuning fork of 33 kHz, quality factor 9000
ADMITTANCE = MOTIONAL + TURN * 1.2e-12  # beside its electrodes
IMPEDANCE = 1.0 / ADMITTANCE
PHASE = np.angle(IMPEDANCE, deg=True)
FORMS = {
    "Frequency [Hz],G [S],B [S]": (ADMITTANCE.real, ADMITTANCE.imag),
    "Frequency (Hz),R (Ohm),X (Ohm)": (IMPEDANCE.real, IMPEDANCE.imag),
    "Frequency (Hz),|Z| (Ohm),Theta (deg)": (abs(IMPEDANCE), PHASE),
    "f/Hz,Abs(Z)/kOhm,Phase(Z)/deg": (abs(IMPEDANCE) / 1e3, PHASE),
    "Freq [Hz],|Y| [uS],theta [deg]": (abs(ADMITTANCE) * 1e6, -PHASE),
    "Freq [Hz],Re(Y) [S],Im(Y) [S]": (ADMITTANCE.real, ADMITTANCE.imag),
}


def imported(path, head, columns, drive=(10.0, "mV")):
    np.savetxt(path, np.column_stack([F, *columns]), "%.12g", ",", header=head, comments="")
    _, (table,) = read_instrument_file(path)
    (record,) = records_of("fork", table, meaning_of(table, {}), Given(drive))
    return record


def phasors(record):
    parts = {parse_header(head).name: to_si(v, parse_header(head).unit, "V", head) for head, v in record.columns.items()
             if head.startswith("Vx_") and "phase" not in head}  # fmt: skip
    if "Vx_I" in parts:
        return parts["Vx_I"] + 1j * parts["Vx_Q"]
    return parts["Vx_amp"] * np.exp(1j * np.radians(record.columns["Vx_phase [deg]"]))


@pytest.mark.parametrize("head", FORMS)
def test_every_form_is_the_current_at_the_drive(head, tmp_path):
    record = imported(tmp_path / "fork.csv", head, FORMS[head])
    assert (record.kind, record.quantity, record.two_axes) == ("frequency_sweep", "velocity", False)
    np.testing.assert_allclose(phasors(record), 10e-3 * ADMITTANCE, rtol=1e-9)
    assert record.keys["drive_force"] == {"value": 10.0, "unit": "mV"}


def test_a_column_of_the_level_is_its_drive(tmp_path):
    level = np.linspace(1.0, 2.0, F.size)
    columns = (IMPEDANCE.real, IMPEDANCE.imag, level)
    record = imported(tmp_path / "a.csv", "f [Hz],R [Ohm],X [Ohm],Osc level [Vrms]", columns, None)
    np.testing.assert_allclose(phasors(record), np.sqrt(2.0) * level * ADMITTANCE, rtol=1e-9)


def test_without_a_level_it_is_said_to_be_one_volt(tmp_path):
    record = imported(tmp_path / "a.csv", "f [Hz],R [Ohm],X [Ohm]", (IMPEDANCE.real, IMPEDANCE.imag), None)
    assert any("the drive is 1 V" in sentence for sentence in record.assumed)
    np.testing.assert_allclose(phasors(record), ADMITTANCE, rtol=1e-9)


def test_a_drive_that_is_no_voltage_is_refused(tmp_path):
    with pytest.raises(InputError, match="beside impedances or admittances must be a voltage, but is in nN"):
        imported(tmp_path / "a.csv", "f [Hz],R [Ohm],X [Ohm]", (IMPEDANCE.real, IMPEDANCE.imag), (10.0, "nN"))
