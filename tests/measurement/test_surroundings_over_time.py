"""The temperature and bias voltage of records over time: columns of their files, and what the device is in them."""

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.one_place import in_one_place
from memsgyro_jax.measurement.readings import model_of, readings_of


HERTZ, QUALITY, DRIFT = 8e3, 400.0, -4e-5
HEAD = """schema = "memsgyro-case/1"
name = "oven"
device = "resonator"

[readout]
quantity = "displacement"
scale = { value = 1.0, unit = "V/um" }

[drive]
unit = "N"

[environment]
temperature = { value = 25, unit = "degC" }

[design]
mass = { value = 1e-9, tolerance = 0.01, unit = "kg" }
resonance = { value = 8000, tolerance = 0.05, unit = "Hz" }
quality_factor = { value = 400, tolerance = 0.5, unit = "1" }
"""
OF_KIND = {
    "ring_down": """drive_force = { value = 1e-6, unit = "N" }
drive_frequency = { value = 8000, unit = "Hz" }
drive_duration = { value = 0.1, unit = "s" }
""",
    "free_decay": "",
    "time_record": 'hold = "zero_order"\nstart = "unknown"\n',
    "rate_table": """drive_axis = "x"
drive_force = { value = 1e-6, unit = "N" }
drive_frequency = { value = 8000, unit = "Hz" }
lock_in_cycles = 40
""",
}


SLOW = [pytest.param(kind, marks=pytest.mark.slow) for kind in ("free_decay", "rate_table")]


def ringing(degrees, time):
    """A decay at a temperature [V], of a spring that softens with it."""
    omega, rate = 2 * np.pi * HERTZ * np.sqrt(1 + DRIFT * (degrees - 25)), np.pi * HERTZ / QUALITY
    return 0.5 * np.exp(-rate * time) * np.cos(np.sqrt(omega**2 - rate**2) * time + 0.3)


def written(folder, kind, degrees, more="", noise=0.0, seed=0, seen=None):
    """A case with one record for each temperature [degC], which a column tells; decays are as at `seen`."""
    rng, text = np.random.default_rng(seed), HEAD
    for number, one in enumerate(degrees):
        rate_table = kind == "rate_table"
        time = np.arange(60) * 5e-3 + 2.5e-3 if rate_table else np.arange(750) / 50e3
        told = {"t [s]": time, "T [degC]": np.broadcast_to(one, time.shape)}
        if kind == "time_record":
            told["u_x [N]"] = 1e-7 * np.sin(2 * np.pi * 7.9e3 * time)
        if rate_table:
            told |= {"rate [deg/s]": 10 * np.sin(40 * time), "Vx_I [V]": 0.0 * time, "Vx_Q [V]": -0.2 + 0.0 * time}
        else:
            told["Vx [V]"] = ringing(np.mean(one) if seen is None else seen, time) + noise * rng.standard_normal(
                time.size
            )
        rows = np.stack([*told.values()], axis=1)
        np.savetxt(folder / f"r{number}.csv", rows, "%.12g", ",", header=",".join(told), comments="")
        text += f'[[experiment]]\nname = "r{number}"\nkind = "{kind}"\nfile = "r{number}.csv"\n{OF_KIND[kind]}{more}'
    (folder / "case.toml").write_text(text)
    return mg.load_case(folder)


@pytest.mark.parametrize("kind", OF_KIND)
def test_each_kind_takes_its_temperature_and_keeps_it(kind, tmp_path):
    case = written(tmp_path, kind, [70.0])
    mg.write_case(case, tmp_path / "again")
    for held in (case, mg.load_case(tmp_path / "again")):
        (record,) = held.records
        np.testing.assert_allclose(record.temperature, 343.15)
        np.testing.assert_allclose(record.bias_voltage, 0.0)
        around = record.experiment(held, 0).surroundings
        np.testing.assert_allclose(around.temperature, 343.15)
        assert {"temperature", "bias voltage"} <= {one.name for one in record.known(held)}


@pytest.mark.parametrize("kind", OF_KIND)
def test_a_record_that_tells_none_is_as_the_case_declares(kind, tmp_path):
    case = written(tmp_path, kind, [70.0])
    file = tmp_path / "r0.csv"
    rows = [line.split(",") for line in file.read_text().splitlines()]
    file.write_text("\n".join(",".join(row[:1] + row[2:]) for row in rows) + "\n")
    (record,) = mg.load_case(tmp_path).records
    assert record.temperature is None
    np.testing.assert_allclose(record.experiment(case, 0).surroundings.temperature, 298.15)
    assert not {"T [K]", "V_bias [V]"} & set(record.columns(case))


@pytest.mark.parametrize("kind", ["ring_down", *SLOW])
def test_a_prediction_is_that_of_the_device_at_this_temperature(kind, tmp_path):
    """The record at 70 °C of a device that drifts, and one at 25 °C of a device whose spring is as soft."""
    warm = written(tmp_path, kind, [70.0])
    drifting = model_of(warm, starting_device(warm)).with_effect(mg.effects.ThermalStiffness(DRIFT))
    cold = written(tmp_path, kind, [25.0], seen=70.0)
    device = drifting.device
    softer = type(device)(device.stiffness * (1 + DRIFT * 45.0), device.damping, device.mobility)
    soft = model_of(cold, softer)
    predicted = (readings_of(c)[0].experiment.predict(m) for c, m in ((warm, drifting), (cold, soft)))
    one, other = (np.asarray(values) for values in predicted)
    np.testing.assert_allclose(one, other, rtol=0, atol=3e-5 * np.max(np.abs(other)))


def test_a_thermometer_that_scatters_is_taken_as_what_it_is_on_the_whole(tmp_path):
    noisy = 70.0 + 0.2 * np.random.default_rng(1).standard_normal(750)
    (record,) = written(tmp_path, "free_decay", [noisy]).records
    assert np.ptp(record.temperature) == 0.0
    assert record.thermometer == pytest.approx(0.2, rel=0.1)
    (told,) = record.warnings(mg.load_case(tmp_path))
    assert "column `T` scatters by 0.2 K" in told


def test_the_noise_of_rows_is_cut_with_them(tmp_path):
    """A column of noise stayed whole where `from` cut the record."""
    written(tmp_path, "free_decay", [25.0], more='from = { value = 10, unit = "ms" }\n')
    file = tmp_path / "r0.csv"
    head, *rows = file.read_text().splitlines()
    file.write_text("\n".join([f"{head},std [V]", *(f"{row},{1e-3 * (1 + k)}" for k, row in enumerate(rows))]) + "\n")
    (record,) = mg.load_case(tmp_path).records
    assert record.rows == 250
    np.testing.assert_allclose(record.noise_rows[:, 0], 1e-3 * np.arange(501, 751))


def test_a_start_is_that_of_the_temperature_nearest_to_the_declared_one(tmp_path):
    case = written(tmp_path, "free_decay", [70.0, 40.0, -20.0])
    assert [record.name for record in in_one_place(case.environment, case.records)] == ["r1"]
    hertz = np.sqrt(np.asarray(starting_device(case).stiffness)[0]) / (2 * np.pi)
    assert hertz == pytest.approx(HERTZ * np.sqrt(1 + DRIFT * 15.0), rel=2e-6)


@pytest.mark.slow
def test_a_drift_is_fitted_over_decays_that_turn_apart(tmp_path):
    """Between 70 and −20 °C the resonance moves by 29 Hz, one and a half of its widths."""
    case = written(tmp_path, "free_decay", [70.0, 25.0, -20.0], noise=1e-3)
    found = mg.fit(None, case, effects=[mg.effects.ThermalStiffness(0.0)])
    (drift,) = [one for one in found.estimates if "thermal_drift" in one.name]
    assert abs(drift.value - DRIFT) < 4 * drift.std < 1e-2 * abs(DRIFT)
