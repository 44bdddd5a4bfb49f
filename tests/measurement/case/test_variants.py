"""One-axis devices, digital units, conditions by row, and links between rows that a reader must not mistake."""

import numpy as np
import pytest
from measurement.case.bench import write_bench
from measurement.case.test_case import assert_same_case

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.measurement.case import load_case, write_case


RESONATOR = """\
schema = "memsgyro-case/1"
name = "one"
device = "resonator"
[design]
resonance = { value = 69.0, unit = "Hz", tolerance = 0.20 }
quality_factor = { value = 10.0, unit = "1", tolerance = 0.50 }
static_gain = { value = 1.0, unit = "V/V", tolerance = 0.30 }
[readout]
scale = { value = 1.0, unit = "V/V" }
[[experiment]]
name = "sweep"
kind = "frequency_sweep"
file = "sweep.csv"
drive_force = { value = 100.0, unit = "mV" }
settled = false
[[experiment]]
name = "noise"
kind = "time_record"
file = "noise.csv"
hold = "band_limited"
start = "unknown"
"""


@pytest.fixture
def resonator(tmp_path):
    (tmp_path / "case.toml").write_text(RESONATOR)
    f = np.linspace(40, 100, 31)
    y = 0.1 / (1 - (f / 69) ** 2 + 0.1j * f / 69)
    table = np.column_stack([f, y.real, y.imag])
    np.savetxt(tmp_path / "sweep.csv", table, delimiter=",", header="f [Hz],Vx_I [V],Vx_Q [V]", comments="")
    # A start after zero and times of few digits: what "unknown" allows, and what rounding leaves of 16384/10^7 s.
    lines = [f"{(n + 100) * 0.0016384:.6g},{n % 7},{n % 5}" for n in range(2000)]
    (tmp_path / "noise.csv").write_text("\n".join(["t [s],u [mV],y [mV]", *lines]) + "\n")
    return tmp_path


def swap(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_a_resonator_has_one_channel_under_either_name(resonator, tmp_path):
    case = load_case(resonator)
    assert case.channels == 1
    assert case.design["resonance"].value == pytest.approx(2 * np.pi * 69, rel=1e-12)
    sweep, noise = case.records
    assert sweep.phasors.shape == (31, 1)
    assert (sweep.axis, sweep.settled, noise.noise_std) == (0, False, None)
    np.testing.assert_allclose(sweep.drive, 0.1)
    assert noise.forces.shape == noise.signals.shape == (2000, 1)
    assert noise.signals.max() == pytest.approx(4e-3, rel=1e-12)
    assert noise.period == pytest.approx(0.0016384, rel=1e-5)
    write_case(case, tmp_path / "again")
    assert_same_case(case, load_case(tmp_path / "again"))


def test_a_resonator_has_no_second_axis(resonator):
    swap(resonator / "case.toml", "settled = false", 'settled = false\ndrive_axis = "y"')
    with pytest.raises(InputError, match=r'line 16, `experiment.0.drive_axis`: must be "x"'):
        load_case(resonator)


def test_names_are_not_mixed(resonator):
    swap(resonator / "sweep.csv", "Vx_Q [V]", "y_Q [V]")
    with pytest.raises(InputError, match="name its columns in one way"):
        load_case(resonator)


def test_a_shift_of_all_later_times_is_no_rounding(resonator):
    path = resonator / "noise.csv"
    head, *rows = path.read_text().splitlines()
    cells = [row.split(",", 1) for row in rows]
    moved = [f"{float(t) + 4e-4 * (n >= 1000):.6g},{rest}" for n, (t, rest) in enumerate(cells)]
    path.write_text("\n".join([head, *moved]) + "\n")
    with pytest.raises(InputError, match="clock of one period"):
        load_case(resonator)


def test_digital_units_follow_the_scale(tmp_path):
    folder = write_bench(tmp_path / "bench")
    for path in folder.glob("*.csv"):
        swap(path, "[V]", "[1]")
    toml = folder / "case.toml"
    swap(toml, 'unit = "V/um"', 'unit = "1/um"')
    swap(toml, 'adc_range = { value = 0.1, unit = "V" }', 'adc_range = { value = 0.1, unit = "1" }')
    swap(toml, 'noise_std = { value = 1e-5, unit = "V" }', 'noise_std = { value = 1e-5, unit = "1" }')
    case = load_case(folder)
    assert (case.readout.unit, case.readout.adc_range) == ("1", 0.1)
    write_case(case, tmp_path / "again")
    assert_same_case(case, load_case(tmp_path / "again"))
    swap(folder / "raw.csv", "Vx [1]", "Vx [V]")
    with pytest.raises(InputError, match=r'column `Vx`.*same as "1"'):
        load_case(folder)


def with_column(path, header, values):
    head, *rows = path.read_text().splitlines()
    lines = [f"{header},{head}", *(f"{value},{row}" for value, row in zip(values, rows, strict=True))]
    path.write_text("\n".join(lines) + "\n")


def test_conditions_by_row_override_the_environment(tmp_path):
    folder = write_bench(tmp_path / "bench")
    with_column(folder / "sweep_x.csv", "V_bias [V]", [5] * 41 + [15] * 41)
    with_column(folder / "sweep_x.csv", "rate [deg/s]", [90] * 82)
    with_column(folder / "sweep_x.csv", "t [min]", range(82))
    with_column(folder / "sweep_x.csv", "T [degC]", 25 + 0.01 * np.arange(82))
    sweep = load_case(folder).record("sweep_x")
    assert set(sweep.bias_voltage) == {5.0, 15.0}
    assert sweep.rate[0] == pytest.approx(np.pi / 2)
    assert sweep.time[-1] == pytest.approx(81 * 60)
    assert sweep.temperature[1] == pytest.approx(298.16)
    assert [(rows.start, rows.stop) for rows in sweep.sweeps] == [(0, 41), (41, 82)]


def test_a_mistyped_temperature_stands_out(tmp_path):
    folder = write_bench(tmp_path / "bench")
    with_column(folder / "sweep_x.csv", "T [degC]", [25] * 10 + [52] + [25] * 71)
    with pytest.raises(InputError, match=r"line 12: a sweep must have at least 3 rows"):
        load_case(folder)


def test_a_downward_sweep_is_checked_as_an_upward_one(tmp_path):
    folder = write_bench(tmp_path / "bench")
    path = folder / "sweep_x.csv"
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *reversed(rows)]) + "\n")
    assert len(load_case(folder).record("sweep_x").sweeps) == 2
    swap(path, "Vx_I [V],Vx_Q [V]", "Vx_Q [V],Vx_I [V]")
    with pytest.raises(InputError, match="must fall by about 90"):
        load_case(folder)
